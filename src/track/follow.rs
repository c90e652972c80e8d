//! Markers followed from picture to picture.
//!
//! What was seen is expected again: each known marker is predicted and its print laid straight onto the picture,
//! without search or decoding; where that fails it is looked for nearby by its print, then in a window, then it is
//! held where it would be, then dropped. A followed marker must explain the picture as its own code, so that
//! another one never takes its place. New markers are searched for a slice a frame; while none is known, every
//! picture is searched in full.

use super::align::{self, Aligned, Pattern, Start};
use super::decode::{Decoded, Level, View};
use super::filter::Filter;
use super::quad::Quad;
use super::rectify::{self, Rectify};
use super::search::{self, Limits};
use super::solve::{self, Minimum};
use super::{Tracker, Wanted, bounds, mean_side, wish};
use crate::frame::{Sighting, Solved, State};
use crate::geometry::{Homography, Lens, Pose};
use crate::marker::{Family, Ink};
use crate::pixels::{PlaneRef, Size, simd};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use std::time::Duration;

/// Most markers that are followed.
const MOST: usize = 64;
/// Pixels a followed marker is aligned with.
const SAMPLES: usize = 900;
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
/// Most windows searched in a picture.
const MOST_WINDOWS: usize = 2;
/// Longest time a marker is held; a shorter gap between pictures than this is none, s.
const MOST_HOLD_MS: u32 = 2000;
const LEAST_GAP: f64 = 0.1;
/// Frames in which the strips of the picture come around, and the frames from one to the next; in between the halved
/// picture is searched, one frame in so many. Only markers too small for the halved picture need the strips, and
/// have room in their overlap.
const CYCLE: usize = 96;
const STRIP_EVERY: usize = 4;
const HALF_EVERY: usize = 6;
const OVERLAP_PX: f64 = 34.0;
/// Most blobs that are looked at in a slice.
const MOST_CANDIDATES: usize = 300;

/// Everything that is carried from one picture to the next.
#[derive(Debug, Default)]
pub struct Follow {
    tracks: Vec<Track>,
    lens: Option<Lens>,
    wanted: Vec<Wanted>,
    at: f64,
    turn: usize,
    boxes: Vec<[DVec2; 2]>,
}

/// A marker that is known.
#[derive(Clone, Debug)]
struct Track {
    family: Family,
    id: u32,
    side_mm: f64,
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
    /// The pose of this picture alone.
    measured: Pose,
    /// From the measured corners to the smoothed ones, ideal px.
    smoothed: Quad,
    other: Option<Minimum>,
    /// χ² by which the pictures so far prefer our minimum to the other.
    trust: f64,
    /// How far off the last predictions were, px.
    miss_px: f64,
    state: State,
}

/// What following works on.
struct Scene<'a> {
    view: View<'a>,
    rectify: &'a Rectify,
    level: simd::Level,
    at: f64,
}

