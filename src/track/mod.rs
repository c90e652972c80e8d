//! Markers in a gray picture: which, where, and in which pose.
//!
//! Comes in: the luma plane, the lens, and what the scene wants; goes out: `Sighting`s ordered by family and
//! id. The way through, one file a step: `threshold` (gray → bits) → `segment` (bits → blobs) → `contour` and
//! `quad` (blob → corners, in the ideal pixels of `rectify`) → `ring` and `decode` (quad → code or picture) →
//! `align` (sub-pixel corners from the whole print) → `solve` (both poses). Every step refuses early what cannot
//! be a marker, and the work on a picture of noise is bounded.
//!
//! `Tracker::find` searches every picture on its own. `Tracker::follow` (`follow`) expects what it saw before,
//! aligns it without search, and smooths poses over time (`filter`). The result does not depend on the number of
//! threads nor on the SIMD level.

mod align;
mod bits;
mod board;
mod contour;
mod decode;
mod evidence;
mod filter;
mod follow;
mod known;
mod quad;
mod rectify;
mod ring;
mod search;
mod segment;
pub mod solve;
mod threshold;
mod watch;

use crate::frame::{Sighting, Solved, State};
use crate::geometry::Lens;
use crate::marker::{Board, Family, Patterns, Polarity};
use crate::pixels::{Plane, PlaneRef, Size, simd::Level};
use decode::{Decoded, View};
use follow::Follow;
use glam::DVec2;
use quad::Quad;
use rayon::prelude::*;
use rectify::Rectify;
use search::{Found, Limits, Search};
use serde::{Deserialize, Serialize};

/// Largest picture side the tracker works on, px (contours count half pixels in 16 bits). Larger pictures
/// show no markers.
pub const MOST_SIDE_PX: usize = 16_000;

/// Smaller markers found in the halved picture are looked for in the whole one too: half a pixel matters there.
const LEAST_KNOWN_PX: f64 = 48.0;

/// Parts of a picture narrower than this hold no marker, px.
const LEAST_PART_PX: usize = 16;

/// Squared deviations (two degrees of freedom) by which four corners may miss those of a rigid square by chance and
/// by a little bend or blur that is not modeled; lenses that are not known miss by more.
const RIGID: f64 = 50.0;

/// Difference of squared deviations below which the picture leaves the pose open: odds of 20 to 1.
const OPEN: f64 = 6.0;

/// Settings of the tracker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Smallest marker looked for: longer side of its bounding box in px, 8 or more. Smaller blobs are
    /// dropped unseen, which is what keeps texture cheap. Default 10.
    pub least_side_px: u32,
    /// Least gray range (1..=60) of a neighborhood that can hold an edge, in a noiseless picture; noise raises
    /// it by itself. Default 6.
    pub least_contrast: u8,
    /// Most blobs that are followed and read in one picture, the largest first: bounds the work on noise.
    /// Default 1500.
    pub most_candidates: usize,
    /// Whether corners are aligned to the whole print (sub-pixel accuracy) or left as the outline gave them; small
    /// prints that blur has opened or mixed are then not believed. Default true.
    pub align: bool,
    /// How much is done to find the hardest markers. Default `normal`.
    pub quality: Quality,
    /// Whether markers printed white on black are looked for as well. Default false.
    pub inverted: bool,
    /// How long a followed marker that is out of sight is still reported where it would be, ms (0..=2000).
    /// Default 200.
    pub hold_ms: u32,
    /// Whether poses and corners of followed markers are smoothed over time: calm at rest, not late in motion.
    /// Default true.
    pub smooth: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            least_side_px: 10,
            least_contrast: 6,
            most_candidates: 1500,
            align: true,
            quality: Quality::Normal,
            inverted: false,
            hold_ms: 200,
            smooth: true,
        }
    }
}

/// How much is done to find the hardest markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// Only the picture at half size: markers of about 24 px and more, a third of the time.
    Quick,
    /// The picture at half and at full size.
    #[default]
    Normal,
    /// At a quarter too, with fainter edges and every doubtful outline tried: markers deep in noise or blur.
    Full,
}

/// A marker, or a whole family, that the scene wants found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Its family.
    pub family: Family,
    /// Its number; `None` for every number of the family.
    pub id: Option<u32>,
    /// Printed side of the black border's outer edge, mm: the pose is in the same unit.
    pub side_mm: f64,
}

/// A quad that may be a marker, and what was read in it.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    quad: Quad,
    hull: bool,
    polarity: Polarity,
    found: Option<Decoded>,
}

