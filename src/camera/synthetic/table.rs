//! What lies on the synthetic camera's table: wood, a cloth, the printed sheet and a few plain objects.
//!
//! Marker space in mm, z up from the print. Textures are drawn with tiny-skia.

use super::Config;
use crate::marker::Family;
use crate::pixels::{Plane, Rgb, Size, SplitMix64};
use crate::scene::{Anchor, Light, Material, Mesh, Model, Scene, Shading};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use std::f32::consts::TAU;
use std::sync::Arc;
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// Direction towards the lamp, marker space.
pub const LAMP: DVec3 = DVec3::new(-0.45, 0.35, 0.82);

/// Half the table's side, mm.
const TABLE_MM: f32 = 700.0;

/// Pixels a marker cell in the sheet's texture.
const CELL_PX: usize = 24;

/// Sets the table.
pub fn lay(config: &Config) -> Scene {
    let side = config.side_mm as f32;
    let cells = config.family.cells() as f32;
    // the sheet has two cells of white around the border's outer edge
    let sheet = side / 2.0 * (cells + 4.0) / cells;
    let mut models = vec![
        model(
            "wall",
            Mesh::quad(
                Vec3::new(0.0, 900.0, 300.0),
                Vec3::X * 1500.0,
                Vec3::Z * 700.0,
                Material::plain(Vec3::new(0.70, 0.72, 0.68)),
            ),
        ),
        model(
            "table",
            Mesh::quad(Vec3::Z * -1.0, Vec3::X * TABLE_MM, Vec3::Y * TABLE_MM, textured(wood(config.seed))),
        ),
        model(
            "sheet",
            Mesh::quad(
                Vec3::ZERO,
                Vec3::X * sheet,
                Vec3::Y * sheet,
                textured(print(config.family, config.id)),
            ),
        ),
    ];
    let objects = [
        ("book", cuboid(Vec3::new(-150.0, 75.0, 14.0), Vec3::new(52.0, 75.0, 15.0), 0.3), [0.62, 0.16, 0.14]),
        (
            "booklet",
            cuboid(Vec3::new(-146.0, 70.0, 36.0), Vec3::new(40.0, 58.0, 7.0), 0.12),
            [0.18, 0.33, 0.52],
        ),
        ("mug", cylinder(Vec3::new(140.0, 90.0, -1.0), 38.0, 90.0), [0.88, 0.86, 0.80]),
        ("orange", ball(Vec3::new(150.0, -55.0, 33.0), 34.0), [0.93, 0.52, 0.10]),
        (
            "eraser",
            cuboid(Vec3::new(-125.0, -85.0, 7.0), Vec3::new(26.0, 11.0, 8.0), -0.5),
            [0.24, 0.55, 0.34],
        ),
    ];
    models.extend(objects.into_iter().map(|(name, mesh, color)| model(name, painted(mesh, color))));
    Scene { models, light: Light { ambient: 0.35, ..Light::default() }, ..Scene::default() }
}

fn textured(texture: Rgb) -> Material {
    Material::textured(Arc::new(texture))
}

fn painted(mut mesh: Mesh, color: [f32; 3]) -> Mesh {
    mesh.set_color(Vec3::from(color));
    mesh
}

fn model(name: &str, mesh: Mesh) -> Model {
    Model {
        name: name.into(),
        mesh: mesh.into(),
        anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 1.0 },
        to_marker: DAffine3::IDENTITY,
        shading: Shading::Smooth,
        cull_back: false,
        secondary: false,
        phantom: false,
    }
}

/// An upright box `center ± half`, turned by `turn` radians about z.
fn cuboid(center: Vec3, half: Vec3, turn: f32) -> Mesh {
    let (sin, cos) = libm::sincosf(turn);
    let (x, y) = (Vec3::new(cos, sin, 0.0) * half.x, Vec3::new(-sin, cos, 0.0) * half.y);
    let z = Vec3::Z * half.z;
    let faces = [(z, x, y), (x, y, z), (y, z, x), (-x, z, y), (-y, x, z)];
    faces.iter().fold(Mesh::default(), |mesh, &(out, u, v)| {
        join(mesh, Mesh::quad(center + out, u, v, Material::default()))
    })
}

