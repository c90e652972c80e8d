//! A marker that is known: where it is expected, whether what is there is it, and its pose over time.
//!
//! Comes in: a picture; goes out: the marker's new place, or that it is out of sight. It must explain the picture as
//! its own code or picture, so that another one never takes its place.

use super::align::{self, Aligned, Pattern, Start};
use super::decode::{self, Decoded, Level, View};
use super::filter::Filter;
use super::mean_side;
use super::quad::Quad;
use super::rectify::{self, Rectify};
use super::solve::{self, Minimum};
use crate::frame::{Sighting, Solved, State};
use crate::geometry::{Homography, Lens, Pose};
use crate::marker::{Family, Ink, Patterns, Polarity};
use crate::pixels::{Size, simd};
use glam::{DMat3, DVec2, DVec3};

/// Pixels a followed marker is aligned with.
const SAMPLES: usize = 720;
/// Predictions this good need no thin set first, px; least and most doubt about the others.
const SURE_PX: f64 = 0.3;
const LEAST_DOUBT_PX: f64 = 0.4;
const MOST_DOUBT_PX: f64 = 2.5;
/// Least share of robust weights, and most residual of the contrast, where the print explains the picture.
const LEAST_SHARE: f64 = 0.75;
const MOST_RESIDUAL: f64 = 0.2;
/// Least gray step from black to white, and of what it was.
const LEAST_CONTRAST: f64 = 8.0;
const LEAST_KEPT: f64 = 0.4;
/// Most χ² that a picture says for or against a minimum, what is remembered of it, and how much decides.
const MOST_SAID: f64 = 8.0;
const REMEMBERED: f64 = 0.95;
const DECIDES: f64 = 20.0;
/// A minimum that costs more than this, and this times the other's, is not meant.
const CLEAR: f64 = 40.0;
/// Most reprojection error of a followed marker: times the last one, and px more.
const ERROR_GROWS: f64 = 3.0;
const MOST_ERROR_PX: f64 = 0.5;
/// How long a marker out of sight is thought to go on as it did.
const MOST_AHEAD_S: f64 = 0.1;

/// A marker that is known.
#[derive(Clone, Debug)]
pub struct Track {
    pub family: Family,
    pub id: u32,
    pub side_mm: f64,
    pattern: Pattern,
    /// When and where it was seen, newest first.
    seen: [(f64, Quad); 3],
    depth: usize,
    inks: [Level; 2],
    blur: [f64; 3],
    hamming: u32,
    margin: f64,
    filter: Option<Filter>,
    error_px: f64,
    /// What the print leaves unexplained of the picture, gray levels (RMS): the noise, or more.
    rms: f64,
    /// The pose of this picture alone.
    measured: Pose,
    /// From the measured corners to the smoothed ones, ideal px.
    smoothed: Quad,
    other: Option<Minimum>,
    /// χ² by which the pictures so far prefer our minimum to the other.
    trust: f64,
    /// How far off the last predictions were, px: of constant place, velocity, acceleration.
    miss_px: [f64; 3],
    pub state: State,
}

/// What following works on.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    pub view: View<'a>,
    pub rectify: &'a Rectify,
    pub patterns: &'a Patterns,
    pub level: simd::Level,
    pub at: f64,
}

impl Scene<'_> {
    pub fn align(
        &self,
        pattern: &Pattern,
        quad: Quad,
        inks: [Level; 2],
        blur: Option<([f64; 3], f64)>,
    ) -> Option<Aligned> {
        let most = if blur.is_some() { SAMPLES } else { align::MOST_SAMPLES };
        let doubt_px = blur.map_or(0.0, |(_, doubt)| doubt);
        let start = Start { pattern, quad, inks, blur: blur.map(|(blur, _)| blur), doubt_px, most };
        align::align(&self.view, &start, self.rectify, self.level)
    }
}

impl Track {
    pub fn new(
        scene: &Scene<'_>,
        found: &Decoded,
        pattern: Pattern,
        side_mm: f64,
        aligned: &Aligned,
    ) -> Self {
        let id = found.reading.id;
        let mut track = Self {
            family: found.family,
            id,
            side_mm,
            pattern,
            seen: [(scene.at, aligned.quad); 3],
            depth: 0,
            inks: aligned.inks,
            blur: aligned.blur,
            hamming: found.reading.hamming,
            margin: found.margin,
            filter: None,
            error_px: 0.0,
            rms: aligned.rms,
            measured: Pose { rotation: DMat3::IDENTITY, translation: DVec3::Z },
            smoothed: [DVec2::ZERO; 4],
            other: None,
            trust: 0.0,
            miss_px: [MOST_DOUBT_PX; 3],
            state: State::Found,
        };
        track.observe(scene, aligned, true);
        track.hamming = found.reading.hamming;
        track
    }

