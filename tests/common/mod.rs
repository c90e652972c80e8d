//! What the styles' tests share: the small frames, and stages of the independent reference.
#![allow(dead_code, reason = "every test binary uses a part")]

use std::path::{Path, PathBuf};
use vernissage::frame::Frame;
use vernissage::pixels::{Plane, Rgb, picture};

/// The frames in `tests/data/filters`.
pub const FRAMES: [&str; 2] = ["micro_coffee_160x120", "micro_stress_160x120"];

/// A file of `tests/data/filters`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/filters").join(name)
}

pub fn text(path: &Path) -> &str {
    path.to_str().expect("plain path")
}

pub fn frame_of(picture: Rgb) -> Frame {
    Frame { luma: Plane::new(picture.size(), 0), color: picture, ..Frame::default() }
}

pub fn frame(name: &str) -> Frame {
    frame_of(picture::read(&data(&format!("{name}.png"))).expect("test picture"))
}

/// One array of a reference file as f64, rows first, whatever numbers it holds.
pub fn stage(path: &Path, name: &str) -> Vec<f64> {
    let mut archive = npyz::npz::NpzArchive::open(path).expect("reference stages");
    let array = archive.by_name(name).expect("readable").expect("a stage of this name");
    let array = match array.try_data::<f64>() {
        Ok(values) => return values.map(|v| v.expect("f64")).collect(),
        Err(other) => other,
    };
    let array = match array.try_data::<f32>() {
        Ok(values) => return values.map(|v| f64::from(v.expect("f32"))).collect(),
        Err(other) => other,
    };
    let array = match array.try_data::<i64>() {
        Ok(values) => return values.map(|v| v.expect("i64") as f64).collect(),
        Err(other) => other,
    };
    let array = match array.try_data::<i32>() {
        Ok(values) => return values.map(|v| f64::from(v.expect("i32"))).collect(),
        Err(other) => other,
    };
    let array = match array.try_data::<i16>() {
        Ok(values) => return values.map(|v| f64::from(v.expect("i16"))).collect(),
        Err(other) => other,
    };
    array.into_vec::<bool>().expect("bool values").into_iter().map(|v| f64::from(u8::from(v))).collect()
}

/// Largest difference of values from an array.
pub fn worst(found: impl Iterator<Item = f32>, truth: &[f64]) -> f64 {
    let found: Vec<f64> = found.map(f64::from).collect();
    assert_eq!(found.len(), truth.len(), "shape");
    found.iter().zip(truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}
