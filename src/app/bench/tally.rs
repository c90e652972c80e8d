//! What a tracker made of pictures with exact truth: recall, errors, flips, false positives, jitter.

use super::markers::{Difficulty, SIDE_MM, Setup, Shot, Truth};
use crate::frame::Sighting;
use crate::marker::Family;
use crate::track::{Tracker, Wanted};
use glam::{DVec2, DVec3};

/// A sighting farther off than this (mean over its corners) is not the marker, px.
const NEAR_PX: f64 = 5.0;
/// A pose more than this off is flipped where the other minimum is nearer, degrees.
const FLIPPED_DEG: f64 = 5.0;
/// Pictures of a resting marker in which it must be seen for its jitter to count.
const LEAST_DRAWS: usize = 10;

/// Every marker of a family, with the set's printed side.
pub fn every(family: Family) -> [Wanted; 1] {
    [Wanted { family, id: None, side_mm: SIDE_MM }]
}

/// What was made of markers of one difficulty, or of all.
#[derive(Clone, Debug, Default)]
pub struct Class {
    /// Markers in the pictures.
    pub drawn: usize,
    /// Those that were found.
    pub found: usize,
    /// Those with a pose.
    pub posed: usize,
    /// Poses more than 5° off while the second one is nearer to the truth.
    pub flipped: usize,
    /// Error of each found corner, px.
    pub corner_px: Vec<f64>,
    /// Error of each pose's rotation, degrees.
    pub rotation_deg: Vec<f64>,
    /// Error of each pose's distance from the camera, % of it.
    pub distance_percent: Vec<f64>,
}

impl Class {
    /// Share of the markers that were found; NaN without markers.
    pub fn recall(&self) -> f64 {
        self.found as f64 / self.drawn as f64
    }

    /// Share of the poses that are flipped; NaN without poses.
    pub fn flips(&self) -> f64 {
        self.flipped as f64 / self.posed as f64
    }

    fn count(&mut self, truth: &Truth, sighting: Option<&Sighting>) {
        self.drawn += 1;
        let Some(sighting) = sighting else { return };
        self.found += 1;
        self.corner_px.extend((0..4).map(|i| (sighting.corners[i] - truth.corners[i]).length()));
        let Some(solved) = sighting.pose else { return };
        self.posed += 1;
        let off_deg = solved.pose.angle_to(&truth.pose).to_degrees();
        let other_deg = sighting.pose_alt.map(|alt| alt.pose.angle_to(&truth.pose).to_degrees());
        self.flipped += usize::from(off_deg > FLIPPED_DEG && other_deg.is_some_and(|other| other < off_deg));
        self.rotation_deg.push(off_deg);
        let (far, truly) = (solved.pose.translation.length(), truth.pose.translation.length());
        self.distance_percent.push(100.0 * (far - truly).abs() / truly);
    }

    fn join(&mut self, other: &Self) {
        self.drawn += other.drawn;
        self.found += other.found;
        self.posed += other.posed;
        self.flipped += other.flipped;
        self.corner_px.extend(&other.corner_px);
        self.rotation_deg.extend(&other.rotation_deg);
        self.distance_percent.extend(&other.distance_percent);
    }
}

/// What was made of a set of pictures.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    classes: [Class; 3],
    /// Sightings of what is not there, or is elsewhere.
    pub ghosts: usize,
}

impl Tally {
    /// Looks for every marker of the shot's family, each picture on its own.
    pub fn add(&mut self, tracker: &mut Tracker, shot: &Shot) {
        for picture in &shot.pictures {
            let sightings = tracker.find(picture.view(), &shot.setup.lens, &every(shot.setup.family));
            self.count(&shot.truth, sightings);
        }
    }

    /// Counts what was seen in one picture.
    pub fn count(&mut self, truth: &[Truth], sightings: &[Sighting]) {
        for truth in truth {
            let found = sightings.iter().find(|sighting| is_of(sighting, truth));
            self.classes[truth.difficulty as usize].count(truth, found);
        }
        self.ghosts += sightings.iter().filter(|s| !truth.iter().any(|truth| is_of(s, truth))).count();
    }

    /// What was made of the markers of one difficulty.
    pub fn class(&self, difficulty: Difficulty) -> &Class {
        &self.classes[difficulty as usize]
    }