/// Finds markers; owns every buffer it needs.
#[derive(Debug)]
pub struct Tracker {
    config: Config,
    level: Level,
    patterns: Patterns,
    boards: Vec<Board>,
    whole: Search,
    half: Search,
    halved: Plane<u8>,
    quarter: Search,
    quartered: Plane<u8>,
    inverse: Plane<u8>,
    rectify: Rectify,
    candidates: Vec<Candidate>,
    decoded: Vec<Decoded>,
    known: Vec<[DVec2; 2]>,
    looks: Vec<Option<Sighting>>,
    sightings: Vec<Sighting>,
    follow: Follow,
}

impl Tracker {
    /// A tracker that runs at the given SIMD level.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            config,
            level,
            patterns: Patterns::default(),
            boards: Vec::new(),
            whole: Search::default(),
            half: Search::default(),
            halved: Plane::default(),
            quarter: Search::default(),
            quartered: Plane::default(),
            inverse: Plane::default(),
            rectify: Rectify::default(),
            candidates: Vec::new(),
            decoded: Vec::new(),
            known: Vec::new(),
            looks: Vec::new(),
            sightings: Vec::new(),
            follow: Follow::default(),
        }
    }

    /// The same tracker, knowing the picture markers that [`Family::Pattern`] counts.
    pub fn knowing(mut self, patterns: Patterns) -> Self {
        self.patterns = patterns;
        self
    }

    /// The same tracker, knowing that these prints are fixed to one another: all prints of a board have its one
    /// pose, and while one of them is seen the covered ones are reported as [`State::Held`].
    pub fn with_boards(mut self, boards: Vec<Board>) -> Self {
        self.boards = boards;
        self
    }

    /// The wanted markers in view, ordered by family and id.
    ///
    /// `lens` holds for this picture. Of markers with the same id only those that stand clearly apart are
    /// reported. Poses are `None` where the corners decide none. Allocates only when a picture is larger or
    /// fuller than any before.
    pub fn find(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) -> &[Sighting] {
        self.sightings.clear();
        if !self.prepare(luma, lens, wanted) {
            return &self.sightings;
        }
        self.search(luma, lens, wanted);
        keep_best(&mut self.decoded);
        let view = View::new(luma, lens);
        let (rectify, align, level) = (&self.rectify, self.config.align, self.level);
        let align = align.then_some((rectify, level));
        let looks = self.decoded.par_iter().map(|decoded| sight(&view, decoded, wanted, align));
        // as many as there are readings, so that nothing is allocated
        looks.collect_into_vec(&mut self.looks);
        self.sightings.extend(self.looks.iter().copied().flatten());
        self.boards.iter().for_each(|board| board::settle(board, lens, &mut self.sightings));
        &self.sightings
    }

    /// Whether there is anything to look at and for; the lens's table is ready then.
    fn prepare(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) -> bool {
        let size = luma.size();
        let usable = size.width.min(size.height) >= 8 && size.width.max(size.height) <= MOST_SIDE_PX;
        let finite = lens.focal.is_finite() && lens.center.is_finite() && lens.focal.min_element() > 0.0;
        if !usable || !finite || wanted.is_empty() {
            return false;
        }
        wanted.iter().for_each(|w| w.family.prepare());
        self.rectify.prepare(lens, size);
        true
    }

    /// Reads every marker in the picture: the smaller pictures first, because they are little work, show what noise
    /// hides in the whole one, and spare that one the large markers.
    fn search(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) {
        let steps: &[u32] = match self.config.quality {
            Quality::Quick => &[2],
            Quality::Normal => &[2, 1],
            Quality::Full => &[4, 2, 1],
        };
        self.decoded.clear();
        self.known.clear();
        let size = luma.size();
        let everything = [DVec2::ZERO, DVec2::new(size.width as f64, size.height as f64)];
        for &step in steps {
            self.search_part(luma, lens, wanted, everything, step, self.config.most_candidates);
        }
    }

    /// Reads what can be read in a box of the picture (least and greatest corner, px), looked at whole (`step` 1),
    /// halved (2) or quartered (4), following `most` outlines at most. Boxes in `known` are passed over; those of
    /// what is read, and of what is seen to be no marker, join them.
    fn search_part(
        &mut self,
        luma: PlaneRef<'_, u8>,
        lens: &Lens,
        wanted: &[Wanted],
        [low, high]: [DVec2; 2],
        step: u32,
        most: usize,
    ) {
        let Size { width, height } = luma.size();
        // whole pairs of pixels, so that halved ones lie where those of the halved picture would
        let (left, top) = (low.x.max(0.0) as usize & !1, low.y.max(0.0) as usize & !1);
        let right = (high.x.max(0.0) as usize + 1).min(width);
        let bottom = (high.y.max(0.0) as usize + 1).min(height);
        if right < left + LEAST_PART_PX || bottom < top + LEAST_PART_PX {
            return;
        }
        let Some(part) = luma.part(left, top, Size::new(right - left, bottom - top)) else { return };
        let limits = Limits {
            least_side_px: self.config.least_side_px.max(8),
            least_contrast: self.config.least_contrast.clamp(1, 60),
            most,
            solid: self.config.quality == Quality::Full || wanted.iter().any(|w| w.family == Family::Pattern),
            step,
            origin: DVec2::new(left as f64, top as f64),
        };
        let level = self.level;
        let (search, picture) = match step {
            1 => (&mut self.whole, part),
            2 => {
                search::halve(part, &mut self.halved, level);
                (&mut self.half, self.halved.view())
            }
            _ => {
                search::halve(part, &mut self.halved, level);
                search::halve(self.halved.view(), &mut self.quartered, level);
                (&mut self.quarter, self.quartered.view())
            }
        };
        self.candidates.clear();
        self.candidates.reserve(2 * most);
        for polarity in [Polarity::BlackOnWhite, Polarity::WhiteOnBlack] {
            let shown = match polarity {
                Polarity::BlackOnWhite => picture,
                Polarity::WhiteOnBlack if self.config.inverted => {
                    search::invert(picture, &mut self.inverse);
                    self.inverse.view()
                }
                Polarity::WhiteOnBlack => continue,
            };
            let quads = search.quads(shown, &self.rectify, limits, &self.known, level);
            self.candidates.extend(quads.iter().map(|&Found { quad, hull }| Candidate {
                quad,
                hull,
                polarity,
                found: None,
            }));
        }
        let (view, patterns) = (View::new(luma, lens), &self.patterns);
        self.candidates.par_iter_mut().with_min_len(4).for_each(|candidate| {
            let Candidate { quad, hull, polarity, .. } = *candidate;
            let found = read(&view, &quad, polarity, step, wanted, patterns);
            candidate.found = found.map(|found| Decoded { doubtful: found.doubtful || hull, ..found });
        });
        self.decoded.extend(self.candidates.iter().filter_map(|c| c.found));
        let weak = wanted.iter().any(|w| is_weak(w.family));
        // what is doubtful here may be plain in the next picture
        let is_known = |candidate: &&Candidate| {
            candidate.found.map_or(!weak && !candidate.hull, |found| !found.doubtful)
        };
        self.known.extend(
            self.candidates
                .iter()
                .filter(is_known)
                .map(|candidate| bounds(&candidate.quad.map(|p| rectify::seen(lens, p))))
                .filter(|[low, high]| (*high - *low).max_element() >= LEAST_KNOWN_PX * f64::from(step / 2)),
        );
    }
}

