//! What following a film's markers comes to: share tracked, flips, lag, jitter, time.

use super::markers::SIDE_MM;
use super::motion::{Film, RATE, Seen};
use crate::frame::{Sighting, State};
use crate::geometry::Pose;
use crate::pixels::Plane;
use crate::pixels::simd::Level;
use crate::track::{Config, Tracker, Wanted, mean_side};
use glam::{DVec2, DVec3};
use std::time::{Duration, Instant};

/// What following a film came to.
#[derive(Clone, Debug, Default)]
pub struct Followed {
    /// Readable markers, and those of them that were reported where they are.
    pub readable: usize,
    /// Of the readable ones, those reported within 3 px (mean over corners).
    pub tracked: usize,
    /// Reports of a number that is not in the picture, or far from where it is (readable ones only).
    pub wrong: usize,
    /// Poses more than 5° off while the other minimum was nearer.
    pub flipped: usize,
    /// Most frames from a marker's first readable picture to its first report.
    pub delay: usize,
    /// How far poses are behind, frames: error of the rotation by the angular velocity, and of the translation.
    pub lag: [f64; 2],
    /// Deviation of rotation (degrees) and of distance (share) about their means, from the 61st frame on.
    pub jitter: [f64; 2],
    /// Root mean square error of the corners, px, and of the rotation, degrees.
    pub error: [f64; 2],
    /// Mean time of a picture with nothing but followed markers, ms; and of the others.
    pub ms: [f64; 2],
}

/// Follows the film's markers; times are the least of `repeats` runs, picture by picture.
pub fn follow(
    film: &Film,
    pictures: &[Plane<u8>],
    config: &Config,
    level: Level,
    repeats: usize,
) -> Followed {
    let wanted = [Wanted { family: film.family, id: None, side_mm: SIDE_MM }];
    let mut times = vec![f64::MAX; pictures.len()];
    let mut out = Followed::default();
    let mut tally = Tally::default();
    for repeat in 0..repeats.max(1) {
        let mut tracker = Tracker::new(config.clone(), level);
        tracker.find(pictures[0].view(), &film.lens, &wanted);
        for (frame, (picture, ms)) in pictures.iter().zip(&mut times).enumerate() {
            let at = Duration::from_secs_f64(frame as f64 / RATE);
            let start = Instant::now();
            let sightings = tracker.follow(picture.view(), &film.lens, &wanted, at);
            *ms = ms.min(start.elapsed().as_secs_f64() * 1e3);
            if repeat == 0 {
                tally.add(film, frame, sightings, &mut out);
            }
        }
    }
    tally.finish(&mut out);
    // a picture is searched in full where the one before showed nothing
    for kind in [true, false] {
        let known = |frame: usize| frame > 0 && tally.shown[frame - 1];
        let of = (0..times.len()).filter(|&frame| known(frame) == kind);
        let (sum, count) = of.fold((0.0, 0.0), |(sum, count), frame| (sum + times[frame], count + 1.0));
        out.ms[usize::from(!kind)] = sum / count;
    }
    out
}

impl Followed {
    /// Two films as one: counts added, the rest the worse of both.
    pub fn and(&self, b: &Self) -> Self {
        let a = self;
        let worse =
            |a: [f64; 2], b: [f64; 2]| [0, 1].map(|i| if b[i].abs() > a[i].abs() { b[i] } else { a[i] });
        Self {
            readable: a.readable + b.readable,
            tracked: a.tracked + b.tracked,
            wrong: a.wrong + b.wrong,
            flipped: a.flipped + b.flipped,
            delay: a.delay.max(b.delay),
            lag: worse(a.lag, b.lag),
            jitter: worse(a.jitter, b.jitter),
            error: worse(a.error, b.error),
            ms: [0, 1].map(|i| a.ms[i].max(b.ms[i])),
        }
    }
}

/// Mean distance of corners from where they are.
fn off(corners: &[DVec2; 4], seen: &Seen) -> f64 {
    corners.iter().zip(&seen.corners).map(|(a, b)| (*a - *b).length()).sum::<f64>() * 0.25
}

