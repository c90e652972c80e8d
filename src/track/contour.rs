//! The outer contour of a blob, as the midpoints of the cracks between its pixels and the rest.
//!
//! Crack midpoints lie on the boundary without bias, where pixel centers would lie half a pixel inside. A
//! convex outline of w x h pixels has exactly 2(w + h) cracks, so that a contour is abandoned as soon as it is
//! clearly longer: text, foliage and noise cost no more than a marker of their size would. Small ones may be twice as
//! long: blur opens the border of small markers, and the outline leads inside.

use super::segment::Blob;
use super::threshold::Mask;

/// A crack midpoint in half pixels: `[2x, 2y]`.
pub type Crack = [i16; 2];

/// Longer sides of what may be open, px.
pub const MOST_OPEN_PX: u32 = 48;

/// Appends the contour of `blob`, clockwise as seen, to `points`; returns the enclosed area in px², holes
/// included, and whether the contour is open: too long for a quadrilateral, of a small blob. `None`, with `points`
/// as before, when it is too long for that.
pub fn trace(mask: &Mask, blob: &Blob, points: &mut Vec<Crack>) -> Option<(i64, bool)> {
    let from = points.len();
    let [w, h] = blob.extent();
    let convex = 2 * (w + h) as usize;
    // noise roughens edges: at a signal of 4 σ they are a third longer
    let closed = convex + convex / 2 + 16;
    let most = if w.max(h) <= MOST_OPEN_PX { 3 * convex + 16 } else { closed };
    let [x0, y0] = blob.start.map(i32::from);
    // (x, y): the pixel corner at the crack's end, upper left of pixel (x, y)
    let (mut x, mut y, mut direction) = (x0, y0, 0usize);
    let mut area = 0i64;
    loop {
        // step along the crack, blob on the right hand; then look at the two pixels ahead
        let (right, left);
        match direction {
            0 => {
                points.push([(2 * x) as i16, (2 * y - 1) as i16]);
                x += 1;
                (right, left) = ((x, y), (x, y - 1));
            }
            1 => {
                points.push([(2 * x - 1) as i16, (2 * y) as i16]);
                area += i64::from(x);
                y += 1;
                (right, left) = ((x - 1, y), (x, y));
            }
            2 => {
                points.push([(2 * x - 2) as i16, (2 * y - 1) as i16]);
                x -= 1;
                (right, left) = ((x - 1, y - 1), (x - 1, y));
            }
            _ => {
                points.push([(2 * x - 1) as i16, (2 * y - 2) as i16]);
                area -= i64::from(x);
                y -= 1;
                (right, left) = ((x, y - 1), (x - 1, y - 1));
            }
        }
        direction = if !mask.is_set(right.0, right.1) {
            (direction + 1) % 4
        } else if mask.is_set(left.0, left.1) {
            (direction + 3) % 4
        } else {
            direction
        };
        if (x, y, direction) == (x0, y0, 0) {
            return Some((area, points.len() - from > closed));
        }
        if points.len() - from > most {
            points.truncate(from);
            return None;
        }
    }
}
