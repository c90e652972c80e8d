//! Contour → quadrilateral in ideal pixels, or a refusal.
//!
//! The farthest point of a convex outline is a corner, and so is the farthest from that one and the farthest
//! on either side of the line between the two: four corners in three passes. Then lines are fitted to the
//! points between corners (total least squares), intersected, and the points shared out again. What is not a
//! quadrilateral leaves large residuals or the wrong area and is dropped.

use super::contour::{Crack, MOST_OPEN_PX};
use super::rectify::Rectify;
use glam::DVec2;
use std::cell::RefCell;

/// A convex quadrilateral in ideal pixels, corners clockwise as seen.
pub type Quad = [DVec2; 4];

/// Most points of a contour that are looked at.
const MOST_POINTS: usize = 256;

/// Least length of a side, px.
pub const LEAST_SIDE_PX: f64 = 5.0;

/// Why a contour is no quadrilateral's outline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Its shape.
    Shape,
    /// Sides are there, but with dents or bumps.
    Bumpy,
}

/// The quadrilateral whose outline the contour is. `area`: enclosed px²; `step`: pixels of the whole picture along one
/// of the contour's; `origin`: where the contour's picture begins in it.
pub fn fit(
    contour: &[Crack],
    area: i64,
    step: u32,
    origin: DVec2,
    rectify: &Rectify,
) -> Result<Quad, Refusal> {
    if contour.len() < 16 {
        return Err(Refusal::Shape);
    }
    POINTS.with_borrow_mut(|points| {
        // lines do not get better from more points than this, and what is accepted is aligned to the pixels later
        let every = contour.len().div_ceil(MOST_POINTS);
        let ideal = seen(step, origin, rectify);
        let mut count = 0;
        for (point, &[x, y]) in points.iter_mut().zip(contour.iter().step_by(every)) {
            *point = ideal(DVec2::new(f64::from(x), f64::from(y)));
            count += 1;
        }
        let (points, step) = (&points[..count], f64::from(step));
        // a strong lens shows things in its corners half as large as they are
        let area = if rectify.bends() { enclosed(points) } else { area as f64 * step * step };
        let corners = corners_of(points, area).ok_or(Refusal::Shape)?;
        fit_sides(points, corners, area, step, every).ok_or(Refusal::Bumpy)
    })
}

/// From half pixels of the contour's picture to ideal pixels of the whole one.
fn seen(step: u32, origin: DVec2, rectify: &Rectify) -> impl Fn(DVec2) -> DVec2 {
    let step = f64::from(step);
    let shift = origin + 0.5 * (step - 1.0);
    move |crack| rectify.ideal(crack * (0.5 * step) + shift)
}

/// The quadrilateral around a small contour that is open or has dents, by its convex hull: where blur lightens the
/// border beside white bits it has both. Arguments as those of `fit`.
pub fn fit_hull(contour: &[Crack], step: u32, origin: DVec2, rectify: &Rectify) -> Option<Quad> {
    let mut hull = [[0i16; 2]; HULL_POINTS];
    let count = hull_of(contour, &mut hull)?;
    let hull = &hull[..count];
    if !is_four_sided(hull) {
        return None;
    }
    POINTS.with_borrow_mut(|points| {
        let ideal = seen(step, origin, rectify);
        let at = |[x, y]: [i16; 2]| DVec2::new(f64::from(x), f64::from(y));
        let mut count = 0;
        let mut from = at(*hull.last()?);
        for to in hull.iter().map(|&corner| at(corner)) {
            // a point a pixel of the contour's picture, about
            let steps = ((to - from).length() * 0.5).ceil();
            for k in 1..=steps as usize {
                *points.get_mut(count)? = ideal(from + (to - from) * (k as f64 / steps));
                count += 1;
            }
            from = to;
        }
        let points = points.get(..count).filter(|_| count >= 16)?;
        let area = enclosed(points);
        fit_sides(points, corners_of(points, area)?, area, f64::from(step), 1)
    })
}