/// Reads the quad as one of the wanted families, the clearest reading if several fit; as a picture only where
/// no code is read.
fn read(
    view: &View<'_>,
    quad: &Quad,
    polarity: Polarity,
    step: u32,
    wanted: &[Wanted],
    patterns: &Patterns,
) -> Option<Decoded> {
    let mut best: Option<Decoded> = None;
    for family in Family::ALL {
        if !wanted.iter().any(|w| w.family == family) || (step > 1 && is_weak(family)) {
            continue;
        }
        let found = decode::decode(view, quad, family, polarity)
            .filter(|found| wish(wanted, family, found.reading.id).is_some());
        if let Some(found) = found
            && best.is_none_or(|best| {
                (found.reading.hamming, best.margin) < (best.reading.hamming, found.margin)
            })
        {
            best = Some(found);
        }
    }
    if best.is_none() && step == 1 && wanted.iter().any(|w| w.family == Family::Pattern) {
        best = decode::decode_picture(view, quad, patterns, polarity)
            .filter(|found| wish(wanted, Family::Pattern, found.reading.id).is_some());
    }
    best
}

/// Whether what looks a little like a marker is easily read as one of this family: short codes, and pictures. They
/// are read in the whole picture only, where outlines are exact.
fn is_weak(family: Family) -> bool {
    family == Family::Pattern || family.chance(0) > 0.05
}

/// Least and greatest corner of the box around a quad.
fn bounds(quad: &Quad) -> [DVec2; 2] {
    let low = quad.iter().fold(DVec2::INFINITY, |a, p| a.min(*p));
    [low, quad.iter().fold(DVec2::NEG_INFINITY, |a, p| a.max(*p))]
}

