//! Files that mean harm: cut short, mutated, claiming more than they hold. No panic, no long wait, and no more memory
//! than the documentation of [`Limits`] promises.

use crate::mutate::mutate;
use crate::write::{Data, glb, glb_of, obj, sample};
use crate::{HELD, MOST, MTL, alone, corners, files, folder};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use vernissage::pixels::{Rgb, Size, SplitMix64, picture};
use vernissage::scene::{Limits, Mesh};

#[test]
fn limits_name_file_limit_and_what_to_do() {
    let _alone = alone();
    let all = Limits::default();
    let deep: Vec<String> = (1..40).map(|k| format!(r#"{{"children":[{k}]}}"#)).collect();
    let deep = glb_of(&format!(r#"{{"nodes":[{},{{}}]}}"#, deep.join(",")), &[]);
    let mut cases = vec![("deep.glb", deep, Limits { nesting: 39, ..all }, "39 levels of nodes".to_string())];
    for (name, bytes) in files() {
        let vertices = if name.ends_with("obj") { "5 positions" } else { "5 vertices" };
        cases.push((name, bytes.clone(), Limits { vertices: 5, ..all }, vertices.into()));
        cases.push((name, bytes.clone(), Limits { triangles: 7, ..all }, "7 triangles".into()));
        cases.push((name, bytes.clone(), Limits { bytes: 99, ..all }, "99 bytes".into()));
        let entries = Limits { entries: 7, ..all };
        if name.ends_with("glb") {
            cases.push((name, bytes, entries, "7 objects in its JSON part".into()));
        } else if name.ends_with("ply") {
            cases.push((name, bytes, entries, "7 elements and properties".into()));
        }
    }
    cases.push(("a.glb", glb(&sample()), Limits { materials: 0, ..all }, "0 materials".into()));
    for (name, bytes, limits, says) in cases {
        let path = folder().join(name);
        std::fs::write(&path, &bytes).expect("temporary file");
        let error = Mesh::load_within(&path, &limits).expect_err(name).to_string();
        let words = [name, says.as_str(), "more than", "simplify or split"];
        assert!(words.iter().all(|word| error.contains(word)), "{name}: {error}");
    }
    // textures are done without
    for limits in [Limits { texture_px: 2, ..all }, Limits { texels: 5, ..all }] {
        for (name, bytes) in [("a.obj", obj(&sample())), ("a.glb", glb(&sample()))] {
            let mesh = Mesh::parse(&folder().join(name), &bytes, &limits).expect(name);
            assert!(mesh.materials[0].texture.is_none(), "{name}");
        }
    }
}

/// Limits under which a load of a small file can hold but little.
const TIGHT: Limits = Limits {
    bytes: 1 << 16,
    vertices: 2000,
    triangles: 2000,
    materials: 20,
    texture_px: 64,
    texels: 4096,
    nesting: 8,
    entries: 500,
};

/// What the documentation of [`Limits`] promises for a file of `bytes` bytes.
fn promised(bytes: usize, limits: &Limits) -> u64 {
    (1 << 20)
        + 128 * bytes as u64
        + 512 * limits.entries as u64
        + 256 * limits.vertices as u64
        + 128 * limits.triangles as u64
        + 32 * limits.texels
}

/// Loads a file that means harm: any result is good if it comes soon and takes little.
fn survive(path: &Path, bytes: &[u8], beside: usize) -> bool {
    let (before, start) = (HELD.load(Ordering::Relaxed), Instant::now());
    MOST.store(before, Ordering::Relaxed);
    let result = Mesh::parse(path, bytes, &TIGHT);
    let (held, took) = (MOST.load(Ordering::Relaxed) - before, start.elapsed());
    let name = path.display();
    assert!(took < Duration::from_secs(1), "{name}: {took:?}: {bytes:?}");
    let most = promised(bytes.len() + beside, &TIGHT);
    assert!(held <= most, "{name}: {held} bytes held of {most}: {bytes:?}");
    if let Ok(mesh) = &result {
        let vertices = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < vertices), "{name}");
        assert!(corners(mesh).iter().flatten().all(|p| p.is_finite()), "{name}");
        assert!(mesh.normals.len() == vertices && mesh.normals.iter().all(|n| n.is_finite()), "{name}");
        assert!(mesh.texcoords.is_empty() || mesh.texcoords.len() == vertices, "{name}");
        assert!(mesh.colors.is_empty() || mesh.colors.len() == vertices, "{name}");
        assert!(mesh.materials.is_empty() || mesh.material_of.len() == mesh.triangles.len(), "{name}");
    }
    result.is_ok()
}

#[test]
fn every_truncation_is_survived() {
    let _alone = alone();
    for (name, bytes) in files() {
        let path = folder().join(name);
        assert!(survive(&path, &bytes, MTL.len() + 200), "{name}: whole");
        // what a line-based text says before its cut may be good; all else says how long it is
        let open = if name.ends_with("obj") { bytes.len() + 1 } else { 12 };
        for end in 0..bytes.len() {
            let good = survive(&path, &bytes[..end], MTL.len() + 200);
            assert!(!good || end + open > bytes.len(), "{name}: good without its last {}", bytes.len() - end);
        }
    }
}

#[test]
fn mutations_are_survived() {
    let _alone = alone();
    let count = if std::env::var_os("VERNISSAGE_SOAK").is_some() { 100_000 } else { 5_000 };
    let mut rng = SplitMix64::new(5);
    for (name, whole) in files() {
        let path = folder().join(name);
        let mut good = 0;
        for _ in 0..count {
            let mut bytes = whole.clone();
            mutate(&mut bytes, &mut rng);
            good += usize::from(survive(&path, &bytes, MTL.len() + 200));
        }
        assert!(
            good > count / 50,
            "{name}: only {good} of {count} load: the mutations are too wild to reach far"
        );
    }
    // the material library
    let path = folder().join("mutated.obj");
    let text = String::from_utf8(obj(&sample())).expect("text").replace("m.mtl", "mutated.mtl");
    for _ in 0..count {
        let mut bytes = MTL.as_bytes().to_vec();
        mutate(&mut bytes, &mut rng);
        std::fs::write(folder().join("mutated.mtl"), &bytes).expect("temporary file");
        assert!(survive(&path, text.as_bytes(), bytes.len() + 200), "a library never refuses a model");
    }
}

#[test]
fn claims_are_not_believed() {
    let _alone = alone();
    let survive = |name: &str, bytes: &[u8]| survive(&folder().join(name), bytes, 0);
    let huge = "ply\nformat binary_little_endian 1.0\nelement vertex 2000\nproperty float x\nproperty float y\n\
                property float z\nelement face 4000000000\nproperty list uint int vertex_indices\nend_header\n";
    assert!(!survive("a.ply", huge.as_bytes()));
    let nothing = "ply\nformat ascii 1.0\nelement air 18446744073709551615\nend_header\n";
    assert!(survive("a.ply", nothing.as_bytes()));
    let mut stl = vec![0; 80];
    stl.extend([0xff; 4]);
    assert!(!survive("a.stl", &stl));
    // zeros that no byte of the file stands for, drawn by many nodes
    let nodes = vec![r#"{"mesh":0}"#; 120].join(",");
    let primitives = vec![r#"{"attributes":{"POSITION":0,"NORMAL":0},"indices":1}"#; 120].join(",");
    let zeros = format!(
        r#"{{"accessors":[{{"componentType":5126,"type":"VEC3","count":1999}},{{"componentType":5125,"type":"SCALAR","count":3}}],
        "nodes":[{nodes}],"meshes":[{{"primitives":[{primitives}]}}]}}"#
    );
    assert!(!survive("a.glb", &glb_of(&zeros, &[])));
    let nested = "[".repeat(5000);
    assert!(!survive("a.glb", &glb_of(&format!(r#"{{"extras":{nested}"#), &[])));
    let children = vec!["0"; 20_000].join(",");
    assert!(!survive(
        "a.glb",
        &glb_of(&format!(r#"{{"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[{children}]}}]}}"#), &[])
    ));
    // a picture that is larger than it looks
    let bomb = std::env::temp_dir().join(format!("vernissage-loaders-bomb-{}.png", std::process::id()));
    picture::write_png(&bomb, &Rgb::new(Size::new(2048, 2048), [0; 3])).expect("temporary file");
    let bytes = std::fs::read(&bomb).expect("temporary file");
    std::fs::remove_file(&bomb).expect("temporary file");
    let mut data = Data::default();
    let image = data.view(&bytes);
    let images = vec![format!(r#"{{"bufferView":{image}}}"#); 15].join(",");
    let materials: Vec<String> = (0..15)
        .map(|k| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{k}}}}}}}"#))
        .collect();
    let textures: Vec<String> = (0..15).map(|k| format!(r#"{{"source":{k}}}"#)).collect();
    let (materials, textures) = (materials.join(","), textures.join(","));
    let file =
        data.file(&format!(r#""images":[{images}],"textures":[{textures}],"materials":[{materials}]"#));
    assert!(survive("a.glb", &file), "models are drawn without it");
}