    /// Follows it into the next picture.
    pub fn advance(&mut self, scene: &Scene<'_>) {
        self.state = State::Held;
        let all = [0, 1, 2].map(|order| self.predicted(scene.at, order));
        let quad = all[self.order()];
        let miss = self.miss_px[self.order()];
        let doubt = if miss < SURE_PX { 0.0 } else { (0.5 * miss).clamp(LEAST_DOUBT_PX, MOST_DOUBT_PX) };
        let mut start = (quad, doubt);
        for retry in [false, true] {
            if retry {
                let Some(shift) = self.nearby(&scene.view, &quad) else { return };
                start = (quad.map(|p| p + shift), MOST_DOUBT_PX);
            }
            let blur = Some((self.blur, start.1));
            let aligned = scene.align(&self.pattern, start.0, self.inks, blur);
            if let Some(aligned) = aligned
                && self.is_it(scene, &aligned)
                && self.observe(scene, &aligned, false)
            {
                for (before, predicted) in self.miss_px.iter_mut().zip(&all) {
                    let miss = (0..4).map(|i| (aligned.quad[i] - predicted[i]).length()).fold(0.0, f64::max);
                    *before = miss.max(0.7 * *before);
                }
                self.state = State::Followed;
                return;
            }
        }
    }

    /// Where it should be, by the prediction that was the best lately.
    pub fn expected(&self, at: f64) -> Quad {
        self.predicted(at, self.order())
    }

    /// The order of the prediction that missed least lately, the lowest of the like.
    fn order(&self) -> usize {
        (1..3).fold(0, |best, order| if self.miss_px[order] < self.miss_px[best] { order } else { best })
    }

    /// Where it should be by constant place, velocity from two places in the next frame (and while it is out of
    /// sight, at most `MOST_AHEAD_S` far) or acceleration from three: `order` 0 to 2, less where less is known.
    fn predicted(&self, at: f64, order: usize) -> Quad {
        let [(t0, a), (t1, b), (t2, c)] = self.seen;
        let unseen = at - t0 > 1.5 * (t0 - t1);
        let weights = match order.min(self.depth.max(1) - 1) {
            0 => [1.0, 0.0, 0.0],
            1 => {
                let s = (at - t0).min(MOST_AHEAD_S) / (t0 - t1);
                [1.0 + s, -s, 0.0]
            }
            _ if unseen => return self.predicted(at, 1),
            _ => [
                (at - t1) * (at - t2) / ((t0 - t1) * (t0 - t2)),
                (at - t0) * (at - t2) / ((t1 - t0) * (t1 - t2)),
                (at - t0) * (at - t1) / ((t2 - t0) * (t2 - t1)),
            ],
        };
        std::array::from_fn(|i| a[i] * weights[0] + b[i] * weights[1] + c[i] * weights[2])
    }

    /// Whether what was aligned is this marker: its print explains the picture, and its bits are its own.
    fn is_it(&mut self, scene: &Scene<'_>, aligned: &Aligned) -> bool {
        let step = |inks: &[Level; 2]| inks[1].mean - inks[0].mean;
        let (before, now) = (step(&self.inks), step(&aligned.inks));
        let contrast = now * before.signum();
        let grown = mean_side(&aligned.quad) / mean_side(&self.seen[0].1);
        let explained = contrast >= LEAST_CONTRAST.max(LEAST_KEPT * before.abs())
            && aligned.share >= LEAST_SHARE
            && aligned.rms <= MOST_RESIDUAL * contrast
            && (0.6..1.7).contains(&grown);
        let Some((wrong, margin)) = explained.then(|| self.bits(&scene.view, aligned)).flatten() else {
            return false;
        };
        if wrong > self.family.max_hamming() || !self.is_its_picture(scene, aligned, now) {
            return false;
        }
        (self.hamming, self.margin) = (wrong, margin);
        true
    }

    /// Whether a marker that is a picture shows its own, upright; `step`: gray from black to white.
    fn is_its_picture(&self, scene: &Scene<'_>, aligned: &Aligned, step: f64) -> bool {
        if self.family != Family::Pattern {
            return true;
        }
        let polarity = if step < 0.0 { Polarity::WhiteOnBlack } else { Polarity::BlackOnWhite };
        decode::decode_picture(&scene.view, &aligned.quad, scene.patterns, polarity)
            .is_some_and(|found| (found.reading.id, found.reading.rotation) == (self.id, 0))
    }

