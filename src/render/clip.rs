//! The rare triangles: those that cross the near plane or leave the lens's field are cut, those whose edges
//! the lens bends are split. All decisions depend on one edge alone and are symmetric in its ends, so that
//! triangles sharing an edge cut it at the same bits.

use super::field::{Field, SPLIT_TOLERANCE_PX};
use super::vertex::{SUBPIXELS, Vertex};
use glam::{DVec2, DVec3};

/// Halvings of an edge at most: at 2^-12 of its length every edge in a picture is short.
const MAX_SPLITS: u32 = 12;

/// Even an edge that the lens leaves straight is split above this many px: a bend that is symmetric about
/// its middle does not show there.
const MAX_BENT_EDGE_PX: f64 = 64.0;

/// A triangle's corner in camera space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub point: DVec3,
    pub normal: DVec3,
    pub intensity: f64,
    pub uv: DVec2,
    pub color: DVec3,
}

impl Corner {
    /// `self·(1-t) + other·t`.
    fn toward(&self, other: &Self, t: f64) -> Self {
        self.weighted(other, 1.0 - t, t)
    }

    fn weighted(&self, other: &Self, a: f64, b: f64) -> Self {
        Self {
            point: self.point * a + other.point * b,
            normal: self.normal * a + other.normal * b,
            intensity: self.intensity * a + other.intensity * b,
            uv: self.uv * a + other.uv * b,
            color: self.color * a + other.color * b,
        }
    }

    /// Put on the picture; `None` outside near plane and field.
    fn project(&self, near: f64, field: &Field) -> Option<Seen> {
        let mut vertex = Vertex::project(self.point, near, field);
        vertex.of[1] = f64::from(self.intensity as f32);
        (vertex.w() > 0.0).then_some(Seen { corner: *self, vertex })
    }
}

/// A corner and where it is on the picture.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    pub corner: Corner,
    pub vertex: Vertex,
}

/// A triangle cut by near plane and field: a convex polygon of at most 3 + 5 corners.
struct Polygon {
    corners: [Corner; 8],
    count: usize,
}

impl Polygon {
    /// Keeps what lies on the plane's positive side (Sutherland & Hodgman 1974). Cuts run from the inner to
    /// the outer end whatever the direction of walking.
    fn cut(&mut self, distance: impl Fn(&Corner) -> f64, settle: impl Fn(&mut Corner)) {
        let source = self.corners;
        let count = std::mem::take(&mut self.count);
        let mut previous = count.wrapping_sub(1);
        for k in 0..count {
            let (a, b) = (&source[previous], &source[k]);
            let (da, db) = (distance(a), distance(b));
            if (da >= 0.0) != (db >= 0.0) {
                let mut corner =
                    if da >= 0.0 { a.toward(b, da / (da - db)) } else { b.toward(a, db / (db - da)) };
                settle(&mut corner);
                self.push(corner);
            }
            if db >= 0.0 {
                self.push(*b);
            }
            previous = k;
        }
    }

    fn push(&mut self, corner: Corner) {
        if let Some(place) = self.corners.get_mut(self.count) {
            *place = corner;
            self.count += 1;
        }
    }
}

/// Cuts and splits one triangle; `emit` receives the pieces, wound as the whole.
pub(super) fn cut(corners: [Corner; 3], near: f64, field: &Field, emit: &mut dyn FnMut(&[Seen; 3])) {
    let [a, b, c] = corners;
    let mut polygon = Polygon { corners: [a, b, c, a, a, a, a, a], count: 3 };
    polygon.cut(|p| p.point.z - near, |p| p.point.z = near);
    let (low, high) = field.bounds();
    // outside on one side only: nothing is left, and most that is not in view ends here
    polygon.cut(|p| p.point.x - low.x * p.point.z, |_| ());
    polygon.cut(|p| high.x * p.point.z - p.point.x, |_| ());
    polygon.cut(|p| p.point.y - low.y * p.point.z, |_| ());
    polygon.cut(|p| high.y * p.point.z - p.point.y, |_| ());
    for k in 2..polygon.count {
        let piece = [0, k - 1, k].map(|i| polygon.corners[i].project(near, field));
        let [Some(a), Some(b), Some(c)] = piece else { continue };
        if field.bends() {
            split([a, b, c], near, field, MAX_SPLITS, emit);
        } else {
            emit(&[a, b, c]);
        }
    }
}

