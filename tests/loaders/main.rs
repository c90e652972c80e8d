//! Model files: the same mesh in every format, what glTF, PLY and STL may say, and files that mean harm.
//!
//! The allocator counts what is held, so this test has a binary of its own. `VERNISSAGE_SOAK=1` runs all of the
//! mutations (100,000 a format) instead of a twentieth.

mod glb;
mod harm;
#[path = "../common/mutate.rs"]
mod mutate;
mod write;

use glam::{DVec3, Vec2, Vec3};
use std::alloc::{GlobalAlloc, Layout, System};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use vernissage::pixels::{Rgb, Size, picture};
use vernissage::scene::{Limits, Mesh};
use write::{Order, obj, ply, sample, stl_ascii, stl_binary};

struct Counting;

static HELD: AtomicU64 = AtomicU64::new(0);
static MOST: AtomicU64 = AtomicU64::new(0);

fn grow(bytes: usize) {
    let held = HELD.fetch_add(bytes as u64, Ordering::Relaxed) + bytes as u64;
    MOST.fetch_max(held, Ordering::Relaxed);
}

// SAFETY: every call goes to the system allocator unchanged; counting touches no memory it hands out.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size() as u64, Ordering::Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // old and new may be there at once
        grow(size);
        // SAFETY: the caller's promise is passed on.
        let new = unsafe { System.realloc(at, layout, size) };
        HELD.fetch_sub(layout.size() as u64, Ordering::Relaxed);
        new
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Held by every test: what others allocate would be counted too.
fn alone() -> MutexGuard<'static, ()> {
    static COUNTING: Mutex<()> = Mutex::new(());
    COUNTING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A folder of this process's own, with a texture and a material library in it.
fn folder() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vernissage-loaders-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    std::fs::write(folder.join("t.png"), png()).expect("temporary file");
    std::fs::write(folder.join("m.mtl"), MTL).expect("temporary file");
    folder
}

const MTL: &str = "newmtl paint\nKd 1 .5 .25\nmap_Kd -clamp on t.png\nnewmtl other\nKd .5\n";

fn texture() -> Rgb {
    let mut texture = Rgb::new(Size::new(3, 2), [40, 80, 120]);
    texture.set(1, 0, [250, 5, 99]);
    texture
}

fn png() -> Vec<u8> {
    let path = std::env::temp_dir().join(format!("vernissage-loaders-{}.png", std::process::id()));
    picture::write_png(&path, &texture()).expect("temporary file");
    let bytes = std::fs::read(&path).expect("temporary file");
    std::fs::remove_file(&path).expect("temporary file");
    bytes
}

/// The sample in every format, with the file's name.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let sample = sample();
    vec![
        ("a.obj", obj(&sample)),
        ("ascii.ply", ply(&sample, Order::Ascii)),
        ("little.ply", ply(&sample, Order::Little)),
        ("big.ply", ply(&sample, Order::Big)),
        ("binary.stl", stl_binary(&sample)),
        ("ascii.stl", stl_ascii(&sample)),
        ("a.glb", write::glb(&sample)),
    ]
}

fn parse(name: &str, bytes: &[u8]) -> Result<Mesh, String> {
    Mesh::parse(&folder().join(name), bytes, &Limits::default()).map_err(|e| e.to_string())
}

fn loaded(bytes: &[u8]) -> Mesh {
    parse("test.glb", bytes).expect("a good file")
}

fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    mesh.triangles.iter().map(|t| t.map(|i| mesh.positions[i as usize])).collect()
}

#[test]
fn every_format_gives_the_same_triangles() {
    let _alone = alone();
    let sample = sample();
    for (name, bytes) in files() {
        let path = folder().join(name);
        std::fs::write(&path, &bytes).expect("temporary file");
        let mesh = Mesh::load(&path).expect(name);
        assert_eq!(corners(&mesh), sample.corners(), "{name}");
        assert_eq!((mesh.positions.len(), mesh.normals.len()), (6, 6), "{name}");
        if name.ends_with("stl") {
            assert!(mesh.texcoords.is_empty() && mesh.colors.is_empty() && mesh.materials.is_empty());
            continue;
        }
        assert_eq!(mesh.materials.len(), if name.ends_with("obj") { 2 } else { 1 }, "{name}");
        assert_eq!(mesh.materials[0].texture.as_deref(), Some(&texture()), "{name}");
        assert_eq!(mesh.material_of, [0; 8], "{name}");
        for (k, p) in mesh.positions.iter().enumerate() {
            let i = sample.positions.iter().position(|q| *q == p.to_array()).expect("a vertex of the sample");
            assert!((mesh.normals[k] - Vec3::from(sample.normals[i])).length() < 1e-6, "{name}");
            assert_eq!(mesh.texcoords[k], Vec2::from(sample.texcoords[i]), "{name}");
            let color = Vec3::from(sample.colors[i].map(f32::from)) / 255.0;
            assert!((mesh.colors[k] - color).length() < 1e-6, "{name}: {} {color}", mesh.colors[k]);
        }
    }
}