impl Tracker {
    /// The wanted markers in view, ordered by family and id, with what is known from the pictures before.
    ///
    /// `at`: when the picture was taken, on any clock that runs on; a clock that does not, a gap longer than
    /// [`super::Config::hold_ms`] (and 100 ms), another lens, size or wish starts anew. Poses are smoothed over time; a marker
    /// out of sight is reported as [`State::Held`] for `hold_ms`. Allocates only when a picture is larger or fuller
    /// than any before.
    pub fn follow(
        &mut self,
        luma: PlaneRef<'_, u8>,
        lens: &Lens,
        wanted: &[Wanted],
        at: Duration,
    ) -> &[Sighting] {
        self.sightings.clear();
        let at = at.as_secs_f64();
        let hold = f64::from(self.config.hold_ms.min(MOST_HOLD_MS)) * 1e-3;
        let follow = &mut self.follow;
        let same = follow.lens == Some(*lens) && follow.wanted == wanted;
        if !same || at <= follow.at || at - follow.at > hold.max(LEAST_GAP) {
            follow.tracks.clear();
            follow.tracks.reserve(MOST);
            follow.boxes.reserve(MOST);
            self.sightings.reserve(MOST);
            self.decoded.reserve(4 * MOST);
            follow.turn = 0;
            follow.wanted.clear();
            follow.wanted.extend_from_slice(wanted);
            follow.lens = Some(*lens);
        }
        follow.at = at;
        if !self.prepare(luma, lens, wanted) {
            return &self.sightings;
        }
        let view = View::new(luma, lens);
        let level = self.level;
        let scene = Scene { view, rectify: &self.rectify, level, at };
        self.follow.tracks.par_iter_mut().for_each(|track| track.advance(&scene));
        let sighted = self.follow.tracks.iter().any(|track| track.state != State::Held);
        self.decoded.clear();
        if sighted {
            self.search_windows(luma, lens);
            self.search_slice(luma, lens, wanted);
        } else {
            self.search(luma, lens, wanted);
        }
        super::keep_best(&mut self.decoded);
        let scene = Scene { view, rectify: &self.rectify, level, at };
        for found in &self.decoded {
            self.follow.admit(&scene, found, wanted);
        }
        self.follow.tracks.retain(|track| at - track.seen[0].0 <= hold);
        self.follow.drop_doubles();
        self.follow.turn += 1;
        self.sightings
            .extend(self.follow.tracks.iter().map(|track| track.sighting(at, lens, self.config.smooth)));
        &self.sightings
    }

    /// Forgets what [`Tracker::follow`] knows: the next picture has nothing to do with the last one.
    pub fn forget(&mut self) {
        self.follow.lens = None;
    }

    /// Looks for markers out of sight where they may be.
    fn search_windows(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens) {
        let mut windows = 0;
        for i in 0..self.follow.tracks.len() {
            let track = &self.follow.tracks[i];
            if track.state != State::Held || windows == MOST_WINDOWS {
                continue;
            }
            windows += 1;
            let quad = track.expected(self.follow.at).map(|p| rectify::seen(lens, p));
            let [low, high] = bounds(&quad);
            let grow = 0.5 * mean_side(&quad) + 8.0;
            let step = if mean_side(&quad) > 60.0 { 2 } else { 1 };
            let only = [Wanted { family: track.family, id: Some(track.id), side_mm: track.side_mm }];
            self.search_part(luma, lens, &only, [low - grow, high + grow], step);
        }
    }

    /// Looks for new markers in this frame's share of the picture.
    fn search_slice(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) {
        let Size { width, height } = luma.size();
        let turn = self.follow.turn % CYCLE;
        let (w, h) = (width as f64, height as f64);
        if turn.is_multiple_of(HALF_EVERY) {
            self.search_part(luma, lens, wanted, [DVec2::ZERO, DVec2::new(w, h)], 2);
        } else if turn % STRIP_EVERY == 1 {
            let strip = h / (CYCLE / STRIP_EVERY) as f64;
            let top = strip * (turn / STRIP_EVERY) as f64;
            let low = DVec2::new(0.0, top - OVERLAP_PX);
            self.search_part(luma, lens, wanted, [low, DVec2::new(w, top + strip)], 1);
        }
    }