    /// What was made of all markers.
    pub fn all(&self) -> Class {
        let mut all = Class::default();
        self.classes.iter().for_each(|class| all.join(class));
        all
    }
}

/// What was made of markers at rest.
#[derive(Clone, Debug, Default)]
pub struct Still {
    /// Markers whose jitter counts: seen in ten pictures or more.
    pub steady: usize,
    /// Markers looked at.
    pub drawn: usize,
    /// The noise's deviation, and the root mean square distance of a corner from its mean place, px.
    pub jitter_px: Vec<(f64, f64)>,
}

impl Still {
    /// Looks at every picture of the shot, each on its own.
    pub fn add(&mut self, tracker: &mut Tracker, shot: &Shot) {
        let mut seen: Vec<Vec<[DVec2; 4]>> = vec![Vec::new(); shot.truth.len()];
        for picture in &shot.pictures {
            let sightings = tracker.find(picture.view(), &shot.setup.lens, &every(shot.setup.family));
            for (truth, seen) in shot.truth.iter().zip(&mut seen) {
                seen.extend(sightings.iter().find(|s| is_of(s, truth)).map(|s| s.corners));
            }
        }
        self.drawn += seen.len();
        for draws in seen.iter().filter(|draws| draws.len() >= LEAST_DRAWS) {
            self.steady += 1;
            self.jitter_px.extend(jitter(draws).map(|px| (shot.setup.sigma, px)));
        }
    }

    /// The jitter's quantile; of one noise only if asked.
    pub fn jitter(&self, sigma: Option<f64>, q: f64) -> f64 {
        let of = self.jitter_px.iter().filter(|(s, _)| sigma.is_none_or(|sigma| sigma == *s));
        quantile(&of.map(|(_, px)| *px).collect::<Vec<_>>(), q)
    }
}

/// Root mean square distance of each corner from its mean place.
fn jitter(draws: &[[DVec2; 4]]) -> [f64; 4] {
    let count = draws.len() as f64;
    std::array::from_fn(|i| {
        let mean = draws.iter().fold(DVec2::ZERO, |sum, draw| sum + draw[i]) / count;
        (draws.iter().map(|draw| (draw[i] - mean).length_squared()).sum::<f64>() / count).sqrt()
    })
}

/// How many markers of `family` are seen in the shot's pictures where there is none. A print of another family is
/// one of this family too if its squares are the same, as those of dictionaries that contain each other.
pub fn ghosts(tracker: &mut Tracker, shot: &Shot, family: Family) -> usize {
    let unfounded = |sighting: &&Sighting| !stands(&shot.setup, sighting);
    let picture =
        |picture| tracker.find(picture, &shot.setup.lens, &every(family)).iter().filter(unfounded).count();
    shot.pictures.iter().map(|p| p.view()).map(picture).sum()
}

/// Whether a print of the setup is what was sighted, whatever family it was drawn from.
fn stands(setup: &Setup, sighting: &Sighting) -> bool {
    let center = sighting.corners.iter().fold(DVec2::ZERO, |sum, p| sum + *p) * 0.25;
    setup.prints.iter().any(|(id, pose)| {
        let same = setup.family.cells() == sighting.family.cells()
            && setup
                .family
                .code(*id)
                .and_then(|code| sighting.family.read(code))
                .is_some_and(|reading| reading.hamming == 0 && reading.id == sighting.id);
        let place = setup.lens.project(pose.apply(DVec3::ZERO));
        // the corners' mean is not quite the center's picture
        let reach = NEAR_PX + 0.1 * crate::track::mean_side(&sighting.corners);
        same && place.is_some_and(|place| (place - center).length() < reach)
    })
}

fn is_of(sighting: &Sighting, truth: &Truth) -> bool {
    let off = (0..4).map(|i| (sighting.corners[i] - truth.corners[i]).length()).sum::<f64>() * 0.25;
    sighting.id == truth.id && off < NEAR_PX
}

