//! Which pixels take part in the fit: those the blurred edges of the print reach, and a few of its flats.
//!
//! Every straight piece of an ink boundary, thickened by the kernel's half-width, is a box in the picture; row by row
//! the boxes' spans become a bit mask. No pixel is asked on its own.

use super::Fit;
use super::pattern::{MOST_CELLS, Pattern};
use crate::geometry::Homography;
use crate::track::MOST_SIDE_PX;
use crate::track::decode::View;
use crate::track::rectify::{self, Rectify};
use fearless_simd::{Simd, f32x8, i32x8, prelude::*};
use glam::{DMat3, DVec2};

/// Most pixels a fit looks at: bounds the work on large markers.
pub const MOST_SAMPLES: usize = 2560;
/// Pixels taken at once: a byte of the mask.
const RUN: usize = 8;
/// Cells of quiet zone that are looked at.
pub const QUIET: f64 = 0.45;
/// The kernel's half-width changes along a straight piece, seen at an angle, by less than this, px.
const SLACK_PX: f64 = 0.15;
/// Of the pixels no edge reaches, every `RUN`th of every so manieth row takes part, for the levels.
const FLAT_ROWS: usize = 2;
const FLATS: u64 = 0x0101_0101_0101_0101;
/// Kernels wider than this many cells, either way, reach nearly everything.
const WIDE_CELLS: f64 = 0.75;
/// Most pieces: every side of every cell.
const MOST_PIECES: usize = 2 * (MOST_CELLS + 1) * MOST_CELLS / RUN * RUN + RUN;
const WORDS: usize = MOST_SIDE_PX / 64 + 2;

/// Pixels as the fit sees them.
pub struct Samples {
    /// Ideal place relative to the fit's center, in its scale.
    pub x: [f32; MOST_SAMPLES],
    /// The same down.
    pub y: [f32; MOST_SAMPLES],
    /// Gray.
    pub gray: [f32; MOST_SAMPLES],
    /// How many there are.
    pub count: usize,
    /// Whether nothing was left out.
    pub whole: bool,
    reach: Reach,
    mask: Mask,
}

/// A bit for every pixel of a row.
type Mask = [u64; WORDS];

impl Samples {
    /// None yet.
    pub const NONE: Self = Self {
        x: [0.0; MOST_SAMPLES],
        y: [0.0; MOST_SAMPLES],
        gray: [0.0; MOST_SAMPLES],
        count: 0,
        whole: false,
        reach: Reach::NONE,
        mask: [0; WORDS],
    };
}

