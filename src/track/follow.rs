//! Markers followed from picture to picture.
//!
//! What was seen is expected again: each known marker is predicted and its print laid straight onto the picture,
//! without search or decoding; where that fails it is looked for nearby by its print, then in a window, then it is
//! held where it would be, then dropped (`known`: one such marker). New markers are searched for a slice a frame;
//! while none is known, every picture is searched in full.

use super::align::Pattern;
use super::decode::{Decoded, View};
use super::known::{Scene, Track};
use super::quad::Quad;
use super::rectify;
use super::watch::Watch;
use super::{Tracker, Wanted, bounds, mean_side, wish};
use crate::frame::{Sighting, State};
use crate::geometry::Lens;
use crate::pixels::{PlaneRef, Size};
use glam::DVec2;
use rayon::prelude::*;
use std::time::Duration;

/// Most markers that are followed.
const MOST: usize = 64;
/// Most windows searched in a picture.
const MOST_WINDOWS: usize = 2;
/// Longest time a marker is held; a shorter gap between pictures than this is none, s.
const MOST_HOLD_MS: u32 = 2000;
const LEAST_GAP: f64 = 0.1;
/// Share of the picture that may be searched in a frame on average, and how much of it can be saved up. Searching a
/// region of the halved picture counts for a quarter: when all of the picture changes, that is searched every eighth
/// frame.
const ALLOWANCE: f64 = 1.0 / 32.0;
const MOST_SAVED: f64 = 1.0 / 3.0;
/// Where nothing changes, what was not read before has another chance: in the halved picture every so many frames,
/// and in strips of the whole one, for markers too small for the halved one, which have room in their overlap.
const HALF_EVERY: usize = 45;
const STRIP_EVERY: usize = 20;
/// The same while more changes than may be searched.
const BUSY_STRIP_EVERY: usize = 6;
const STRIPS: usize = 24;
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
    watch: Watch,
    /// Pixels that may be searched besides.
    saved: f64,
    /// Frames since all of the halved picture was searched or more changed than may be searched; frames since the last
    /// strip; strips so far.
    idle: usize,
    since_strip: usize,
    strip: usize,
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
            self.known.reserve(4 * MOST);
            let prints: usize = self.boards.iter().map(|board| board.prints.len()).sum();
            self.sightings.reserve(MOST + prints);
            self.decoded.reserve(4 * MOST);
            (follow.saved, follow.idle, follow.since_strip, follow.strip) = (0.0, 0, 0, 0);
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
        let scene = Scene { view, rectify: &self.rectify, patterns: &self.patterns, level, at };
        self.follow.tracks.par_iter_mut().for_each(|track| track.advance(&scene));
        let sighted = self.follow.tracks.iter().any(|track| track.state != State::Held);
        if sighted {
            self.decoded.clear();
            self.known.clear();
            let seen = self.follow.tracks.iter().filter(|track| track.state != State::Held);
            self.known.extend(seen.map(|track| bounds(&track.place().map(|p| rectify::seen(lens, p)))));
            self.search_windows(luma, lens);
            self.search_slice(luma, lens, wanted);
        } else {
            self.search(luma, lens, wanted);
            self.follow.watch.settle(luma, level);
        }
        super::keep_best(&mut self.decoded);
        let scene = Scene { view, rectify: &self.rectify, patterns: &self.patterns, level, at };
        for found in &self.decoded {
            self.follow.admit(&scene, found, wanted);
        }
        self.follow.tracks.retain(|track| at - track.seen_at() <= hold);
        self.follow.drop_doubles();
        self.sightings
            .extend(self.follow.tracks.iter().map(|track| track.sighting(at, lens, self.config.smooth)));
        self.boards.iter().for_each(|board| super::board::settle(board, lens, &mut self.sightings));
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
            self.search_part(luma, lens, &only, [low - grow, high + grow], step, MOST_CANDIDATES);
        }
    }

    /// Looks for new markers: where the picture has changed, and in this frame's share of the rest.
    fn search_slice(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) {
        let Size { width, height } = luma.size();
        let (w, h) = (width as f64, height as f64);
        let area =
            |[low, high]: [DVec2; 2]| (high.x.min(w) - low.x.max(0.0)) * (high.y.min(h) - low.y.max(0.0));
        let follow = &mut self.follow;
        let seen = || follow.tracks.iter().filter(|track| track.state != State::Held);
        let noise = seen().map(Track::noise).fold(f64::INFINITY, f64::min);
        let quads = seen().map(|track| track.place().map(|p| rectify::seen(lens, p)));
        follow.watch.look(luma, noise, quads, self.level);
        follow.saved = (follow.saved + ALLOWANCE * w * h).min(MOST_SAVED * w * h);
        let mut busy = false;
        while let Some(region) = self.follow.watch.due() {
            let part = region.bounds();
            busy = 0.25 * area(part) > self.follow.saved;
            if busy {
                break;
            }
            for (step, cost) in [(2, 0.25 * area(part)), (1, area(part))] {
                if cost <= self.follow.saved {
                    self.follow.saved -= cost;
                    self.search_part(luma, lens, wanted, part, step, MOST_CANDIDATES);
                }
            }
            self.follow.watch.searched(&region);
        }
        self.follow.idle = if busy { 0 } else { self.follow.idle + 1 };
        self.follow.since_strip += 1;
        if self.follow.idle == HALF_EVERY {
            self.follow.idle = 0;
            self.search_part(luma, lens, wanted, [DVec2::ZERO, DVec2::new(w, h)], 2, MOST_CANDIDATES);
        } else if self.follow.since_strip >= if busy { BUSY_STRIP_EVERY } else { STRIP_EVERY } {
            self.follow.since_strip = 0;
            let strip = h / STRIPS as f64;
            let top = strip * (self.follow.strip % STRIPS) as f64;
            self.follow.strip += 1;
            let low = DVec2::new(0.0, top - OVERLAP_PX);
            self.search_part(luma, lens, wanted, [low, DVec2::new(w, top + strip)], 1, MOST_CANDIDATES);
        }
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
            let apart = (center(track.place()) - here).length();
            if track.state != State::Held {
                if apart < 0.7 * mean_side(&found.quad) {
                    return;
                }
            } else if held.is_none_or(|(_, least)| apart < least) {
                held = Some((i, apart));
            }
        }
        let Some(pattern) = Pattern::new(key.0, key.1) else { return };
        let Some(aligned) = scene.align(&pattern, found.quad, [found.black, found.white], None) else {
            return;
        };
        if !found.stands(Some(&aligned)) {
            return;
        }
        match held {
            Some((i, _)) => {
                self.tracks[i].found_again(scene, &aligned);
            }
            None if self.tracks.len() < MOST => {
                let side_mm = wish(wanted, key.0, key.1).map_or(f64::NAN, |w| w.side_mm);
                self.tracks.push(Track::new(scene, found, pattern, side_mm, &aligned));
            }
            None => {}
        }
    }

    /// Two tracks that ran into one marker become one; orders by family, id and place.
    fn drop_doubles(&mut self) {
        let tracks = &mut self.tracks;
        let place = |t: &Track| (t.place()[0].y, t.place()[0].x);
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
            let apart = (next.place()[0] - kept.place()[0]).length();
            same && apart < 0.5 * mean_side(kept.place())
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::Family;
    use crate::pixels::{Plane, simd};
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

    /// Prints white on black are followed, and found beside others, as those black on white are.
    #[test]
    fn inverted_prints_are_followed_and_found_beside_others() {
        let lens = Lens::guess(Size::new(320, 240));
        let config = Config { inverted: true, ..Config::default() };
        let mut tracker = Tracker::new(config, simd::Level::fallback());
        let mut seen = Vec::new();
        for number in 0..16 {
            let mut frame_picture = picture(Some((17, 40, 70)));
            if number >= 4 {
                let other = picture(Some((23, 200, 90)));
                for y in 0..240 {
                    for x in 160..320 {
                        frame_picture.row_mut(y)[x] = 255 - other.at(x, y);
                    }
                }
            }
            let sightings = tracker.follow(frame_picture.view(), &lens, &wanted(), frame(number));
            seen.push(sightings.iter().map(|s| (s.id, s.state)).collect::<Vec<_>>());
        }
        assert!(seen[..4].iter().all(|seen| seen.len() == 1 && seen[0].0 == 17), "{seen:?}");
        assert!(seen[11..].iter().all(|seen| seen.len() == 2), "{seen:?}");
        assert_eq!(seen[15], [(17, State::Followed), (23, State::Followed)]);
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

    /// Where the whole picture changes every frame, nothing tells where to look.
    #[test]
    fn new_prints_are_found_within_ten_frames_from_a_moving_camera() {
        let size = Size::new(320, 240);
        let lens = Lens::guess(size);
        let mut noise = crate::pixels::SplitMix64::new(5);
        let wall = Plane::from_fn(Size::new(64, 64), |_, _| 90 + (noise.next_u64() % 80) as u8);
        let (base, other) = (picture(Some((17, 40, 70))), picture(Some((23, 200, 90))));
        for appears in [20, 25] {
            let mut tracker = Tracker::new(Config::default(), simd::best());
            let mut waited = 0;
            for number in 0..appears + 12 {
                let mut frame_picture = base.clone();
                for y in 0..240 {
                    for x in 0..320 {
                        let known = (24..136).contains(&x) && (54..166).contains(&y);
                        let new = number >= appears && (184..296).contains(&x) && (74..186).contains(&y);
                        // what is around the prints moves by several pixels
                        let behind = wall.at((x / 7 + 5 * number as usize) % 64, (y / 7) % 64);
                        let gray = if new { other.at(x, y) } else { behind };
                        if !known {
                            frame_picture.row_mut(y)[x] = gray;
                        }
                    }
                }
                let seen = tracker.follow(frame_picture.view(), &lens, &wanted(), frame(number));
                assert!(seen.iter().any(|s| s.id == 17), "frame {number}");
                waited += u32::from(number >= appears && !seen.iter().any(|s| s.id == 23));
            }
            assert!(waited < 10, "seen {waited} frames after it appeared in {appears}");
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