    /// Reads what can be read in a box of the picture, whole (`step` 1) or halved (2).
    fn search_part(
        &mut self,
        luma: PlaneRef<'_, u8>,
        lens: &Lens,
        wanted: &[Wanted],
        [low, high]: [DVec2; 2],
        step: u32,
    ) {
        let Size { width, height } = luma.size();
        // whole pairs of pixels, so that halved ones lie where those of the halved picture would
        let (left, top) = (low.x.max(0.0) as usize & !1, low.y.max(0.0) as usize & !1);
        let right = (high.x.max(0.0) as usize + 1).min(width);
        let bottom = (high.y.max(0.0) as usize + 1).min(height);
        if right < left + 16 || bottom < top + 16 {
            return;
        }
        let size = Size::new(right - left, bottom - top);
        let Some(part) = luma.part(left, top, size) else { return };
        let limits = self.limits();
        let most = limits.most.min(MOST_CANDIDATES);
        let limits = Limits { step, origin: DVec2::new(left as f64, top as f64), most, ..limits };
        let follow = &mut self.follow;
        follow.boxes.clear();
        let seen = follow.tracks.iter().filter(|track| track.state != State::Held);
        follow.boxes.extend(seen.map(|t| bounds(&t.seen[0].1.map(|p| rectify::seen(lens, p)))));
        // the buffers of the full search are large enough for a part
        let (search, picture) = if step == 1 {
            (&mut self.whole, part)
        } else {
            search::halve(part, &mut self.halved, self.level);
            (&mut self.half, self.halved.view())
        };
        let quads = search.quads(picture, &self.rectify, limits, &follow.boxes, self.level);
        let view = View::new(luma, lens);
        self.decoded.extend(quads.iter().filter_map(|quad| {
            super::read(
                &view,
                quad,
                crate::marker::Polarity::BlackOnWhite,
                limits.step,
                wanted,
                &self.patterns,
            )
        }));
    }
}

impl Follow {
    /// Takes a marker that was read: back in sight, or new.
    fn admit(&mut self, scene: &Scene<'_>, found: &Decoded, wanted: &[Wanted]) {
        let center = |q: &Quad| (q[0] + q[1] + q[2] + q[3]) * 0.25;
        let here = center(&found.quad);
        let key = (found.family, found.reading.id);
        let mut held = None;
        for (i, track) in self.tracks.iter().enumerate().filter(|(_, t)| (t.family, t.id) == key) {
            let apart = (center(&track.seen[0].1) - here).length();
            if track.state != State::Held {
                if apart < 0.7 * mean_side(&found.quad) {
                    return;
                }
            } else if held.is_none_or(|(_, least)| apart < least) {
                held = Some((i, apart));
            }
        }
        let Some(aligned) = scene.align(key.0, key.1, found.quad, [found.black, found.white], None) else {
            return;
        };
        match held {
            Some((i, _)) => {
                let track = &mut self.tracks[i];
                track.depth = 0;
                track.miss_px = MOST_DOUBT_PX;
                track.observe(scene, &aligned, true);
                track.state = State::Found;
            }
            None if self.tracks.len() < MOST => {
                let side_mm = wish(wanted, key.0, key.1).map_or(f64::NAN, |w| w.side_mm);
                if let Some(track) = Track::new(scene, found, side_mm, &aligned) {
                    self.tracks.push(track);
                }
            }
            None => {}
        }
    }

    /// Two tracks that ran into one marker become one; orders by family, id and place.
    fn drop_doubles(&mut self) {
        let tracks = &mut self.tracks;
        let place = |t: &Track| (t.seen[0].1[0].y, t.seen[0].1[0].x);
        tracks.sort_unstable_by(|a, b| {
            let (p, q) = (place(a), place(b));
            let by_place = p.0.total_cmp(&q.0).then(p.1.total_cmp(&q.1));
            (a.family, a.id)
                .cmp(&(b.family, b.id))
                .then((a.state == State::Held).cmp(&(b.state == State::Held)))
                .then(by_place)
        });
        tracks.dedup_by(|next, kept| {
            let same = (next.family, next.id) == (kept.family, kept.id);
            let apart = (next.seen[0].1[0] - kept.seen[0].1[0]).length();
            same && apart < 0.5 * mean_side(&kept.seen[0].1)
        });
    }
}

impl Scene<'_> {
    fn align(
        &self,
        family: Family,
        id: u32,
        quad: Quad,
        inks: [Level; 2],
        blur: Option<([f64; 3], f64)>,
    ) -> Option<Aligned> {
        let most = if blur.is_some() { SAMPLES } else { align::MOST_SAMPLES };
        let doubt_px = blur.map_or(0.0, |(_, doubt)| doubt);
        let start = Start { family, id, quad, inks, blur: blur.map(|(blur, _)| blur), doubt_px, most };
        align::align(&self.view, &start, self.rectify, self.level)
    }
}

