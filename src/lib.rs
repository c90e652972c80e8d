//! vernissage: a stylised-reality visor on the CPU alone.
//!
//! One way through: camera → frame → track → render → style → show. The rooms below are listed from the
//! ground floor up; a room imports only rooms on lower floors (`tests/architecture.rs` enforces it):
//!
//! | floor | rooms |
//! |---|---|
//! | 0 | [`pixels`]: planes, views, tiles, noise, the one SIMD level |
//! | 1 | [`kernel`]: one image kernel a file, fast body and f64 reference; [`geometry`]: pose, lens, homography |
//! | 2 | [`marker`]: marker families as data; [`calibration`]: the lens from pictures of a sheet, and its files |
//! | 3 | [`frame`]: what flows; [`scene`]: what is wanted |
//! | 4 | [`render`]: the tile rasteriser; [`retouch`]: the camera picture before it is styled, and which part is |
//! | 5 | [`camera`], [`track`], [`style`], [`display`], [`buttons`] |
//! | 6 | [`pipeline`]: one frame, the plan, the hand-over |
//! | 7 | [`app`]: commands, settings, threads |
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod app;
pub mod buttons;
pub mod calibration;
pub mod camera;
pub mod display;
pub mod frame;
pub mod geometry;
pub mod kernel;
pub mod marker;
pub mod pipeline;
pub mod pixels;
pub mod render;
pub mod retouch;
pub mod scene;
pub mod style;
pub mod track;
