//! From pictures of the sheet to the solver's views: markers are found, and of many pictures those that differ most
//! are kept.

use crate::app::progress;
use crate::calibration::{Point, View};
use crate::camera::{CameraError, Clip, Grab};
use crate::frame::{Frame, Sighting};
use crate::geometry::Lens;
use crate::marker::{Board, Family};
use crate::pixels::{Size, simd};
use crate::track::{self, Tracker, Wanted};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

/// A picture with too few prints says little of its pose.
const LEAST_PRINTS: usize = 4;
/// Most pictures of a clip.
const MOST_PICTURES: u64 = 100_000;

/// What the pictures show.
pub struct Observed {
    /// Size of the pictures.
    pub size: Size,
    /// How many pictures there were.
    pub pictures: u64,
    /// In how many of them a print of the sheet was seen at all.
    pub seen: u64,
    /// The views, by the number of their picture.
    pub views: BTreeMap<u64, View>,
}

/// Looks for the sheet in the pictures (only in those numbers, where they are named), through `lens` where it is known.
pub fn observe(
    path: &Path,
    board: &Board,
    lens: Option<&Lens>,
    only: Option<&[u64]>,
) -> anyhow::Result<Observed> {
    let mut clip = Clip::open(path, 30.0)?;
    let mut wanted: Vec<Wanted> = Vec::new();
    for print in &board.prints {
        // no side, no pose: corners are not drawn to where a rigid square would have them through a wrong lens
        wanted.push(Wanted { family: print.family, id: Some(print.id), side_mm: f64::NAN });
    }
    let settings = track::Config { quality: track::Quality::Full, ..track::Config::default() };
    let mut tracker = Tracker::new(settings, simd::best());
    let mut frame = Frame::default();
    let mut out = Observed { size: Size::new(0, 0), pictures: 0, seen: 0, views: BTreeMap::new() };
    let bar = progress::bar(clip.len().map(|n| n as u64), "pictures");
    while let Grab::Frame = clip.next(&mut frame)? {
        if out.size != frame.size() && out.pictures > 0 {
            return Err(CameraError::Format {
                name: path.display().to_string(),
                reason: format!(
                    "picture {} is {}, those before {}: one calibration is of one size",
                    frame.sequence,
                    frame.size(),
                    out.size
                ),
            }
            .into());
        }
        out.size = frame.size();
        out.pictures += 1;
        anyhow::ensure!(
            out.pictures <= MOST_PICTURES,
            "more than {MOST_PICTURES} pictures: give a shorter clip"
        );
        bar.inc(1);
        if only.is_some_and(|only| !only.contains(&frame.sequence)) {
            continue;
        }
        let guess = Lens::guess(frame.size());
        let sightings = tracker.find(frame.luma.view(), lens.unwrap_or(&guess), &wanted);
        out.seen += u64::from(!sightings.is_empty());
        let view = view(board, sightings);
        if view.points.len() >= 4 * LEAST_PRINTS {
            out.views.insert(frame.sequence, view);
        }
    }
    bar.finish_and_clear();
    Ok(out)
}

/// The corners of the prints that are seen once.
fn view(board: &Board, sightings: &[Sighting]) -> View {
    let mut points = Vec::new();
    for print in &board.prints {
        let is = |s: &&Sighting| (s.family, s.id) == (print.family, print.id);
        let mut own = sightings.iter().filter(is);
        let (Some(sighting), None) = (own.next(), own.next()) else { continue };
        for (px, mm) in sighting.corners.into_iter().zip(track::solve::corners_mm(print.side_mm)) {
            let at = print.to_board.apply(mm);
            points.push(Point { sheet_mm: DVec2::new(at.x, at.y), px });
        }
    }
    View { points }
}

/// Of many views `most` that differ as much as can be, in order: each next one is the farthest from those chosen, by
/// where the sheet is, how large, and how it is tilted.
pub fn choose(views: &BTreeMap<u64, View>, size: Size, most: usize) -> Vec<u64> {
    let known: Vec<(u64, [f64; 5])> =
        views.iter().filter_map(|(&number, view)| Some((number, looks(view, size)?))).collect();
    let apart = |a: &[f64; 5], b: &[f64; 5]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
    let mut nearest = vec![f64::INFINITY; known.len()];
    let mut chosen = Vec::new();
    // the one with most points first
    let count = |number: &u64| views.get(number).map_or(0, |view| view.points.len());
    let mut next = (0..known.len()).max_by_key(|&i| (count(&known[i].0), std::cmp::Reverse(i)));
    while let Some(i) = next.filter(|_| chosen.len() < most) {
        chosen.push(known[i].0);
        for (near, (_, other)) in nearest.iter_mut().zip(&known) {
            *near = near.min(apart(&known[i].1, other));
        }
        nearest[i] = -1.0;
        next = (0..known.len())
            .filter(|&i| nearest[i] >= 0.0)
            .max_by(|&a, &b| nearest[a].total_cmp(&nearest[b]).then(b.cmp(&a)));
    }
    chosen.sort_unstable();
    chosen
}

/// What a view looks like: middle (of the picture's half sides), size, and how its scale changes across it.
fn looks(view: &View, size: Size) -> Option<[f64; 5]> {
    let map = crate::calibration::homography(view)?;
    let count = view.points.len() as f64;
    let middle = view.points.iter().map(|p| p.sheet_mm).sum::<DVec2>() / count;
    let reach = view.points.iter().map(|p| (p.sheet_mm - middle).length()).fold(0.0, f64::max);
    let scaled = |at: DVec2| {
        let q = map * at.extend(1.0);
        let (x, y) = (map.x_axis, map.y_axis);
        let column = |c: DVec3| (DVec2::new(c.x, c.y) - DVec2::new(q.x, q.y) / q.z * c.z) / q.z;
        column(x).perp_dot(column(y)).abs().sqrt()
    };
    let half = 0.5 * DVec2::new(size.width as f64, size.height as f64);
    let seen = view.points.iter().map(|p| p.px).sum::<DVec2>() / count;
    let place = (seen - half) / half;
    let here = scaled(middle);
    // how much larger the sheet is at one side than at the other: its tilt
    let lean =
        |way: DVec2| libm::log(scaled(middle + way * reach) / scaled(middle - way * reach)).clamp(-2.0, 2.0);
    let looks =
        [place.x, place.y, libm::log(here * reach / half.x), 2.0 * lean(DVec2::X), 2.0 * lean(DVec2::Y)];
    looks.iter().all(|v| v.is_finite()).then_some(looks)
}

/// Whether another family than the board's is in a picture: a likely mistake.
pub fn others(path: &Path, board: &Board) -> Option<Family> {
    let mut clip = Clip::open(path, 30.0).ok()?;
    let mut frame = Frame::default();
    let own = board.prints.first()?.family;
    let codes = Family::ALL.into_iter().filter(|family| *family != own && family.chance(0) < 1e-3);
    let wanted: Vec<Wanted> = codes.map(|family| Wanted { family, id: None, side_mm: f64::NAN }).collect();
    let mut tracker = Tracker::new(track::Config::default(), simd::best());
    let Ok(Grab::Frame) = clip.next(&mut frame) else { return None };
    let lens = Lens::guess(frame.size());
    tracker.find(frame.luma.view(), &lens, &wanted).first().map(|sighting| sighting.family)
}
