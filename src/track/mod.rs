//! Markers in a gray picture: which, where, and in which pose.
//!
//! Comes in: the luma plane, the lens, and what the scene wants; goes out: `Sighting`s ordered by family and
//! id. The way through, one file a step: `threshold` (gray → bits) → `segment` (bits → blobs) → `contour` and
//! `quad` (blob → corners, in the ideal pixels of `rectify`) → `ring` and `decode` (quad → code or picture) →
//! `align` (sub-pixel corners from the whole print) → `solve` (both poses). Every step refuses early what cannot
//! be a marker, and the work on a picture of noise is bounded.
//!
//! Every picture is searched on its own; nothing is carried from one to the next. The result does not depend
//! on the number of threads nor on the SIMD level.

mod align;
mod contour;
mod decode;
mod quad;
mod rectify;
mod ring;
mod segment;
pub mod solve;
mod threshold;

use crate::frame::Sighting;
use crate::geometry::Lens;
use crate::marker::{Family, Patterns, Polarity};
use crate::pixels::{PlaneRef, simd::Level};
use contour::Crack;
use decode::{Decoded, View};
use glam::DVec2;
use rayon::prelude::*;
use rectify::Rectify;
use segment::Segment;
use serde::{Deserialize, Serialize};
use threshold::Threshold;

/// Largest picture side the tracker works on, px (contours count half pixels in 16 bits). Larger pictures
/// show no markers.
pub const MOST_SIDE_PX: usize = 16_000;

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
    /// Whether corners are aligned to the whole print (sub-pixel accuracy) or left as the outline gave them.
    /// Default true.
    pub align: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self { least_side_px: 10, least_contrast: 6, most_candidates: 1500, align: true }
    }
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

/// A contour that may be a marker's, and what was read in it.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    from: usize,
    to: usize,
    area: i64,
    found: Option<Sighting>,
}

/// Finds markers; owns every buffer it needs.
#[derive(Debug)]
pub struct Tracker {
    config: Config,
    level: Level,
    patterns: Patterns,
    threshold: Threshold,
    segment: Segment,
    rectify: Rectify,
    order: Vec<u32>,
    contours: Vec<Crack>,
    candidates: Vec<Candidate>,
    sightings: Vec<Sighting>,
}

impl Tracker {
    /// A tracker that runs at the given SIMD level.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            config,
            level,
            patterns: Patterns::default(),
            threshold: Threshold::default(),
            segment: Segment::default(),
            rectify: Rectify::default(),
            order: Vec::new(),
            contours: Vec::new(),
            candidates: Vec::new(),
            sightings: Vec::new(),
        }
    }

    /// The same tracker, knowing the picture markers that [`Family::Pattern`] counts.
    pub fn knowing(mut self, patterns: Patterns) -> Self {
        self.patterns = patterns;
        self
    }

    /// The wanted markers in view, ordered by family and id.
    ///
    /// `lens` holds for this picture. Of markers with the same id only those that stand clearly apart are
    /// reported. Poses are `None` where the corners decide none. Allocates only when a picture is larger or
    /// fuller than any before.
    pub fn find(&mut self, luma: PlaneRef<'_, u8>, lens: &Lens, wanted: &[Wanted]) -> &[Sighting] {
        self.sightings.clear();
        let size = luma.size();
        let usable = size.width.min(size.height) >= 8 && size.width.max(size.height) <= MOST_SIDE_PX;
        let finite = lens.focal.is_finite() && lens.center.is_finite() && lens.focal.min_element() > 0.0;
        if !usable || !finite || wanted.is_empty() {
            return &self.sightings;
        }
        wanted.iter().for_each(|w| w.family.prepare());
        self.rectify.prepare(lens, size);
        self.threshold.apply(luma, self.config.least_contrast.clamp(1, 60), self.level);
        self.outline();
        let (contours, rectify, align) = (&self.contours, &self.rectify, self.config.align);
        let patterns = &self.patterns;
        let view = View { luma, lens };
        self.candidates.par_iter_mut().with_min_len(4).for_each(|candidate| {
            let contour = &contours[candidate.from..candidate.to];
            candidate.found = quad::fit(contour, candidate.area, rectify)
                .and_then(|quad| read(&view, &quad, wanted, patterns))
                .map(|decoded| sight(&view, &decoded, wanted, align));
        });
        self.sightings.extend(self.candidates.iter().filter_map(|c| c.found));
        keep_best(&mut self.sightings);
        &self.sightings
    }

    /// Contours of the blobs that may be markers, largest boxes first.
    fn outline(&mut self) {
        let mask = self.threshold.mask();
        let blobs = self.segment.blobs(mask, self.config.least_side_px.max(8));
        self.order.clear();
        self.order.extend(0..blobs.len() as u32);
        let size = |i: &u32| blobs[*i as usize].extent().iter().sum::<u32>();
        self.order.sort_unstable_by_key(|i| (std::cmp::Reverse(size(i)), *i));
        self.order.truncate(self.config.most_candidates);
        self.contours.clear();
        self.candidates.clear();
        for &i in &self.order {
            let blob = &blobs[i as usize];
            let from = self.contours.len();
            let Some(area) = contour::trace(mask, blob, &mut self.contours) else { continue };
            let [w, h] = blob.extent().map(i64::from);
            // the thinnest view of a square still fills this much of its box
            if 6 * area < w * h {
                self.contours.truncate(from);
                continue;
            }
            self.candidates.push(Candidate { from, to: self.contours.len(), area, found: None });
        }
    }
}