/// The value below which a share `q` lies; NaN of nothing.
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((last as f64 * q) as usize).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Solved;
    use crate::geometry::Pose;
    use crate::pixels::{Size, SplitMix64};
    use glam::DMat3;

    /// A frame's truth, and sightings that agree with it exactly.
    fn exact() -> (Vec<Truth>, Vec<Sighting>) {
        let mut rng = SplitMix64::new(4);
        let truth = Setup::accuracy(&mut rng, Size::new(640, 480), Family::Tag36h11).truth();
        assert!(truth.len() > 1);
        let sighting = |truth: &Truth| Sighting {
            family: Family::Tag36h11,
            id: truth.id,
            corners: truth.corners,
            hamming: 0,
            margin: 50.0,
            pose: Some(Solved { pose: truth.pose, error_px: 0.0 }),
            pose_alt: None,
            state: crate::frame::State::Found,
        };
        let sightings = truth.iter().map(sighting).collect();
        (truth, sightings)
    }

    fn tally(truth: &[Truth], sightings: &[Sighting]) -> (Class, usize) {
        let mut tally = Tally::default();
        tally.count(truth, sightings);
        (tally.all(), tally.ghosts)
    }

    #[test]
    fn what_is_right_wrong_and_missing_is_counted() {
        let (truth, mut sightings) = exact();
        let (all, ghosts) = tally(&truth, &sightings);
        assert_eq!((all.found, all.posed, all.flipped, ghosts), (truth.len(), truth.len(), 0, 0));
        assert!(all.corner_px.iter().chain(&all.distance_percent).all(|&error| error == 0.0));
        // one corner 2 px off is the marker still; all 6 px off are another
        sightings[0].corners[1].x += 2.0;
        let (all, ghosts) = tally(&truth, &sightings);
        assert_eq!((all.recall(), ghosts), (1.0, 0));
        assert!((quantile(&all.corner_px, 1.0) - 2.0).abs() < 1e-9);
        sightings[0].corners.iter_mut().for_each(|corner| corner.y += 6.0);
        let (all, ghosts) = tally(&truth, &sightings);
        assert_eq!((all.found, ghosts), (truth.len() - 1, 1));
        let (all, ghosts) = tally(&[], &sightings);
        assert!(all.recall().is_nan() && ghosts == sightings.len());
    }

    #[test]
    fn a_flip_is_a_wrong_pose_with_a_better_one_beside_it() {
        let (truth, mut sightings) = exact();
        let turned = |degrees: f64| Solved {
            pose: Pose {
                rotation: truth[0].pose.rotation * DMat3::from_rotation_x(degrees.to_radians()),
                ..truth[0].pose
            },
            error_px: 0.0,
        };
        let mut flips = |first: f64, second: Option<f64>| {
            sightings[0].pose = Some(turned(first));
            sightings[0].pose_alt = second.map(turned);
            tally(&truth, &sightings).0.flipped
        };
        assert_eq!([flips(30.0, Some(1.0)), flips(30.0, Some(40.0)), flips(30.0, None)], [1, 0, 0]);
        assert_eq!([flips(4.0, Some(1.0)), flips(1.0, Some(30.0))], [0, 0]);
    }

    #[test]
    fn jitter_is_the_distance_from_the_mean() {
        let at =
            |x: f64| [DVec2::new(10.0 + x, 5.0), DVec2::new(20.0, 5.0 - 2.0 * x), DVec2::ONE, DVec2::ZERO];
        let found = jitter(&[at(0.3), at(-0.3), at(0.3), at(-0.3)]);
        for (found, expected) in found.into_iter().zip([0.3, 0.6, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn a_print_counts_for_every_family_that_has_its_squares() {
        let mut rng = SplitMix64::new(2);
        let setup = Setup::negative(&mut rng, Size::new(640, 480), Family::Aruco4x4_50, true);
        let (id, pose) = setup.prints[0];
        let place = setup.lens.project(pose.apply(DVec3::ZERO)).expect("in view");
        let (_, sightings) = exact();
        let seen = |family, id, shift: f64| Sighting {
            family,
            id,
            corners: crate::track::solve::corners_mm(20.0).map(|p| place + DVec2::new(p.x + shift, -p.y)),
            ..sightings[0]
        };
        assert!(stands(&setup, &seen(Family::Aruco4x4_50, id, 0.0)));
        assert!(stands(&setup, &seen(Family::Aruco4x4_1000, id, 0.0)));
        assert!(!stands(&setup, &seen(Family::Aruco4x4_50, id, 30.0)));
        assert!(!stands(&setup, &seen(Family::Aruco4x4_50, id + 1, 0.0)));
        assert!(!stands(&setup, &seen(Family::Aruco5x5_50, id, 0.0)));
    }
}