/// Fills `samples` with about `most` pixels at most: runs are left out evenly where there would be more.
#[inline(always)]
pub fn gather<S: Simd>(
    simd: S,
    view: &View<'_>,
    rectify: &Rectify,
    fit: &Fit,
    pattern: &Pattern,
    most: usize,
    samples: &mut Samples,
) {
    samples.count = 0;
    samples.whole = true;
    let place = Place { view, fit, map: Homography(fit.map), cells: pattern.cells as f64 };
    let cells = place.cells;
    let (Some(outer), size) = (place.square(-QUIET, cells + QUIET), view.luma.size()) else { return };
    let hidden = match pattern.picture {
        // what the picture's ink may reach is not known
        Some([from, to]) => {
            let wide = place.widest();
            place.square(f64::from(from) - wide, f64::from(to) + wide)
        }
        None => None,
    };
    let hidden = hidden.map(|corners| Outline::new(&corners));
    let outline = Outline::new(&outer);
    let [low, high] = outline.rows(size.height);
    let everything = place.widest() >= WIDE_CELLS;
    if !everything {
        samples.reach.lay(&place, pattern, rectify.bends());
    }
    let area = outline.area();
    let expected =
        if everything { area } else { samples.reach.area.min(area) + area / (RUN * FLAT_ROWS) as f64 };
    // runs are left out by a sequence that is even along every line
    let share = most as f64 / expected.max(1.0);
    samples.whole = share >= 1.0;
    let limit = (share * 65536.0).min(65536.0) as u32;
    let (center, scale) = (fit.center.as_vec2(), (1.0 / fit.scale) as f32);
    for y in low..high {
        let Some([from, to]) = outline.span(y as f64, size.width) else { continue };
        let within = from / 64..(to - 1) / 64 + 1;
        let mask = &mut samples.mask;
        let flats = if y % FLAT_ROWS == 0 { FLATS << (y / FLAT_ROWS * 3 % RUN) } else { 0 };
        mask[within.clone()].fill(if everything { !0 } else { flats });
        if !everything {
            samples.reach.row(simd, y, [from, to], mask);
        }
        mask[within.start] &= !0 << (from % 64);
        mask[within.end - 1] &= !0 >> (63 - (to - 1) % 64);
        if let Some(hidden) = &hidden
            && let Some(span) = hidden.span(y as f64, size.width)
        {
            set::<false>(mask, [span[0].max(from), span[1].min(to)]);
        }
        let line = view.luma.row(y);
        for k in within {
            let mut word = samples.mask[k];
            while word != 0 {
                let byte = word.trailing_zeros() as usize / RUN;
                let taken = word >> (byte * RUN) & 0xff;
                word &= !(0xff << (byte * RUN));
                let run = k * (64 / RUN) + byte;
                if (run as u32 * 49_471 + y as u32 * 37_345) & 0xffff >= limit {
                    continue;
                }
                if samples.count + RUN > MOST_SAMPLES {
                    return;
                }
                let (px, py) = rectify.run(simd, run * RUN, y);
                let (x, y_at) = ((px - center.x) * scale, (py - center.y) * scale);
                let mut gray = [0; RUN];
                for (gray, pixel) in gray.iter_mut().zip(&line[run * RUN..]) {
                    *gray = *pixel;
                }
                samples.push(x.into(), y_at.into(), gray, taken);
            }
        }
    }
}

impl Samples {
    /// Takes the lanes whose bits are set; there is room for all.
    #[inline(always)]
    fn push(&mut self, x: [f32; RUN], y: [f32; RUN], gray: [u8; RUN], taken: u64) {
        if taken == 0xff && self.count + RUN <= MOST_SAMPLES {
            let to = self.count..self.count + RUN;
            self.x[to.clone()].copy_from_slice(&x);
            self.y[to.clone()].copy_from_slice(&y);
            self.gray[to].copy_from_slice(&gray.map(f32::from));
            self.count += RUN;
            return;
        }
        for lane in 0..RUN {
            // overwritten by the next one where it is not taken
            let at = self.count % MOST_SAMPLES;
            (self.x[at], self.y[at], self.gray[at]) = (x[lane], y[lane], f32::from(gray[lane]));
            self.count += (taken >> lane & 1) as usize;
        }
    }
}

/// The matrix's columns as f32.
pub fn f32s(m: &DMat3) -> [[f32; 3]; 3] {
    [m.x_axis, m.y_axis, m.z_axis].map(|c| [c.x as f32, c.y as f32, c.z as f32])
}

/// Where the print lies in the picture.
struct Place<'a> {
    view: &'a View<'a>,
    fit: &'a Fit,
    map: Homography,
    cells: f64,
}

impl Place<'_> {
    /// Cell coordinates (from the border's top-left corner, down) → ideal pixels.
    fn ideal(&self, u: f64, v: f64) -> DVec2 {
        let to_square = 2.0 / self.cells;
        let p = DVec2::new(u * to_square - 1.0, 1.0 - v * to_square);
        self.fit.center + self.map.apply(p) * self.fit.scale
    }

    /// A square of the print from `low` to `high` cells either way, in seen pixels.
    fn square(&self, low: f64, high: f64) -> Option<[DVec2; 4]> {
        let corners = [(low, low), (high, low), (high, high), (low, high)]
            .map(|(u, v)| rectify::seen(self.view.lens, self.ideal(u, v)));
        corners.iter().all(|p| p.is_finite()).then_some(corners)
    }

    /// The kernel's half-width in cells where it is widest: at a corner.
    fn widest(&self) -> f64 {
        self.fit.widest_cells(self.cells).unwrap_or(f64::INFINITY)
    }

    /// The kernel's half-width, px, along a direction.
    fn half_width(&self, unit: DVec2) -> f64 {
        let [xx, xy, yy] = self.fit.blur;
        let square = xx * unit.x * unit.x + 2.0 * xy * unit.x * unit.y + yy * unit.y * unit.y;
        square.max(0.0).sqrt() * self.fit.scale
    }
}