/// Reads the quad as one of the wanted families, the clearest reading if several fit; as a picture only where
/// no code is read.
fn read(view: &View<'_>, quad: &quad::Quad, wanted: &[Wanted], patterns: &Patterns) -> Option<Decoded> {
    let polarity = Polarity::BlackOnWhite;
    let mut best: Option<Decoded> = None;
    for family in Family::ALL {
        if !wanted.iter().any(|w| w.family == family) {
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
    if best.is_none() && wanted.iter().any(|w| w.family == Family::Pattern) {
        best = decode::decode_picture(view, quad, patterns, polarity)
            .filter(|found| wish(wanted, Family::Pattern, found.reading.id).is_some());
    }
    best
}

/// What was said about this marker: by its number first, then by its family.
pub fn wish(wanted: &[Wanted], family: Family, id: u32) -> Option<&Wanted> {
    let of = |number: Option<u32>| wanted.iter().find(|w| w.family == family && w.id == number);
    of(Some(id)).or_else(|| of(None))
}

/// Sharpens the corners and solves the poses.
fn sight(view: &View<'_>, found: &Decoded, wanted: &[Wanted], align: bool) -> Sighting {
    let aligned = if align { align::align(view, found) } else { None };
    let quad = aligned.unwrap_or(found.quad);
    let corners = quad.map(|p| rectify::seen(view.lens, p));
    let side_mm = wish(wanted, found.family, found.reading.id).map_or(f64::NAN, |w| w.side_mm);
    let (pose, pose_alt) = solve::solve(&corners, side_mm, view.lens);
    Sighting {
        family: found.family,
        id: found.reading.id,
        corners,
        hamming: found.reading.hamming,
        margin: found.margin as f32,
        pose,
        pose_alt,
    }
}

/// Orders by family and id; of overlapping sightings of one marker the best stays: fewer corrected bits,
/// then the clearer one.
fn keep_best(sightings: &mut Vec<Sighting>) {
    let center = |s: &Sighting| (s.corners[0] + s.corners[1] + s.corners[2] + s.corners[3]) * 0.25;
    let key = |s: &Sighting| (s.family, s.id, s.hamming);
    sightings.sort_unstable_by(|a, b| {
        let place = |s: &Sighting| (center(s).y, center(s).x);
        let by_place = |a: (f64, f64), b: (f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
        key(a).cmp(&key(b)).then(b.margin.total_cmp(&a.margin)).then(by_place(place(a), place(b)))
    });
    let mut kept = 0;
    for i in 0..sightings.len() {
        let this = sightings[i];
        let reach =
            |s: &Sighting| (s.corners[2] - s.corners[0]).length().max((s.corners[3] - s.corners[1]).length());
        let again = sightings[..kept].iter().any(|other| {
            let apart = (center(other) - center(&this)).length();
            other.family == this.family && other.id == this.id && apart < 0.5 * reach(other).max(reach(&this))
        });
        if !again {
            sightings[kept] = this;
            kept += 1;
        }
    }
    sightings.truncate(kept);
}

/// Mean side of a quadrilateral of corners, px.
pub fn mean_side(corners: &[DVec2; 4]) -> f64 {
    (0..4).map(|i| (corners[(i + 1) % 4] - corners[i]).length()).sum::<f64>() * 0.25
}
