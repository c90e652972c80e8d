//! The carried reference views, and all of them where `VERNISSAGE_REFERENCE` names their folder.

use super::{EVERYTHING, scene};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use half::f16;
use npyz::npz::NpzArchive;
use std::path::{Path, PathBuf};
use vernissage::geometry::Lens;
use vernissage::pixels::{Size, picture, simd};
use vernissage::render::{Camera, Placed, Renderer};
use vernissage::scene::{Mesh, Shading, builtin};

fn camera(path: &Path) -> (Camera, Placed) {
    let text = std::fs::read_to_string(path).expect("camera file");
    let json: serde_json::Value = serde_json::from_str(&text).expect("camera JSON");
    let number = |key: &str| json[key].as_f64().expect("a number");
    let m: Vec<f64> =
        json["world_to_camera"].as_array().expect("a matrix").iter().filter_map(|v| v.as_f64()).collect();
    let lens = Lens {
        size: Size::new(number("width") as usize, number("height") as usize),
        focal: DVec2::new(number("fx"), number("fy")),
        center: DVec2::new(number("cx"), number("cy")),
        distortion: [0.0; 8],
    };
    let rows = DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]);
    let to_camera = DAffine3 { matrix3: rows.transpose(), translation: DVec3::new(m[3], m[7], m[11]) };
    (Camera { lens, near: number("near"), far: number("far") }, Placed { model: 0, to_camera })
}

fn array<T: npyz::Deserialize>(path: &Path, name: &str) -> Vec<T> {
    let mut archive = NpzArchive::open(path).expect("reference arrays");
    archive.by_name(name).expect("readable").expect("present").into_vec().expect("of this type")
}

fn check(folder: &Path, view: &str, mesh: Mesh) {
    let (camera, placed) = camera(&folder.join(format!("{view}_camera.json")));
    let scene = scene(mesh, Shading::Smooth, false);
    let mut renderer = Renderer::new(simd::best());
    let layer = renderer.draw(&scene, &[placed], &camera, EVERYTHING);
    let color = picture::read(&folder.join(format!("{view}_color.png"))).expect("reference color");
    let npz = folder.join(format!("{view}.npz"));
    let width = camera.lens.size.width;
    for (suffix, depth, normal) in [("", &layer.depth, &layer.normal), ("2", &layer.depth2, &layer.normal2)] {
        let expected: Vec<f32> = array(&npz, &format!("depth{suffix}"));
        let expected_normal: Vec<f16> = array(&npz, &format!("normal{suffix}"));
        let excused: Vec<bool> = array(&npz, &format!("excused{suffix}"));
        assert_eq!(expected.len(), camera.lens.size.area());
        let (mut mismatches, mut off, mut bent, mut colors, mut covered) = (0, 0.0f64, 0.0f32, 0, 0);
        for (pixel, &expected) in expected.iter().enumerate() {
            if excused[pixel] {
                continue;
            }
            let (x, y) = (pixel % width, pixel / width);
            if suffix.is_empty() {
                let (a, b) = (layer.color.at(x, y), color.at(x, y));
                colors = colors.max((0..3).map(|k| a[k].abs_diff(b[k])).max().unwrap_or(0));
            }
            let drawn = depth.at(x, y);
            if drawn.is_finite() != expected.is_finite() {
                mismatches += 1;
            } else if drawn.is_finite() {
                covered += 1;
                off = off.max((f64::from(drawn) / f64::from(expected) - 1.0).abs());
                for k in 0..3 {
                    let expected = expected_normal[3 * pixel + k].to_f32();
                    bent = bent.max((normal[k].at(x, y) - expected).abs());
                }
            }
        }
        println!(
            "{view} layer {}: {covered} px, coverage mismatches {mismatches}, depth {off:.1e}, normal {bent:.1e}, color {colors}",
            if suffix.is_empty() { 1 } else { 2 }
        );
        assert_eq!(mismatches, 0, "{view}{suffix}");
        assert!(off <= 1e-4, "{view}{suffix}: depth off by {off}");
        assert!(colors <= 1, "{view}: color off by {colors}");
        // 16-bit floats are good to 2^-11
        assert!(bent <= 1e-3, "{view}{suffix}: normal off by {bent}");
    }
}

#[test]
fn carried_views() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/draw");
    for name in ["teapot", "spot"] {
        for zoom in [1, 8] {
            check(&folder, &format!("{name}_z{zoom}"), builtin(name).expect("built in"));
        }
    }
}

fn packed_model(folder: &Path, name: &str) -> Mesh {
    let packed = std::fs::read(folder.join(format!("models/{name}.obj.xz"))).expect("reference model");
    let mut obj = Vec::new();
    lzma_rs::xz_decompress(&mut packed.as_slice(), &mut obj).expect("unpacks");
    Mesh::from_obj(&obj).expect("within limits")
}

#[test]
fn all_reference_views() {
    let Some(folder) = std::env::var_os("VERNISSAGE_REFERENCE").map(PathBuf::from) else {
        eprintln!("NOT RUN: the full set of reference views; set VERNISSAGE_REFERENCE to its folder");
        return;
    };
    let mut views: Vec<String> = std::fs::read_dir(folder.join("draw"))
        .expect("reference views")
        .filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            name.strip_suffix(".npz").map(str::to_owned)
        })
        .collect();
    views.sort();
    assert!(views.len() >= 6, "{views:?}");
    for view in views {
        let model = view.rsplit_once("_z").expect("MODEL_zZOOM").0;
        check(&folder.join("draw"), &view, packed_model(&folder, model));
    }
    for name in ["teapot", "spot"] {
        let (packed, loaded) = (builtin(name).expect("built in"), packed_model(&folder, name));
        assert!(packed == loaded, "{name}: the embedded model is its OBJ file");
    }
}