#[test]
fn normals_that_are_left_out_are_weighted_by_area() {
    let _alone = alone();
    let sample = sample();
    let weighted = parse("x.stl", &stl_binary(&sample)).expect("a good file");
    let mut sums = vec![DVec3::ZERO; 6];
    for t in &weighted.triangles {
        let [a, b, c] = t.map(|i| weighted.positions[i as usize].as_dvec3());
        t.iter().for_each(|&i| sums[i as usize] += (b - a).cross(c - a));
    }
    for (normal, sum) in weighted.normals.iter().zip(&sums) {
        assert!((normal.as_dvec3() - sum.normalize()).length() < 1e-6);
    }
    let text = String::from_utf8(ply(&sample, Order::Ascii)).expect("text");
    let plain = parse("x.ply", text.replace("float n", "float other_n").as_bytes()).expect("a good file");
    for (p, normal) in plain.positions.iter().zip(&plain.normals) {
        let k = weighted.positions.iter().position(|q| q == p).expect("the same vertex");
        assert!((*normal - weighted.normals[k]).length() < 1e-6);
    }
}

#[test]
fn ply_says_things_in_many_ways() {
    let _alone = alone();
    let read = |text: &str| parse("x.ply", text.as_bytes());
    let vertices = "element vertex 4\nproperty double x\nproperty float64 y\nproperty int z\n";
    let body = "0 0 0 1 0 0 1 1 0 0 1 0\n";
    let square = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
    let header = |more: &str| format!("ply\r\nformat ascii 1.0\r\ncomment x\r\n{more}end_header\r\n");
    let faces = "element face 2\nproperty list int int vertex_index\n";
    let mesh = read(&(header(&format!("{vertices}{faces}")) + body + "4 0 1 2 3\n3 0 1 9")).expect("good");
    assert_eq!((&mesh.positions[..], &mesh.triangles[..]), (&square[..], &[[0, 1, 2], [0, 2, 3]][..]));
    let first = header(&format!("{faces}element nothing 4294967295\n{vertices}"));
    let mesh = read(&(first + "4 0 1 2 3\n2 1 2\n" + body)).expect("faces before vertices, items of nothing");
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    let strips = "element tristrips 1\nproperty list int int vertex_indices\n";
    let mesh = read(&(header(&format!("{vertices}{strips}")) + body + "8 0 1 3 2 -1 0 1 2")).expect("strips");
    assert_eq!(mesh.triangles, [[0, 1, 3], [3, 1, 2], [0, 1, 2]]);
    let mesh = read(&(header(&format!("{vertices}{faces}")) + "0 0 nan " + &body[6..] + "4 1 2 3 0 3 1 2 3"));
    assert_eq!(mesh.expect("good").triangles, [[1, 2, 3], [1, 2, 3]], "not finite drops triangles");
    for (text, says) in [
        (header(&format!("{vertices}{faces}")) + body + "4 0 1 2", "`face` 0 of 2"),
        (header(vertices) + "0 0", "`vertex` 0 of 4"),
        (header("element vertex 3\nproperty float x\n"), "no x, y and z"),
        (header("element vertex 99999999\nproperty float x\n"), "8388608 vertices"),
        (header(&format!("{vertices}{faces}")) + body + "-4 0 1 2 3", "list of -4"),
        (header("property float x\n"), "before any element"),
        (header("element vertex many\n"), "no count"),
        (header("element vertex 3\nproperty quad x\n"), "`quad`"),
        ("ply\nformat text 1.0\nend_header\n".into(), "`text`"),
        ("ply\nend_header\n".into(), "no format"),
        ("ply\nformat ascii 1.0\n".into(), "end_header"),
        ("play\n".into(), "first line"),
    ] {
        let error = read(&text).expect_err(&text);
        assert!(error.contains(says) && error.contains("x.ply"), "{text}: {error}");
    }
}

#[test]
fn stl_may_be_loose_but_not_cut_short() {
    let _alone = alone();
    let read = |text: &str| parse("x.STL", text.as_bytes());
    let quad = "SOLID vertex 1 2 3\r\nfacet normal 0 0 1\r\nouter loop\r\nvertex 0 0 0\r\nvertex 1 0 0\r\nvertex 1 1 0\r\n\
                vertex -0 1 0\r\nendloop\r\nendfacet\r\nendsolid x\r\nsolid y\r\nendsolid y";
    let mesh = read(quad).expect("good");
    assert_eq!((mesh.positions.len(), &mesh.triangles[..]), (4, &[[0, 1, 2], [0, 2, 3]][..]));
    assert!(mesh.normals.iter().all(|&n| n == Vec3::Z));
    assert_eq!(
        read(&quad.replace("1 1 0", "1 one 0")).expect("good").triangles.len(),
        0,
        "both use that corner"
    );
    assert!(read(&quad[..quad.len() - 10]).expect_err("cut").contains("endsolid"));
    let binary = stl_binary(&sample());
    let cut = parse("x.stl", &[&[0; 80][..], &binary[80..200]].concat()).expect_err("cut");
    assert!(cut.contains("2 of 8 triangles"), "{cut}");
    assert_eq!(
        parse("x.stl", &[&[0; 80][..], &binary[80..], &[7; 9]].concat()).expect("longer").triangles.len(),
        8
    );
    assert!(parse("x.stl", b"").expect_err("empty").contains("header"));
}