impl Track {
    fn new(scene: &Scene<'_>, found: &Decoded, side_mm: f64, aligned: &Aligned) -> Option<Self> {
        let id = found.reading.id;
        let mut track = Self {
            family: found.family,
            id,
            side_mm,
            pattern: Pattern::new(found.family, id)?,
            seen: [(scene.at, aligned.quad); 3],
            depth: 0,
            inks: aligned.inks,
            blur: aligned.blur,
            hamming: found.reading.hamming,
            margin: found.margin,
            filter: None,
            error_px: 0.0,
            measured: Pose { rotation: DMat3::IDENTITY, translation: DVec3::Z },
            smoothed: [DVec2::ZERO; 4],
            other: None,
            trust: 0.0,
            miss_px: MOST_DOUBT_PX,
            state: State::Found,
        };
        track.observe(scene, aligned, true);
        track.hamming = found.reading.hamming;
        Some(track)
    }

    /// Follows it into the next picture.
    fn advance(&mut self, scene: &Scene<'_>) {
        self.state = State::Held;
        let quad = self.expected(scene.at);
        let doubt = if self.miss_px < SURE_PX {
            0.0
        } else {
            (0.5 * self.miss_px).clamp(LEAST_DOUBT_PX, MOST_DOUBT_PX)
        };
        let mut start = (quad, doubt);
        for retry in [false, true] {
            if retry {
                let Some(shift) = self.nearby(&scene.view, &quad) else { return };
                start = (quad.map(|p| p + shift), MOST_DOUBT_PX);
            }
            let blur = Some((self.blur, start.1));
            let aligned = scene.align(self.family, self.id, start.0, self.inks, blur);
            if let Some(aligned) = aligned
                && self.is_it(scene, &aligned)
                && self.observe(scene, &aligned, false)
            {
                let miss = (0..4).map(|i| (aligned.quad[i] - quad[i]).length()).fold(0.0, f64::max);
                self.miss_px = miss.max(0.7 * self.miss_px);
                self.state = State::Followed;
                return;
            }
        }
    }