/// The corners of a contour's convex hull, clockwise as seen, and how many; `None` of a contour that is too high.
fn hull_of(contour: &[Crack], hull: &mut [Crack; HULL_POINTS]) -> Option<usize> {
    let low = contour.iter().map(|[_, y]| *y).min()?;
    let mut sides = [[i16::MAX, i16::MIN]; HULL_ROWS];
    for &[x, y] in contour {
        let side = sides.get_mut((y - low) as usize)?;
        *side = [side[0].min(x), side[1].max(x)];
    }
    let mut count = 0;
    // down the right side and up the left one; a corner goes where the outline would turn left
    let mut add = |first: usize, p: Crack| {
        while count >= first + 2 {
            let [a, b, p] = [hull[count - 2], hull[count - 1], p].map(|v| v.map(i32::from));
            if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0 {
                break;
            }
            count -= 1;
        }
        hull[count] = p;
        count += 1;
        count
    };
    let rows = || sides.iter().enumerate().filter(|(_, side)| side[0] <= side[1]);
    let mut half = 0;
    for (row, side) in rows() {
        half = add(0, [side[1], low + row as i16]);
    }
    for (row, side) in rows().rev() {
        add(half, [side[0], low + row as i16]);
    }
    Some(count)
}

/// Whether four of the hull's corners make up nearly all of it.
fn is_four_sided(hull: &[Crack]) -> bool {
    let at = |i: usize| hull[i].map(i32::from);
    let twice =
        |a: [i32; 2], b: [i32; 2], c: [i32; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let whole: i32 = (1..hull.len().saturating_sub(1)).map(|i| twice(at(0), at(i), at(i + 1))).sum();
    let far = |from: [i32; 2]| {
        (0..hull.len()).max_by_key(|&i| {
            let [x, y] = [at(i)[0] - from[0], at(i)[1] - from[1]];
            x * x + y * y
        })
    };
    let Some((a, b)) = far(at(0)).and_then(|a| Some((a, far(at(a))?))) else { return false };
    let (a, b) = (a.min(b), a.max(b));
    let most = |range: &mut dyn Iterator<Item = usize>| range.map(|i| twice(at(a), at(i), at(b)).abs()).max();
    let one = most(&mut (a..b)).unwrap_or(0);
    let other = most(&mut (b..hull.len()).chain(0..a)).unwrap_or(0);
    f64::from(one + other) >= FOUR_SIDED * f64::from(whole)
}

/// Least share of a hull that is its four corners' quadrilateral.
const FOUR_SIDED: f64 = 0.83;

/// Corners that a hull may have.
const HULL_POINTS: usize = 2 * HULL_ROWS;

/// Rows of half pixels that a hull may have.
const HULL_ROWS: usize = 2 * MOST_OPEN_PX as usize + 4;

thread_local! {
    /// Each thread's own: laying them out anew would cost more than most fits do.
    static POINTS: RefCell<[DVec2; MOST_POINTS]> = const { RefCell::new([DVec2::ZERO; MOST_POINTS]) };
}

/// Which points are nearest to the corners of a quadrilateral of that area, in their order.
fn corners_of(points: &[DVec2], area: f64) -> Option<[usize; 4]> {
    let count = points.len();
    // indices run at most once around; a division here would cost more than everything else
    let at = |i: usize| points[if i < count { i } else { i - count }];
    let farthest_from = |p: DVec2| farthest(0..count, |i| (at(i) - p).length_squared());
    let (a, _) = farthest_from(at(farthest_from(at(0))?.0))?;
    let (b, span) = farthest_from(at(a))?;
    let (a, b) = (a.min(b), a.max(b));
    let across = |from: usize, to: usize, sign: f64| {
        let (origin, along) = (at(from), at(to) - at(from));
        farthest(from + 1..to, |i| sign * along.perp_dot(at(i) - origin))
            .map(|(i, d)| (i, d / along.length()))
    };
    // clockwise with y down: the outline's points lie left of each chord, where perp_dot is negative
    let (c, far_c) = across(a, b, -1.0)?;
    let (d, far_d) = across(b, a + count, -1.0)?;
    let (least, most) = (far_c.min(far_d), far_c.max(far_d));
    let mut corners = if least > 0.12 * most || least > 0.1 * span.sqrt() {
        [a, c, b, d]
    } else {
        // a and b share a side: both other corners lie on one chain
        let (from, tip, to) = if far_c > far_d { (a, c, b) } else { (b, d, a + count) };
        let (e, far_e) = across(from, tip, -1.0)?;
        let (f, far_f) = across(tip, to, -1.0)?;
        if far_e > far_f { [from, e, tip, to] } else { [from, tip, f, to] }
    };
    corners.iter_mut().for_each(|i| *i %= count);
    corners.sort_unstable();
    let rough = corners.map(at);
    (is_convex(&rough) && fits_area(&rough, area)).then_some(corners)
}

/// Lines through the points between the corners, twice; `every`: one in how many of a contour's points these are.
fn fit_sides(points: &[DVec2], mut corners: [usize; 4], area: f64, step: f64, every: usize) -> Option<Quad> {
    let count = points.len();
    let at = |i: usize| points[if i < count { i } else { i - count }];
    let mut quad = [DVec2::ZERO; 4];
    for pass in 0..2 {
        let mut lines = [Line::default(); 4];
        for (side, line) in lines.iter_mut().enumerate() {
            let from = corners[side];
            let to = if side == 3 { corners[0] + count } else { corners[side + 1] };
            // noise and blur round the corners
            let margin = ((to - from) / 8).clamp(1, 6usize.div_ceil(every));
            if to < from + 2 * margin + 3 {
                return None;
            }
            *line = Line::through((from + margin..=to - margin).map(at))?;
            let length = (at(to) - at(from)).length();
            if line.rms > 2.0 * step + 0.02 * length {
                return None;
            }
            if pass == 1 && line.rms > 0.4 * step {
                // dents and bumps: once more without the points far off
                let old = *line;
                let reach = (2.0 * old.rms).max(0.7 * step);
                let near = (from + margin..=to - margin).map(at).filter(|&p| old.distance(p).abs() <= reach);
                *line = Line::through(near)?;
            }
            if pass == 1 && line.rms > 0.7 * step + 0.005 * length {
                return None;
            }
        }
        for side in 0..4 {
            quad[(side + 1) % 4] = lines[side].intersection(&lines[(side + 1) % 4])?;
        }
        if pass == 0 {
            for (corner, index) in quad.iter().zip(&mut corners) {
                *index = nearest(*index, count, |i| (at(i) - *corner).length_squared());
            }
            if !(corners.windows(2).all(|pair| pair[0] < pair[1])) {
                corners.sort_unstable();
            }
        }
    }
    (is_convex(&quad) && fits_area(&quad, area)).then_some(quad)
}

/// Whether the corners are finite, clockwise as seen, and no side is shorter than `LEAST_SIDE_PX`.
pub fn is_convex(quad: &Quad) -> bool {
    (0..4).all(|i| {
        let (p, q, r) = (quad[i], quad[(i + 1) % 4], quad[(i + 2) % 4]);
        let (side, next) = (q - p, r - q);
        side.length() >= LEAST_SIDE_PX && side.perp_dot(next) > 0.05 * side.length() * next.length()
    })
}

/// Area of the quadrilateral, px² (positive when clockwise as seen).
pub fn area(quad: &Quad) -> f64 {
    0.5 * (quad[2] - quad[0]).perp_dot(quad[3] - quad[1])
}

/// Area within an outline, px² (positive when clockwise as seen).
fn enclosed(points: &[DVec2]) -> f64 {
    let Some(&origin) = points.first() else { return 0.0 };
    points.windows(2).map(|pair| (pair[0] - origin).perp_dot(pair[1] - origin)).sum::<f64>() * 0.5
}

/// Dents and flags change areas much.
fn fits_area(quad: &Quad, contour: f64) -> bool {
    let ratio = area(quad) / contour;
    (0.75..=1.35).contains(&ratio)
}

/// The index of the greatest value, the first of equals; `None` for an empty range or values that are NaN.
fn farthest(range: std::ops::Range<usize>, value: impl Fn(usize) -> f64) -> Option<(usize, f64)> {
    let mut best = None;
    let mut most = f64::NEG_INFINITY;
    for i in range {
        let v = value(i);
        if v > most {
            (best, most) = (Some(i), v);
        }
    }
    best.map(|i| (i, most))
}

/// The contour index of least value near `start`: the corner moved by a few points, so a walk downhill finds it.
fn nearest(start: usize, count: usize, value: impl Fn(usize) -> f64) -> usize {
    let mut best = (start, value(start));
    for offset in 1..=8 {
        for i in [(start + offset) % count, (start + count - offset) % count] {
            let v = value(i);
            if v < best.1 {
                best = (i, v);
            }
        }
    }
    best.0
}

/// A line with unit normal: normal · p = offset.
#[derive(Clone, Copy, Debug, Default)]
pub struct Line {
    /// Unit normal.
    pub normal: DVec2,
    /// Distance of the line from the origin along the normal.
    pub offset: f64,
    /// Root mean square distance of the fitted points, px.
    pub rms: f64,
}

impl Line {
    /// Total least squares through points; `None` for fewer than 3 or when something is not finite.
    pub fn through(points: impl Iterator<Item = DVec2>) -> Option<Self> {
        let (mut count, mut s, mut origin) = (0u32, DVec2::ZERO, DVec2::ZERO);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for p in points {
            if count == 0 {
                origin = p;
            }
            // relative to the first point the squares stay small
            let p = p - origin;
            count += 1;
            s += p;
            xx += p.x * p.x;
            xy += p.x * p.y;
            yy += p.y * p.y;
        }
        if count < 3 {
            return None;
        }
        let n = f64::from(count);
        let mean = s / n;
        let (xx, xy, yy) = (xx / n - mean.x * mean.x, xy / n - mean.x * mean.y, yy / n - mean.y * mean.y);
        // smallest eigenvalue of the scatter and its vector
        let half = (xx - yy) * 0.5;
        let root = (half * half + xy * xy).sqrt();
        let least = ((xx + yy) * 0.5 - root).max(0.0);
        let along = if half >= 0.0 { DVec2::new(half + root, xy) } else { DVec2::new(xy, root - half) };
        let length = along.length();
        if !(length > 1e-12 && length.is_finite()) {
            return None;
        }
        let normal = DVec2::new(-along.y, along.x) / length;
        Some(Self { normal, offset: normal.dot(mean + origin), rms: least.sqrt() })
    }

    /// Signed distance of a point.
    pub fn distance(&self, p: DVec2) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// Where two lines meet; `None` when they are nearly parallel.
    pub fn intersection(&self, other: &Line) -> Option<DVec2> {
        let det = self.normal.perp_dot(other.normal);
        if det.is_nan() || det.abs() < 0.02 {
            return None;
        }
        let x = self.offset * other.normal.y - other.offset * self.normal.y;
        let y = other.offset * self.normal.x - self.offset * other.normal.x;
        Some(DVec2::new(x, y) / det)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Lens;
    use crate::pixels::Size;

    /// A turned square whose outline leads inside through a gap: no outline of a square, but its hull is one.
    #[test]
    fn the_hull_of_an_open_outline_is_its_square() {
        let lens = Lens::guess(Size::new(160, 120));
        let mut rectify = Rectify::default();
        rectify.prepare(&lens, lens.size);
        let (center, right) = (DVec2::new(60.0, 50.0), DVec2::new(0.96, 0.28));
        let at = |x: f64, y: f64| center + right * x + right.perp() * y;
        // clockwise as seen; in through the right side, around inside, out again
        let path = [
            (-15.0, -15.0),
            (15.0, -15.0),
            (15.0, -2.0),
            (9.0, -2.0),
            (9.0, -9.0),
            (-9.0, -9.0),
            (-9.0, 9.0),
            (9.0, 9.0),
            (9.0, 2.0),
            (15.0, 2.0),
            (15.0, 15.0),
            (-15.0, 15.0),
            (-15.0, -15.0),
        ];
        let mut contour = Vec::new();
        for pair in path.windows(2) {
            let (from, to) = (at(pair[0].0, pair[0].1), at(pair[1].0, pair[1].1));
            let steps = (to - from).length().ceil();
            for k in 0..steps as usize {
                let p = from + (to - from) * (k as f64 / steps);
                contour.push([(2.0 * p.x).round() as i16, (2.0 * p.y).round() as i16]);
            }
        }
        let area = 30 * 30 - 18 * 18 - 6 * 4;
        assert!(fit(&contour, area, 1, DVec2::ZERO, &rectify).is_err());
        let quad = fit_hull(&contour, 1, DVec2::ZERO, &rectify).expect("a square");
        for corner in [at(-15.0, -15.0), at(15.0, -15.0), at(15.0, 15.0), at(-15.0, 15.0)] {
            let least = quad.iter().map(|p| (*p - corner).length()).fold(f64::MAX, f64::min);
            assert!(least < 0.7, "{quad:?}");
        }
        // nothing at all, and what is no square
        assert_eq!(fit_hull(&[], 1, DVec2::ZERO, &rectify), None);
        let round = |k: i32| {
            [60.0 + 30.0 * libm::cos(f64::from(k) * 0.1), 60.0 + 30.0 * libm::sin(f64::from(k) * 0.1)]
        };
        let circle: Vec<Crack> = (0..63).map(|k| round(k).map(|v| v as i16)).collect();
        assert_eq!(fit_hull(&circle, 1, DVec2::ZERO, &rectify), None);
    }
}