/// A convex outline in the picture by its sides, each from its upper end.
struct Outline {
    sides: [(DVec2, f64, f64); 4],
    corners: [DVec2; 4],
}

impl Outline {
    fn new(corners: &[DVec2; 4]) -> Self {
        let side = |i: usize| {
            let (p, q) = (corners[i], corners[(i + 1) % 4]);
            let (p, q) = if p.y <= q.y { (p, q) } else { (q, p) };
            (p, q.y, (q.x - p.x) / (q.y - p.y).max(1e-9))
        };
        Self { sides: [side(0), side(1), side(2), side(3)], corners: *corners }
    }

    fn area(&self) -> f64 {
        let [a, b, c, d] = self.corners;
        0.5 * (c - a).perp_dot(d - b).abs()
    }

    /// First row, and the one after the last.
    fn rows(&self, height: usize) -> [usize; 2] {
        let (low, high) =
            self.corners.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.y), h.max(p.y)));
        [(low + 1.0).max(0.0) as usize, ((high + 1.0).max(0.0) as usize).min(height)]
    }

    /// First pixel in row `y`, and the one after the last.
    fn span(&self, y: f64, width: usize) -> Option<[usize; 2]> {
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for &(upper, lower, slope) in &self.sides {
            if lower >= y && upper.y <= y {
                let x = upper.x + (y - upper.y) * slope;
                (least, most) = (if x < least { x } else { least }, if x > most { x } else { most });
            }
        }
        let from = (least + 1.0).max(0.0) as usize;
        let to = ((most + 1.0).max(0.0) as usize).min(width);
        (from < to).then_some([from, to])
    }
}

/// Everything the print's edges reach: every piece of an ink boundary, thickened, as the two slabs that its box is cut
/// from. Pieces are sorted by their first row; lanes past the last one hold nothing.
struct Reach {
    /// First and last row.
    top: Lanes,
    bottom: Lanes,
    /// Middle.
    x: Lanes,
    y: Lanes,
    /// Of the slab along the boundary, then of the one across: how its middle moves along a row from one row to the
    /// next, and half its width along a row.
    slope: [Lanes; 2],
    half: [Lanes; 2],
    /// The same as they come.
    pieces: [Piece; MOST_PIECES],
    count: usize,
    /// Sum of the pieces' areas, px².
    area: f64,
    /// The pieces that the rows so far have met, and those of them that they have passed.
    met: usize,
    passed: usize,
}

type Lanes = [f32; MOST_PIECES];

/// A piece before it is sorted in: rows, middle, slopes, half widths.
type Piece = [f32; 8];

impl Reach {
    const NONE: Self = Self {
        top: [0.0; MOST_PIECES],
        bottom: [0.0; MOST_PIECES],
        x: [0.0; MOST_PIECES],
        y: [0.0; MOST_PIECES],
        slope: [[0.0; MOST_PIECES]; 2],
        half: [[0.0; MOST_PIECES]; 2],
        pieces: [[0.0; 8]; MOST_PIECES],
        count: 0,
        area: 0.0,
        met: 0,
        passed: 0,
    };

    /// Lays out the pieces: boundaries between unlike cells, joined along a line where the lens keeps it straight.
    fn lay(&mut self, place: &Place<'_>, pattern: &Pattern, bends: bool) {
        (self.count, self.area, self.met, self.passed) = (0, 0.0, 0, 0);
        for (upright, lines) in [true, false].into_iter().zip(&pattern.edges) {
            for (line, &bits) in lines.iter().enumerate() {
                let mut bits = u32::from(bits);
                while bits != 0 {
                    let from = bits.trailing_zeros();
                    let length = if bends { 1 } else { (bits >> from).trailing_ones() };
                    bits &= !(((1 << length) - 1) << from);
                    self.add(place, line, [from, from + length], upright);
                }
            }
        }
        let pieces = &mut self.pieces[..self.count];
        pieces.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let [slope_0, slope_1] = &mut self.slope;
        let [half_0, half_1] = &mut self.half;
        let lanes =
            [&mut self.top, &mut self.bottom, &mut self.x, &mut self.y, slope_0, slope_1, half_0, half_1];
        for (i, lane) in lanes.into_iter().enumerate() {
            for (lane, piece) in lane.iter_mut().zip(&*pieces) {
                *lane = piece[i];
            }
        }
        // a last group is whole
        let end = self.count.next_multiple_of(RUN).min(MOST_PIECES);
        for half in &mut self.half {
            half[self.count..end].fill(-1.0);
        }
    }