/// An upright, closed cylinder standing on `foot`.
fn cylinder(foot: Vec3, radius: f32, height: f32) -> Mesh {
    const SIDES: usize = 48;
    let spoke = |i: usize| {
        let (sin, cos) = libm::sincosf(i as f32 / SIDES as f32 * TAU);
        Vec3::new(cos, sin, 0.0)
    };
    let mut mesh = Mesh::default();
    for i in 0..=SIDES {
        for z in [0.0, height] {
            mesh.positions.push(foot + spoke(i) * radius + Vec3::Z * z);
            mesh.normals.push(spoke(i));
        }
    }
    for i in 0..SIDES as u32 {
        mesh.triangles.extend([[2 * i, 2 * i + 2, 2 * i + 3], [2 * i, 2 * i + 3, 2 * i + 1]]);
    }
    let first = mesh.positions.len() as u32;
    for i in 0..SIDES {
        mesh.positions.push(foot + spoke(i) * radius + Vec3::Z * height);
        mesh.normals.push(Vec3::Z);
    }
    mesh.triangles.extend((1..SIDES as u32 - 1).map(|i| [first, first + i, first + i + 1]));
    mesh
}

/// A ball of latitude and longitude strips.
fn ball(center: Vec3, radius: f32) -> Mesh {
    const RINGS: usize = 24;
    const SIDES: usize = 48;
    let mut mesh = Mesh::default();
    for ring in 0..=RINGS {
        let (sin_p, cos_p) = libm::sincosf(ring as f32 / RINGS as f32 * TAU / 2.0);
        for i in 0..=SIDES {
            let (sin, cos) = libm::sincosf(i as f32 / SIDES as f32 * TAU);
            let out = Vec3::new(cos * sin_p, sin * sin_p, cos_p);
            mesh.positions.push(center + out * radius);
            mesh.normals.push(out);
        }
    }
    let row = SIDES as u32 + 1;
    for ring in 0..RINGS as u32 {
        for i in 0..SIDES as u32 {
            let a = ring * row + i;
            mesh.triangles.extend([[a, a + row, a + row + 1], [a, a + row + 1, a + 1]]);
        }
    }
    mesh
}

fn join(mut a: Mesh, b: Mesh) -> Mesh {
    let shift = a.positions.len() as u32;
    a.positions.extend(b.positions);
    a.normals.extend(b.normals);
    a.texcoords.extend(b.texcoords);
    a.materials = b.materials;
    a.material_of.extend(b.material_of);
    a.triangles.extend(b.triangles.iter().map(|t| t.map(|i| i + shift)));
    a
}

/// The printed sheet: the marker's cells with two cells of paper around, ink not quite black on paper not quite
/// white. An unknown id prints an empty frame.
fn print(family: Family, id: u32) -> Rgb {
    let side = (family.cells() + 4) * CELL_PX;
    let code = family.codes().get(id as usize).copied().unwrap_or_default();
    // cells counted from the border's outer edge; outside it the print is paper
    let cell = |v: usize| (v / CELL_PX) as isize - 2;
    let ink = |x: usize, y: usize| if family.is_white(code, cell(x), cell(y)) { 236 } else { 18 };
    let plane = Plane::from_fn(Size::new(side, side), ink);
    Rgb { planes: [plane.clone(), plane.clone(), plane] }
}

