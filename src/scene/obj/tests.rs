//! One small case a rule (contracts: `draw`), and broken files that must not matter.

use super::*;
use crate::pixels::{Rgb, picture};
use crate::scene::Wrap;

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

fn mesh(text: &str) -> Mesh {
    Mesh::from_obj(text.as_bytes()).expect("within limits")
}

fn triangles(faces: &str) -> usize {
    mesh(&format!("{SQUARE}{faces}\n")).triangles.len()
}

#[test]
fn faces_are_fans_from_the_first_corner() {
    let square = mesh(&format!("{SQUARE}f 1 2 3 4"));
    assert_eq!(square.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(square.positions.len(), 4);
    assert!(square.texcoords.is_empty() && square.materials.is_empty());
    assert!(square.normals.iter().all(|&n| n == Vec3::Z));
}

#[test]
fn broken_corners_drop_the_face() {
    for face in
        ["f 0 1 2 3", "f 1 2 x 3", "f 1 2 -5", "f 1 2 -0", "f 1 2", "f", "f 1 2 3.5", "f 1 2 /3", "f 1 2 --3"]
    {
        assert_eq!(triangles(face), 0, "{face}");
    }
    assert_eq!(triangles("f -4 -3 -2 -1"), 2);
    assert_eq!(triangles("f 1 2 0\nf 1 2 3"), 1, "and no other face");
}

#[test]
fn positions_out_of_range_or_not_finite_drop_their_triangles() {
    assert_eq!(triangles("f 1 2 3 9 4"), 1);
    assert_eq!(triangles("f 9 1 2 3"), 0, "every triangle of a fan has its first corner");
    assert_eq!(triangles("f 1 2 99999999999999999999999 3 4"), 1);
    assert_eq!(triangles("v nan 0 0\nf 1 2 5 3 4"), 1);
    assert_eq!(triangles("v 0 inf 0\nf 1 2 3 5"), 1);
    assert_eq!(triangles("v 0 zero 0\nf 1 2 3 5"), 1);
    assert_eq!(triangles("v 0 0\nf 1 2 3 5"), 1, "a missing coordinate");
}

#[test]
fn references_may_run_ahead() {
    assert_eq!(mesh(&format!("f 1 2 3\n{SQUARE}")).triangles.len(), 1);
    let ahead = mesh(&format!("f 1//1 2//1 3//1\n{SQUARE}vn 1 0 0"));
    assert!(ahead.normals.iter().all(|&n| n == Vec3::X));
}

#[test]
fn normals_fall_back_by_position() {
    for bad in ["1//", "1//0", "1//7", "1//-2", "1//x", "1", "1/9/9"] {
        let square = mesh(&format!("{SQUARE}vn 2 0 0\nf {bad} 2//1 3//1"));
        assert_eq!(square.normals, [Vec3::Z, Vec3::X, Vec3::X], "{bad}");
    }
    for bad in ["vn 0 0 0", "vn nan 0 0", "vn 1 0"] {
        let square = mesh(&format!("{SQUARE}{bad}\nf 1//1 2//1 3//1"));
        assert!(square.normals.iter().all(|&n| n == Vec3::Z), "{bad}");
    }
    // two triangles of area 1/2 and 2 at right angles meet in positions 1 and 2
    let bent = mesh("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 -4\nf 1 2 3\nf 1 2 4\n");
    let expected = Vec3::new(0.0, 4.0, 1.0).normalize();
    assert!((bent.normals[0] - expected).length() < 1e-6, "{:?}", bent.normals);
}

#[test]
fn texture_coordinates_never_drop_a_face() {
    for bad in ["1/9", "1/0", "1/x", "1/-7", "1/"] {
        assert_eq!(triangles(&format!("vt 0 0\nf {bad} 2/1 3/1")), 1, "{bad}");
    }
    let seam = mesh(&format!("{SQUARE}vt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 3/1 4/1"));
    assert_eq!((seam.positions.len(), seam.texcoords.len()), (5, 5));
    assert_eq!(seam.normals[0], seam.normals[3], "a seam keeps the normal of its position");
}

#[test]
fn lines_may_end_and_continue_in_every_way() {
    let plain = mesh(&format!("{SQUARE}f 1 2 3 4\n"));
    let text = format!("{SQUARE}f 1 2 3 4\n");
    assert_eq!(mesh(&text.replace('\n', "\r\n")), plain);
    assert_eq!(mesh(&text.replace('\n', "\r")), plain);
    assert_eq!(mesh(&text.replace(' ', "\t")), plain);
    assert_eq!(mesh(&format!("\u{feff}{text}")), plain);
    assert_eq!(mesh(&text.replace("1 2 3 4", "1 2 \\\n3 4")), plain);
    assert_eq!(mesh(&text.replace("1 2 3 4", "1 2 \\\r\n 3 4 # done")), plain);
    assert_eq!(mesh(&text.replace("3 4\n", "3 4# 5 6\n")), plain);
    assert_eq!(mesh(&format!("# C:\\models\\\n{text}")), plain, "a comment is not continued");
    assert_eq!(mesh(&format!("o x\ng a b\ns 1\np 1\nl 1 2\ncurv 1\n  {text}")), plain);
    assert_eq!(mesh("v 0 0 0 1\nv 1 0 0 1\nv 1 1 0 1\nv 0 1 0\nf 1 2 3 4"), plain);
}

#[test]
fn positions_may_carry_colors() {
    let plain = mesh(&format!("{SQUARE}f 1 2 3 4\n"));
    let colored = mesh("v 0 0 0 1\nv 1 0 0 .5 .25 2\nv 1 1 0 1 1 0 0\nv 0 1 0 nan 0 0\nf 1 2 3 4");
    let half = Vec3::new(0.5, 0.25, 1.0);
    assert_eq!(colored.colors, [Vec3::ONE, half, Vec3::X, Vec3::ONE]);
    assert_eq!(Mesh { colors: Vec::new(), ..colored }, plain);
}

#[test]
fn utf_16_is_read() {
    let plain = mesh(&format!("{SQUARE}f 1 2 3 4\n"));
    let units: Vec<u16> = format!("\u{feff}{SQUARE}f 1 2 3 4\n").encode_utf16().collect();
    let little: Vec<u8> = units.iter().flat_map(|u| u.to_le_bytes()).collect();
    let big: Vec<u8> = units.iter().flat_map(|u| u.to_be_bytes()).collect();
    for bytes in [&little[..], &big, &little[2..], &big[2..]] {
        assert_eq!(Mesh::from_obj(bytes).expect("within limits"), plain);
    }
}

#[test]
fn every_truncation_and_many_mutations_load() {
    let text = format!(
        "\u{feff}# s\n{SQUARE}vn 0 0 1\nvt 0 1\nusemtl a\nf 1/1/1 2//1 \\\n 3/1 -1\nf 4 3 2\nf 1 2 -99\n"
    );
    for end in 0..text.len() {
        assert!(Mesh::from_obj(&text.as_bytes()[..end]).is_some());
    }
    let mut rng = crate::pixels::SplitMix64::new(1);
    for _ in 0..20_000 {
        let mut bytes = text.clone().into_bytes();
        for _ in 0..rng.int(1, 4) {
            let at = rng.int(0, bytes.len() as i64 - 1) as usize;
            bytes[at] = rng.next_u64() as u8;
        }
        assert!(Mesh::from_obj(&bytes).is_some());
    }
}

#[test]
fn limits_refuse_with_the_files_name() {
    let path = std::env::temp_dir().join(format!("vernissage-limits-{}.obj", std::process::id()));
    std::fs::write(&path, format!("{SQUARE}f 1 2 3 4\n")).expect("temporary file");
    let refused = |limits| Mesh::load_within(&path, &limits).expect_err("above a limit").to_string();
    let all = Limits::default();
    for (limits, what) in [
        (Limits { bytes: 10, ..all }, "10 bytes"),
        (Limits { vertices: 3, ..all }, "3 positions"),
        (Limits { triangles: 1, ..all }, "1 triangles"),
    ] {
        let message = refused(limits);
        assert!(message.contains(what) && message.contains("vernissage-limits"), "{message}");
    }
    std::fs::remove_file(&path).expect("temporary file");
    assert!(Mesh::load(&path).expect_err("gone").to_string().contains("cannot read model"));
}

#[test]
fn materials_and_textures_come_along() {
    let folder = std::env::temp_dir().join(format!("vernissage-mtl-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("temporary file");
    let texture = Rgb::new(crate::pixels::Size::new(2, 3), [10, 20, 30]);
    picture::write_png(&folder.join("a b.png"), &texture).expect("temporary file");
    write(
        "m.mtl",
        "newmtl red\nKd 1 0 0\nnewmtl wood\nKd .5\nmap_Kd -s 1 1 -clamp on a b.png\nnewmtl lost\nmap_Kd none.png\n",
    );
    write(
        "m.obj",
        &format!(
            "mtllib none.mtl\nmtllib m.mtl\n{SQUARE}usemtl wood\nf 1 2 3\nusemtl what\nf 1 2 3\nusemtl red\nf 1 3 4\n"
        ),
    );
    let mesh = Mesh::load(&folder.join("m.obj")).expect("loads");
    std::fs::remove_dir_all(&folder).expect("temporary folder");
    assert_eq!(mesh.material_of, [1, u16::MAX, 0]);
    assert_eq!(mesh.materials[0].color, Vec3::X);
    assert_eq!(mesh.materials[1].color, Vec3::splat(0.5));
    assert_eq!(mesh.materials[1].texture.as_deref(), Some(&texture));
    assert_eq!(mesh.materials[1].wrap, [Wrap::Clamp; 2]);
    assert!(mesh.materials[2].texture.is_none() && mesh.materials[2].wrap == [Wrap::Repeat; 2]);
}
