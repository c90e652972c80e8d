//! Pose, lens and homography: the geometry that camera, tracker and renderer share.
//!
//! Camera space: x right, y down, z forward, millimetres. Image space: pixel centers at integers. All of it
//! in f64 with + - × ÷ sqrt and `libm`, so that every machine computes the same bits.

mod cholesky;
mod homography;
mod lens;
mod pose;
mod similarity;

pub use cholesky::solve_spd;
pub use homography::Homography;
pub use lens::Lens;
pub use pose::Pose;
pub use similarity::Similarity;