    /// Cells inside the border that differ from the code, those near their threshold left out, and the mean
    /// distance from it.
    fn bits(&self, view: &View<'_>, aligned: &Aligned) -> Option<(u32, f64)> {
        let map = Homography::from_square(aligned.quad)?;
        let cells = self.pattern.cells;
        let (mut wrong, mut margin, mut count) = (0, 0.0, 0.0);
        for row in 1..cells - 1 {
            for column in 1..cells - 1 {
                let ink = self.pattern.ink(column, row);
                if ink == Ink::Picture {
                    continue;
                }
                let p = cell(column as f64, row as f64, cells);
                let (black, white) = (aligned.inks[0].at(p), aligned.inks[1].at(p));
                // in units of half the step: -1 black, 1 white
                let value = (2.0 * view.gray(map.apply(p)) - black - white) / (white - black);
                wrong += u32::from((value > 0.0) != (ink == Ink::White) && value.abs() > 0.2);
                margin += value.abs().min(1.0) * 0.5 * (white - black).abs();
                count += 1.0;
            }
        }
        Some((wrong, margin / count))
    }

    /// The shift that brings the print nearest to the picture, about where it should be: sum of absolute
    /// differences at the cells' middles.
    fn nearby(&self, view: &View<'_>, quad: &Quad) -> Option<DVec2> {
        let map = Homography::from_square(*quad)?;
        let cells = self.pattern.cells;
        let side = mean_side(quad) / cells as f64;
        let reach = (2.0 * side).clamp(6.0, 32.0) as i32;
        let stride = ((side * 0.35) as i32).max(1);
        let mut points = [[0i32; 3]; 18 * 18];
        let mut count = 0;
        let contrast = (self.inks[1].mean - self.inks[0].mean).abs();
        let cap = (0.6 * contrast) as i32;
        let Size { width, height } = view.luma.size();
        let (w, h) = (width as i32, height as i32);
        for row in 0..cells + 2 {
            for column in 0..cells + 2 {
                let p = cell(column as f64 - 1.0, row as f64 - 1.0, cells);
                let outside = row == 0 || column == 0 || row > cells || column > cells;
                let ink = if outside { Ink::White } else { self.pattern.ink(column - 1, row - 1) };
                if ink == Ink::Picture {
                    continue;
                }
                let gray = self.inks[usize::from(ink == Ink::White)].at(p);
                let at = rectify::seen(view.lens, map.apply(p)) + 0.5;
                if count < points.len() && at.is_finite() && at.abs().max_element() < 1e6 {
                    points[count] = [at.x.floor() as i32, at.y.floor() as i32, gray as i32];
                    count += 1;
                }
            }
        }
        let cost = |dx: i32, dy: i32| {
            let mut sum = 0;
            for [x, y, gray] in &points[..count] {
                let (x, y) = (x + dx, y + dy);
                let inside = x >= 0 && y >= 0 && x < w && y < h;
                let seen =
                    if inside { i32::from(view.luma.row(y as usize)[x as usize]) } else { i32::MAX / 2 };
                sum += (seen - gray).abs().min(cap);
            }
            sum
        };
        let mut best = (i32::MAX, 0, 0);
        let try_at = |dx: i32, dy: i32, best: &mut (i32, i32, i32)| {
            let sum = cost(dx, dy);
            if sum < best.0 {
                *best = (sum, dx, dy);
            }
        };
        let rings = reach / stride;
        for j in -rings..=rings {
            for i in -rings..=rings {
                try_at(i * stride, j * stride, &mut best);
            }
        }
        let mut step = stride / 2;
        while step > 0 {
            let (_, x, y) = best;
            for (i, j) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                try_at(x + i * step, y + j * step, &mut best);
            }
            step /= 2;
        }
        let likely = f64::from(best.0) < 0.25 * contrast * count as f64;
        likely.then(|| DVec2::new(f64::from(best.1), f64::from(best.2)))
    }

    /// Takes it where it was read in this picture after it had been out of sight.
    pub fn found_again(&mut self, scene: &Scene<'_>, aligned: &Aligned) {
        self.depth = 0;
        self.miss_px = [MOST_DOUBT_PX; 3];
        self.observe(scene, aligned, true);
        self.state = State::Found;
    }

    /// When it was last seen, s.
    pub fn seen_at(&self) -> f64 {
        self.seen[0].0
    }

    /// The picture's noise about it, or more: deviation, gray levels.
    pub fn noise(&self) -> f64 {
        self.rms
    }

    /// Where it was last seen, ideal pixels.
    pub fn place(&self) -> &Quad {
        &self.seen[0].1
    }

    /// Takes what was measured in this picture; unless it was read there (`read`), only if some pose explains it about
    /// as well as those before.
    fn observe(&mut self, scene: &Scene<'_>, aligned: &Aligned, read: bool) -> bool {
        let dt = scene.at - self.seen[0].0;
        if !self.solve(scene.view.lens, aligned, dt, read) {
            return false;
        }
        if self.depth > 0 {
            // after a while out of sight the places before say nothing about the next one
            self.depth = if dt > 0.12 { 0 } else { self.depth.min(2) };
            self.seen = [self.seen[0], self.seen[0], self.seen[1]];
        }
        self.seen[0] = (scene.at, aligned.quad);
        self.depth = (self.depth + 1).min(3);
        (self.inks, self.blur, self.rms) = (aligned.inks, aligned.blur, aligned.rms);
        true
    }

    /// Both minima, and which of them is ours.
    fn solve(&mut self, lens: &Lens, aligned: &Aligned, dt: f64, read: bool) -> bool {
        let lens = Lens { distortion: [0.0; 8], ..*lens };
        let [Some(best), other] = solve::minima(&aligned.quad, &aligned.information, 1.0, &lens) else {
            if read {
                (self.filter, self.other, self.smoothed) = (None, None, [DVec2::ZERO; 4]);
            }
            return read;
        };
        if !read && best.error_px > ERROR_GROWS * self.error_px + MOST_ERROR_PX {
            return false;
        }
        let (mut ours, mut other) = (best, other);
        if let Some(their) = other {
            if let Some(filter) = &self.filter {
                let ahead = filter.ahead(dt);
                let near = their.pose.angle_to(&ahead) < ours.pose.angle_to(&ahead);
                if near && their.cost < ours.cost + CLEAR * (1.0 + ours.cost) {
                    (ours, other) = (their, Some(ours));
                }
            }
            let said = other.map_or(0.0, |other| other.cost - ours.cost).clamp(-MOST_SAID, MOST_SAID);
            self.trust = self.trust * REMEMBERED + said;
            if self.trust < -DECIDES {
                (ours, other) = (other.unwrap_or(ours), Some(ours));
                (self.filter, self.trust) = (None, -self.trust);
            }
        }
        let filter = match &mut self.filter {
            Some(filter) => {
                filter.update(&ours.pose, &ours.information, dt);
                filter
            }
            None => self.filter.insert(Filter::new(ours.pose, &ours.information)),
        };
        // what no pose explains (a lens not quite as told) stays as measured
        let smooth = filter.pose();
        self.smoothed = [DVec2::ZERO; 4];
        for (shift, corner) in self.smoothed.iter_mut().zip(solve::corners_mm(1.0)) {
            let seen = |pose: &Pose| lens.project(pose.apply(corner));
            if let (Some(smooth), Some(measured)) = (seen(&smooth), seen(&ours.pose)) {
                *shift = smooth - measured;
            }
        }
        (self.measured, self.error_px, self.other) = (ours.pose, ours.error_px, other);
        true
    }

    pub fn sighting(&self, at: f64, lens: &Lens, smooth: bool) -> Sighting {
        let held = self.state == State::Held;
        let quad = if held {
            self.expected(at)
        } else {
            std::array::from_fn(|i| self.seen[0].1[i] + self.smoothed[i] * f64::from(u8::from(smooth)))
        };
        let usable = self.side_mm.is_finite() && self.side_mm > 0.0;
        let scaled = |pose: Pose, error_px: f64| {
            let translation = pose.translation * self.side_mm;
            usable.then_some(Solved { pose: Pose { translation, ..pose }, error_px })
        };
        let pose = self.filter.as_ref().and_then(|filter| {
            let pose = match (held, smooth) {
                (true, _) => filter.ahead((at - self.seen[0].0).min(MOST_AHEAD_S)),
                (_, true) => filter.pose(),
                _ => self.measured,
            };
            scaled(pose, self.error_px)
        });
        Sighting {
            family: self.family,
            id: self.id,
            corners: quad.map(|p| rectify::seen(lens, p)),
            hamming: self.hamming,
            margin: self.margin as f32,
            pose,
            pose_alt: self.other.and_then(|other| scaled(other.pose, other.error_px)),
            state: self.state,
        }
    }
}

/// The middle of a cell in the marker square (±1, y up).
fn cell(column: f64, row: f64, cells: usize) -> DVec2 {
    let size = 2.0 / cells as f64;
    DVec2::new((column + 0.5) * size - 1.0, 1.0 - (row + 0.5) * size)
}