    /// Where it should be: constant acceleration from three places in the next frame, constant velocity from two
    /// and while it is out of sight, at most `MOST_AHEAD_S` far.
    fn expected(&self, at: f64) -> Quad {
        let [(t0, a), (t1, b), (t2, c)] = self.seen;
        let unseen = at - t0 > 1.5 * (t0 - t1);
        let weights = match self.depth {
            0 | 1 => [1.0, 0.0, 0.0],
            depth if depth == 2 || unseen => {
                let s = (at - t0).min(MOST_AHEAD_S) / (t0 - t1);
                [1.0 + s, -s, 0.0]
            }
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
        let explained = contrast >= LEAST_CONTRAST.max(LEAST_KEPT * before)
            && aligned.share >= LEAST_SHARE
            && aligned.rms <= MOST_RESIDUAL * contrast
            && (0.6..1.7).contains(&grown);
        let Some((wrong, margin)) = explained.then(|| self.bits(&scene.view, aligned)).flatten() else {
            return false;
        };
        if wrong > self.family.max_hamming() {
            return false;
        }
        (self.hamming, self.margin) = (wrong, margin);
        true
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
        (self.inks, self.blur) = (aligned.inks, aligned.blur);
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

    fn sighting(&self, at: f64, lens: &Lens, smooth: bool) -> Sighting {
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

/// How long a marker out of sight is thought to go on as it did.
const MOST_AHEAD_S: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::Plane;
    use crate::track::Config;

    /// A gray wall with a print whose border begins at a place; `None`: the wall alone.
    fn picture(print: Option<(u32, usize, usize)>) -> Plane<u8> {
        let zoom = 8;
        Plane::from_fn(Size::new(320, 240), |x, y| {
            let ink = print.and_then(|(id, left, top)| {
                let print = Family::Tag36h11.picture(id)?;
                let (x, y) = (x.checked_sub(left - zoom)? / zoom, y.checked_sub(top - zoom)? / zoom);
                (x < print.size().width && y < print.size().height).then(|| print.at(x, y))
            });
            ink.map_or(128, |ink| 40 + ink / 2)
        })
    }

    fn wanted() -> [Wanted; 1] {
        [Wanted { family: Family::Tag36h11, id: None, side_mm: 80.0 }]
    }

    fn frame(number: u32) -> Duration {
        Duration::from_secs(number.into()) / 30
    }

    #[test]
    fn what_is_out_of_sight_is_held_and_then_lost() {
        let lens = Lens::guess(Size::new(320, 240));
        let mut tracker = Tracker::new(Config::default(), simd::Level::fallback());
        let mut states = Vec::new();
        for number in 0..24 {
            let x = 90 + number as usize;
            let there = (number < 10).then_some((17, x, 70));
            let seen = tracker.follow(picture(there).view(), &lens, &wanted(), frame(number));
            states.push(seen.first().map(|sighting| sighting.state));
            if let Some(sighting) = seen.first() {
                let corner = DVec2::new(x as f64 - 0.5, 69.5);
                let off = (sighting.corners[0] - corner).length();
                // the first frames teach the filter how fast it goes; out of sight it goes on for 3 frames
                let bound = match number {
                    0..6 => 0.15,
                    6..10 => 0.1,
                    _ => 1.0 + f64::from(number).max(12.0) - 12.0,
                };
                assert!(off < bound, "frame {number}: {off}");
            }
        }
        assert_eq!(states[0], Some(State::Found));
        assert!(states[1..10].iter().all(|state| *state == Some(State::Followed)), "{states:?}");
        // 200 ms are 6 frames
        assert!(states[10..16].iter().all(|state| *state == Some(State::Held)), "{states:?}");
        assert!(states[16..].iter().all(Option::is_none), "{states:?}");
    }

    #[test]
    fn another_marker_in_the_same_place_is_another_marker() {
        let lens = Lens::guess(Size::new(320, 240));
        let mut tracker = Tracker::new(Config::default(), simd::Level::fallback());
        for number in 0..20 {
            let id = if number < 10 { 17 } else { 18 };
            let seen = tracker.follow(picture(Some((id, 90, 70))).view(), &lens, &wanted(), frame(number));
            let seen: Vec<(u32, State)> = seen.iter().map(|s| (s.id, s.state)).collect();
            match number {
                0 => assert_eq!(seen, [(17, State::Found)]),
                1..10 => assert_eq!(seen, [(17, State::Followed)]),
                10 => assert_eq!(seen, [(17, State::Held), (18, State::Found)]),
                _ => assert_eq!(seen.last(), Some(&(18, State::Followed))),
            }
            if number > 16 {
                assert_eq!(seen.len(), 1, "the other is forgotten");
            }
        }
    }

    #[test]
    fn a_clock_that_does_not_run_on_starts_anew() {
        let lens = Lens::guess(Size::new(320, 240));
        let mut tracker = Tracker::new(Config::default(), simd::Level::fallback());
        let there = picture(Some((17, 90, 70)));
        for (number, state) in [
            (5, State::Found),
            (6, State::Followed),
            (6, State::Found),
            (7, State::Followed),
            (3, State::Found),
            (4, State::Followed),
            (60, State::Found),
        ] {
            let seen = tracker.follow(there.view(), &lens, &wanted(), frame(number));
            assert_eq!(seen.first().map(|s| s.state), Some(state), "at frame {number}");
        }
        let other = Lens { focal: lens.focal * 1.1, ..lens };
        let seen = tracker.follow(there.view(), &other, &wanted(), frame(61));
        assert_eq!(seen.first().map(|s| s.state), Some(State::Found), "another lens");
    }
}