/// Rotation from one pose to another about the camera's axes, radians.
fn turn(from: &Pose, to: &Pose) -> DVec3 {
    let d = to.rotation * from.rotation.transpose();
    let axis = DVec3::new(d.y_axis.z - d.z_axis.y, d.z_axis.x - d.x_axis.z, d.x_axis.y - d.y_axis.x);
    let sine = axis.length();
    if sine > 1e-12 { axis / sine * from.angle_to(to) } else { DVec3::ZERO }
}

#[derive(Default)]
struct Tally {
    /// Number, first readable frame, frames until it was reported.
    known: Vec<(u32, usize, bool)>,
    shown: Vec<bool>,
    corners: f64,
    count: f64,
    turns: f64,
    poses: f64,
    /// Error by velocity and velocity squared, of rotation and translation.
    lag: [[f64; 2]; 2],
    late: Vec<Pose>,
}

impl Tally {
    fn add(&mut self, film: &Film, frame: usize, sightings: &[Sighting], out: &mut Followed) {
        let truth = film.truth(frame);
        let before = film.truth(frame.max(1) - 1);
        for seen in &truth {
            let mine = sightings.iter().filter(|s| s.id == seen.id);
            let found = mine.min_by(|a, b| off(&a.corners, seen).total_cmp(&off(&b.corners, seen)));
            let near = found.filter(|s| off(&s.corners, seen) < 3.0 + 0.02 * mean_side(&seen.corners));
            if !seen.readable {
                continue;
            }
            out.readable += 1;
            out.tracked += usize::from(near.is_some());
            out.wrong += usize::from(found.is_some() && near.is_none());
            match self.known.iter_mut().find(|(id, ..)| *id == seen.id) {
                None => self.known.push((seen.id, 0, near.is_some())),
                Some((_, waited, reported)) if !*reported => {
                    *waited += 1;
                    *reported = near.is_some();
                    out.delay = out.delay.max(*waited);
                }
                Some(_) => {}
            }
            let Some(sighting) = near else { continue };
            let squares = (0..4).map(|i| (sighting.corners[i] - seen.corners[i]).length_squared());
            self.corners += squares.sum::<f64>() * 0.25;
            self.count += 1.0;
            let Some(solved) = sighting.pose else { continue };
            let wrong = solved.pose.angle_to(&seen.pose);
            let other = sighting.pose_alt.map_or(f64::MAX, |alt| alt.pose.angle_to(&seen.pose));
            out.flipped += usize::from(wrong > 5f64.to_radians() && other < wrong);
            self.turns += wrong * wrong;
            self.poses += 1.0;
            if frame > 60 {
                self.late.push(solved.pose);
            }
            if let (Some(before), true) = (before.iter().find(|b| b.id == seen.id), frame > 10) {
                let (error, speed) = (turn(&solved.pose, &seen.pose), turn(&before.pose, &seen.pose));
                self.lag[0][0] += error.dot(speed);
                self.lag[0][1] += speed.length_squared();
                let error = seen.pose.translation - solved.pose.translation;
                let speed = seen.pose.translation - before.pose.translation;
                self.lag[1][0] += error.dot(speed);
                self.lag[1][1] += speed.length_squared();
            }
        }
        let foreign = |s: &&Sighting| truth.iter().all(|t| t.id != s.id) && s.state != State::Held;
        out.wrong += sightings.iter().filter(foreign).count();
        self.shown.push(!sightings.is_empty());
    }

    fn finish(&self, out: &mut Followed) {
        out.error = [(self.corners / self.count).sqrt(), (self.turns / self.poses).sqrt().to_degrees()];
        out.lag = self.lag.map(|[by, square]| by / square.max(1e-12));
        let Some(first) = self.late.first() else { return };
        let n = self.late.len() as f64;
        let turns: Vec<DVec3> = self.late.iter().map(|pose| turn(first, pose)).collect();
        let mean = turns.iter().sum::<DVec3>() / n;
        let square = turns.iter().map(|t| (*t - mean).length_squared()).sum::<f64>() / n;
        let far: Vec<f64> = self.late.iter().map(|pose| pose.translation.length()).collect();
        let middle = far.iter().sum::<f64>() / n;
        let spread = far.iter().map(|z| (z - middle) * (z - middle)).sum::<f64>() / n;
        out.jitter = [square.sqrt().to_degrees(), spread.sqrt() / middle];
    }
}
