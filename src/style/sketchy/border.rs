//! The sketched border: a frame around the picture, each side drawn a few times by an unsteady hand. It is laid out
//! once a picture size, on the plane that already holds the paper.

use crate::pixels::{Size, SplitMix64};
use tiny_skia::{FillRule, LineCap, Mask, Path, PathBuilder, Stroke, Transform};

/// Times that each side is drawn.
const PASSES: usize = 3;
/// Light that one pass keeps back.
const OPACITY: f32 = 0.55;

/// Multiplies what the border lets through into `ground`, rows `stride` samples apart. Nothing where the picture is
/// too small for a border.
pub fn draw(size: Size, seed: u64, ground: &mut [f32], stride: usize) {
    let side = size.width.min(size.height) as f64;
    let (Ok(width), Ok(height)) = (u32::try_from(size.width), u32::try_from(size.height)) else { return };
    let Some(mut mask) = Mask::new(width, height).filter(|_| side >= 16.0) else { return };
    let margin = (0.03 * side).max(2.0);
    let pen = Stroke { width: (1.0 + margin / 10.0) as f32, line_cap: LineCap::Round, ..Stroke::default() };
    let (right, bottom) = (size.width as f64 - margin, size.height as f64 - margin);
    let corners = [[margin, margin], [right, margin], [right, bottom], [margin, bottom]];
    let mut rng = SplitMix64::new(seed);
    for k in 0..corners.len() * PASSES {
        let ends = [corners[k % 4], corners[(k + 1) % 4]];
        let Some(line) = unsteady(ends, margin, &mut rng).and_then(|path| path.stroke(&pen, 1.0)) else {
            continue;
        };
        mask.clear();
        mask.fill_path(&line, FillRule::Winding, true, Transform::identity());
        for (row, covered) in ground.chunks_exact_mut(stride).zip(mask.data().chunks_exact(size.width)) {
            for (light, &covered) in row.iter_mut().zip(covered) {
                *light *= 1.0 - OPACITY * (f32::from(covered) / 255.0);
            }
        }
    }
}

/// A line from about one end to about the other, that may miss the corners by half the margin and strays by a
/// quarter of it on the way.
fn unsteady(ends: [[f64; 2]; 2], margin: f64, rng: &mut SplitMix64) -> Option<Path> {
    let mut about = |value: f64, by: f64| value + by * (2.0 * rng.f64() - 1.0);
    let [from, to] = ends;
    let length = (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
    let along = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
    let (first, last) = (about(0.0, margin / 2.0), about(length, margin / 2.0));
    let count = (length / (8.0 * margin)).ceil().max(2.0) as usize;
    let mut points = (0..=count).map(|i| {
        let (t, off) = (first + (last - first) * i as f64 / count as f64, about(0.0, margin / 4.0));
        [from[0] + t * along[0] - off * along[1], from[1] + t * along[1] + off * along[0]].map(|v| v as f32)
    });
    let mut path = PathBuilder::new();
    let [x, y] = points.next()?;
    path.move_to(x, y);
    // curves through the middles of the points, bent by the points
    let mut bend = points.next()?;
    for point in points {
        path.quad_to(bend[0], bend[1], (bend[0] + point[0]) / 2.0, (bend[1] + point[1]) / 2.0);
        bend = point;
    }
    path.line_to(bend[0], bend[1]);
    path.finish()
}