/// Cuts and splits one line as the edges of triangles are; `emit` receives the pieces.
pub(super) fn cut_line(ends: [DVec3; 2], near: f64, field: &Field, emit: &mut dyn FnMut(&Vertex, &Vertex)) {
    let [a, b] = ends;
    let (low, high) = field.bounds();
    let (mut from, mut to) = (0.0, 1.0);
    let planes: [&dyn Fn(DVec3) -> f64; 5] =
        [&|p| p.z - near, &|p| p.x - low.x * p.z, &|p| high.x * p.z - p.x, &|p| p.y - low.y * p.z, &|p| {
            high.y * p.z - p.y
        }];
    for plane in planes {
        let (da, db) = (plane(a), plane(b));
        if da < 0.0 && db < 0.0 {
            return;
        }
        if da < 0.0 {
            from = f64::max(from, da / (da - db));
        } else if db < 0.0 {
            to = f64::min(to, da / (da - db));
        }
    }
    let seen = |t: f64| {
        let mut point = a * (1.0 - t) + b * t;
        point.z = point.z.max(near);
        let (normal, uv, color) = (DVec3::ZERO, DVec2::ZERO, DVec3::ONE);
        Corner { point, normal, intensity: 0.0, uv, color }.project(near, field)
    };
    if from <= to
        && let (Some(a), Some(b)) = (seen(from), seen(to))
    {
        split_line([a, b], near, field, MAX_SPLITS, emit);
    }
}

fn split_line(
    [a, b]: [Seen; 2],
    near: f64,
    field: &Field,
    left: u32,
    emit: &mut dyn FnMut(&Vertex, &Vertex),
) {
    let half = (left > 0 && field.bends()).then(|| middle(&a, &b, near, field)).flatten();
    match half {
        _ if off_picture([&a, &b, &b], field) => (),
        None => emit(&a.vertex, &b.vertex),
        Some(half) => {
            split_line([a, half], near, field, left - 1, emit);
            split_line([half, b], near, field, left - 1, emit);
        }
    }
}

/// Whether an edge is long enough on the picture for the lens to bend it; cheap and on the safe side.
pub(super) fn may_bend(a: &Vertex, b: &Vertex, field: &Field) -> bool {
    let (dx, dy) = (b.at[0] - a.at[0], b.at[1] - a.at[1]);
    let limit = field.straight_px().min(MAX_BENT_EDGE_PX);
    dx * dx + dy * dy > limit * limit
}

/// Sides of a box, 1/256 px, inside which no edge may bend.
pub(super) fn straight_box(field: &Field) -> i32 {
    let limit = field.straight_px().min(MAX_BENT_EDGE_PX);
    // a hair less than the square in the circle, and snapping adds a step a side
    (limit * 0.7 * SUBPIXELS) as i32 - 2
}

/// The middle of an edge before the lens, where the drawn edge would miss the bent one.
fn middle(a: &Seen, b: &Seen, near: f64, field: &Field) -> Option<Seen> {
    if !may_bend(&a.vertex, &b.vertex, field) {
        return None;
    }
    // weights 1/z: half-way on the undistorted picture; the sums are symmetric in a and b
    let (wa, wb) = (a.vertex.w(), b.vertex.w());
    let sum = wa + wb;
    let mut corner = a.corner.weighted(&b.corner, wa / sum, wb / sum);
    corner.point.z = corner.point.z.max(near);
    let seen = corner.project(near, field)?;
    let (from, to) = (DVec2::from(a.vertex.at), DVec2::from(b.vertex.at));
    let miss = DVec2::from(seen.vertex.at) - (from + to) / 2.0;
    let length = (to - from).length_squared().sqrt();
    let bent = miss.length_squared() > SPLIT_TOLERANCE_PX * SPLIT_TOLERANCE_PX || length > MAX_BENT_EDGE_PX;
    bent.then_some(seen)
}

fn split([a, b, c]: [Seen; 3], near: f64, field: &Field, left: u32, emit: &mut dyn FnMut(&[Seen; 3])) {
    let middles = match left {
        0 => [None; 3],
        _ => [middle(&a, &b, near, field), middle(&b, &c, near, field), middle(&c, &a, near, field)],
    };
    if off_picture([&a, &b, &c], field) {
        return;
    }
    let mut go = |pieces: &[[Seen; 3]]| {
        for &piece in pieces {
            split(piece, near, field, left.saturating_sub(1), emit);
        }
    };
    match middles {
        [None, None, None] => emit(&[a, b, c]),
        [Some(ab), None, None] => go(&[[a, ab, c], [ab, b, c]]),
        [None, Some(bc), None] => go(&[[a, b, bc], [a, bc, c]]),
        [None, None, Some(ca)] => go(&[[a, b, ca], [ca, b, c]]),
        [Some(ab), Some(bc), None] => go(&[[ab, b, bc], [a, ab, bc], [a, bc, c]]),
        [None, Some(bc), Some(ca)] => go(&[[ca, bc, c], [a, b, bc], [a, bc, ca]]),
        [Some(ab), None, Some(ca)] => go(&[[a, ab, ca], [ab, b, c], [ab, c, ca]]),
        [Some(ab), Some(bc), Some(ca)] => go(&[[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]),
    }
}

/// Whether the triangle is off the picture by more than its own size: no bend brings it back.
fn off_picture(corners: [&Seen; 3], field: &Field) -> bool {
    let at = corners.map(|seen| DVec2::from(seen.vertex.at));
    let (low, high) = (at[0].min(at[1]).min(at[2]), at[0].max(at[1]).max(at[2]));
    let margin = (high - low).max_element();
    let size = DVec2::new(field.lens().size.width as f64, field.lens().size.height as f64);
    (high + margin).min_element() < -1.0 || (low - margin - size).max_element() > 0.0
}