/// What was said about this marker: by its number first, then by its family.
pub fn wish(wanted: &[Wanted], family: Family, id: u32) -> Option<&Wanted> {
    let of = |number: Option<u32>| wanted.iter().find(|w| w.family == family && w.id == number);
    of(Some(id)).or_else(|| of(None))
}

/// Sharpens the corners and solves the poses. `None` where a doubtful reading does not stand that test.
fn sight(
    view: &View<'_>,
    found: &Decoded,
    wanted: &[Wanted],
    align: Option<(&Rectify, Level)>,
) -> Option<Sighting> {
    let aligned = align.and_then(|(rectify, level)| {
        let start = align::Start {
            pattern: &align::Pattern::new(found.family, found.reading.id)?,
            quad: found.quad,
            inks: [found.black, found.white],
            blur: None,
            doubt_px: 0.0,
            most: align::MOST_SAMPLES,
        };
        align::align(view, &start, rectify, level)
    });
    if !found.stands(aligned.as_ref()) {
        return None;
    }
    let mut quad = aligned.map_or(found.quad, |aligned| aligned.quad);
    let wanted = wish(wanted, found.family, found.reading.id);
    let side_mm = wanted.map(|w| w.side_mm).filter(|side| side.is_finite() && *side > 0.0);
    let (mut pose, mut pose_alt) = (None, None);
    match (side_mm, aligned) {
        (Some(side_mm), Some(aligned)) => {
            let ideal = Lens { distortion: [0.0; 8], ..*view.lens };
            let minima = solve::minima(&quad, &aligned.information, side_mm, &ideal);
            if !(found.doubtful && is_open(&minima)) {
                [pose, pose_alt] = minima.map(|m| m.map(|m| Solved { pose: m.pose, error_px: m.error_px }));
            }
            // where the picture agrees that the print is a rigid square, its corners are that square's
            if let Some(best) = minima[0].filter(|best| best.cost < RIGID)
                && let Some(corners) = best.corners(side_mm, &ideal)
            {
                quad = corners;
            }
        }
        (Some(side_mm), None) => {
            let seen = quad.map(|p| rectify::seen(view.lens, p));
            (pose, pose_alt) = solve::solve(&seen, side_mm, view.lens);
        }
        (None, _) => {}
    }
    let corners = quad.map(|p| rectify::seen(view.lens, p));
    Some(Sighting {
        family: found.family,
        id: found.reading.id,
        corners,
        hamming: found.reading.hamming,
        margin: found.margin as f32,
        pose,
        pose_alt,
        state: State::Found,
    })
}

/// Whether the picture hardly decides which of the two poses it is.
fn is_open(minima: &[Option<solve::Minimum>; 2]) -> bool {
    matches!(minima, [Some(best), Some(other)] if other.cost - best.cost < OPEN)
}

/// Orders by family and id; of overlapping readings of one marker the best stays: one beyond doubt, fewer corrected
/// bits, then the clearer one.
fn keep_best(found: &mut Vec<Decoded>) {
    let center = |d: &Decoded| (d.quad[0] + d.quad[1] + d.quad[2] + d.quad[3]) * 0.25;
    let key = |d: &Decoded| (d.family, d.reading.id, d.doubtful, d.reading.hamming);
    found.sort_unstable_by(|a, b| {
        let place = |d: &Decoded| (center(d).y, center(d).x);
        let by_place = |a: (f64, f64), b: (f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
        key(a).cmp(&key(b)).then(b.margin.total_cmp(&a.margin)).then(by_place(place(a), place(b)))
    });
    let mut kept = 0;
    for i in 0..found.len() {
        let this = found[i];
        let reach = |d: &Decoded| (d.quad[2] - d.quad[0]).length().max((d.quad[3] - d.quad[1]).length());
        let again = found[..kept].iter().any(|other| {
            let apart = (center(other) - center(&this)).length();
            let same = (other.family, other.reading.id) == (this.family, this.reading.id);
            same && apart < 0.5 * reach(other).max(reach(&this))
        });
        if !again {
            found[kept] = this;
            kept += 1;
        }
    }
    found.truncate(kept);
}

/// Mean side of a quadrilateral of corners, px.
pub fn mean_side(corners: &[DVec2; 4]) -> f64 {
    (0..4).map(|i| (corners[(i + 1) % 4] - corners[i]).length()).sum::<f64>() * 0.25
}
