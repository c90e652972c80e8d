//! Marker families as data: the codes, how they are printed, and how they are read.
//!
//! Bits are listed row by row from the top-left of the family's official upright picture, 1 = white.

use serde::{Deserialize, Serialize};

/// A family of square markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Family {
    /// AprilTag 36h11: 6x6 bits, 587 codes, minimum distance 11.
    #[serde(rename = "tag36h11")]
    Tag36h11,
    /// OpenCV DICT_4X4_50.
    #[serde(rename = "aruco_4x4_50")]
    Aruco4x4_50,
    /// OpenCV DICT_5X5_100.
    #[serde(rename = "aruco_5x5_100")]
    Aruco5x5_100,
    /// OpenCV DICT_6X6_250.
    #[serde(rename = "aruco_6x6_250")]
    Aruco6x6_250,
}