/// Planks with grain, and a woven cloth under the sheet.
fn wood(seed: u64) -> Rgb {
    const SIDE: u32 = 1024;
    let mut rng = SplitMix64::new(seed ^ 0x7ab1e);
    let mut unit = move || rng.f64() as f32;
    let Some(mut map) = Pixmap::new(SIDE, SIDE) else { return Rgb::new(Size::new(1, 1), [150, 110, 70]) };
    let side = SIDE as f32;
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    let planks = 7;
    for plank in 0..planks {
        let (top, height) = (side / planks as f32 * plank as f32, side / planks as f32);
        let tone = 0.85 + 0.25 * unit();
        paint.set_color(color(0.56 * tone, 0.40 * tone, 0.26 * tone));
        fill_rect(&mut map, &paint, 0.0, top, side, height - 2.0);
        for _ in 0..26 {
            let dark = 0.80 + 0.16 * unit();
            paint.set_color(color(0.56 * tone * dark, 0.40 * tone * dark, 0.26 * tone * dark));
            let (y, sway) = (top + (height - 4.0) * unit(), 7.0 * (unit() - 0.5));
            let mut grain = PathBuilder::new();
            grain.move_to(0.0, y);
            grain.cubic_to(side * 0.3, y + sway, side * 0.6, y - sway, side, y + sway * 0.5);
            let stroke = Stroke { width: 0.8 + 1.6 * unit(), ..Stroke::default() };
            if let Some(path) = grain.finish() {
                map.stroke_path(&path, &paint, &stroke, Transform::identity(), None);
            }
        }
    }
    cloth(&mut map, &mut paint);
    shadows(&mut map, &mut paint);
    let planes = [0, 1, 2].map(|c| {
        let size = Size::new(SIDE as usize, SIDE as usize);
        Plane::from_fn(size, |x, y| map.data()[(y * SIDE as usize + x) * 4 + c])
    });
    Rgb { planes }
}

/// A round blue cloth with rings and dots, its middle at the texture's middle.
fn cloth(map: &mut Pixmap, paint: &mut Paint<'_>) {
    let middle = map.width() as f32 / 2.0;
    let rings = [(215.0, [0.20, 0.33, 0.45]), (205.0, [0.80, 0.78, 0.70]), (196.0, [0.25, 0.40, 0.52])];
    for (radius, [r, g, b]) in rings {
        paint.set_color(color(r, g, b));
        fill_circle(map, paint, middle, middle, radius);
    }
    paint.set_color(color(0.82, 0.72, 0.44));
    for i in 0..36 {
        let (sin, cos) = libm::sincosf(i as f32 / 36.0 * TAU);
        fill_circle(map, paint, middle + 176.0 * cos, middle + 176.0 * sin, 6.0);
    }
}

/// Soft shadows of the objects, as the lamp throws them: (x, y, radius, height) in mm.
fn shadows(map: &mut Pixmap, paint: &mut Paint<'_>) {
    const STEPS: usize = 10;
    let objects = [
        (-150.0, 75.0, 68.0, 30.0),
        (140.0, 90.0, 40.0, 60.0),
        (150.0, -55.0, 26.0, 40.0),
        (-125.0, -85.0, 21.0, 14.0),
    ];
    let scale = map.width() as f32 / (2.0 * TABLE_MM);
    let away = -(LAMP.truncate() / LAMP.z).as_vec2();
    paint.set_color(Color::from_rgba8(0, 0, 0, 13));
    for (x, y, radius, height) in objects {
        for step in 0..STEPS {
            let t = step as f32 / STEPS as f32;
            let middle = Vec2::new(x, y) + away * height * 0.5;
            let px = (middle * Vec2::new(1.0, -1.0) + TABLE_MM) * scale;
            fill_circle(map, paint, px.x, px.y, scale * (radius * (1.45 - 0.6 * t)));
        }
    }
}

fn color(r: f32, g: f32, b: f32) -> Color {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    Color::from_rgba8(byte(r), byte(g), byte(b), 255)
}

fn fill_rect(map: &mut Pixmap, paint: &Paint<'_>, x: f32, y: f32, w: f32, h: f32) {
    if let Some(rect) = Rect::from_xywh(x, y, w, h) {
        map.fill_rect(rect, paint, Transform::identity(), None);
    }
}

fn fill_circle(map: &mut Pixmap, paint: &Paint<'_>, x: f32, y: f32, radius: f32) {
    if let Some(path) = PathBuilder::from_circle(x, y, radius) {
        map.fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
    }
}