    fn add(&mut self, place: &Place<'_>, line: usize, ends: [u32; 2], upright: bool) {
        let [p, q] = ends.map(|k| {
            let (u, v) = if upright { (line as f64, f64::from(k)) } else { (f64::from(k), line as f64) };
            place.ideal(u, v)
        });
        let along = (q - p).normalize_or_zero();
        let half_width = place.half_width(along.perp()) + SLACK_PX;
        let [p, q] = [p, q].map(|p| rectify::seen(place.view.lens, p));
        let along = (q - p).normalize_or_zero();
        let half_length = 0.5 * (q - p).length() + half_width;
        if !(half_length.is_finite() && along != DVec2::ZERO) || self.count == MOST_PIECES {
            return;
        }
        let middle = (p + q) * 0.5;
        let tall = half_length * along.y.abs() + half_width * along.x.abs();
        // of lines that run along a row or a column the other slab decides
        let apart = |v: f64| if v.abs() < 1e-6 { 1e-6f64.copysign(v) } else { v };
        let (x, y) = (apart(along.x), apart(along.y));
        let piece = [
            middle.y - tall,
            middle.y + tall,
            middle.x,
            middle.y,
            x / y,
            -y / x,
            half_width / y.abs(),
            half_length / x.abs(),
        ];
        self.pieces[self.count] = piece.map(|v| v as f32);
        self.count += 1;
        self.area += 4.0 * half_width * (half_length - half_width);
    }

    /// Sets the bits of the pixels reached in a row; rows must come in order.
    #[inline(always)]
    fn row<S: Simd>(&mut self, simd: S, y: usize, [from, to]: [usize; 2], mask: &mut Mask) {
        let at = y as f32;
        while self.met < self.count && self.top[self.met] <= at {
            self.met += 1;
        }
        while self.passed < self.met && self.bottom[self.passed] < at {
            self.passed += 1;
        }
        for group in (self.passed / RUN * RUN..self.met).step_by(RUN) {
            let lanes = |lanes: &Lanes| f32x8::from_slice(simd, &lanes[group..group + RUN]);
            let down = f32x8::splat(simd, at) - lanes(&self.y);
            let (a, b) = (down * lanes(&self.slope[0]), down * lanes(&self.slope[1]));
            let (wide_a, wide_b) = (lanes(&self.half[0]), lanes(&self.half[1]));
            // from the first pixel inside to the one after the last
            let middle = lanes(&self.x) + 1.0;
            let low = (a - wide_a).max(b - wide_b) + middle;
            let high = (a + wide_a).min(b + wide_b) + middle;
            let start: i32x8<S> =
                low.max(f32x8::splat(simd, from as f32)).min(f32x8::splat(simd, to as f32)).to_int();
            let end: i32x8<S> = high.min(f32x8::splat(simd, to as f32)).max(f32x8::splat(simd, 0.0)).to_int();
            for (start, end) in start.as_slice().iter().zip(end.as_slice()) {
                if start < end {
                    set::<true>(mask, [*start as usize, *end as usize]);
                }
            }
        }
    }
}

/// Sets or clears the bits from the first to before the second.
#[inline(always)]
fn set<const ON: bool>(mask: &mut Mask, [from, to]: [usize; 2]) {
    let mut at = from;
    while at < to {
        let end = (at / 64 + 1) * 64;
        let bits = (!0u64 << (at % 64)) & (!0u64 >> (end - end.min(to)));
        let word = &mut mask[at / 64 % WORDS];
        *word = if ON { *word | bits } else { *word & !bits };
        at = end;
    }
}
