//! Lens and poses that explain all views best.
//!
//! Levenberg-Marquardt on the distances in the picture over fx fy cx cy k1 k2 p1 p2 k3 and a pose a view, in f64. The
//! views are tied by the lens alone: each pose is eliminated from its own six equations (Schur's complement), so that
//! the work grows with the number of views, not its cube. Points far off are weighed down, their scale taken from the
//! median. What remains of the equations says how well each number is known.

use super::equations::{Equations, NUMBERS, derivatives, deviations, eliminate, hold, moved};
use super::{View, start};
use crate::geometry::{Lens, Pose, solve_spd};
use crate::pixels::Size;
use glam::{DMat3, DVec2};

/// Fewest points of a view that counts.
const LEAST_POINTS: usize = 12;
/// Fewest views.
const LEAST_VIEWS: usize = 3;
/// Distances up to so many deviations count fully.
const FULL: f64 = 3.0;
/// Least deviation of a corner, px: no measurement is better.
const LEAST_DEVIATION_PX: f64 = 0.003;
/// Most the focal lengths (of their value) and the principal point (of the picture's width) may be in doubt.
const DOUBT: f64 = 0.005;
/// Parts of the picture, across and down, and how many of them must have been seen.
pub const PARTS: [usize; 2] = [6, 4];
const LEAST_PARTS: f64 = 0.5;
/// Views tilted less than this decide no focal length, degrees.
const LEAST_TILT_DEG: f64 = 12.0;
/// A fit worse than this is no fit, px at 640 px of width.
const WORST_RMS_PX: f64 = 2.0;

/// A solved lens.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The lens.
    pub lens: Lens,
    /// One standard deviation of fx fy cx cy (px) and k1 k2 p1 p2 k3, the points' errors taken as independent.
    pub deviations: [f64; NUMBERS],
    /// The views that count.
    pub views: Vec<Fitted>,
    /// Root mean square distance of the points from where they should be, px, weighed.
    pub rms_px: f64,
    /// How many points were weighed down as too far off.
    pub outliers: usize,
    /// Parts of the picture ([`PARTS`]) in which there are points.
    pub parts: usize,
}

/// A view as the lens explains it.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Which of the given views.
    pub index: usize,
    /// Sheet → camera, mm.
    pub pose: Pose,
    /// Root mean square distance of its points, px.
    pub rms_px: f64,
    /// Angle between the sheet's normal and the optical axis, degrees.
    pub tilt_deg: f64,
    /// For each point where it is seen, and how far from where it should be (seen - expected), px.
    pub misses: Vec<(DVec2, DVec2)>,
}

/// Why the views do not decide the lens; its text says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Undetermined {
    /// There are too few.
    #[error(
        "{0} pictures show the sheet well enough, {LEAST_VIEWS} are the least: take 15 or more, the whole sheet in view, sharp"
    )]
    Few(usize),
    /// All of them face the camera.
    #[error(
        "the sheet faces the camera in all pictures (tilted {0:.0}° at most): tilt it by 30° and more, to the left, to the right, up and down"
    )]
    Flat(f64),
    /// Large parts of the picture were never seen.
    #[error(
        "the sheet was seen in {0} of {1} parts of the picture: bring it nearer, into the corners and along the edges"
    )]
    Uncovered(usize, usize),
    /// The equations are near singular for another reason.
    #[error(
        "the pictures are too much alike ({0}): tilt the sheet by 30° and more in all directions, near and far, and cover the corners"
    )]
    Alike(String),
    /// The sheet is not what it is said to be.
    #[error(
        "no lens explains the pictures (RMS {0:.1} px): is the sheet flat, its grid the one that --board names, the clip of one lens at one zoom?"
    )]
    Misfit(f64),
}

/// Solves the lens of a camera from views of a flat sheet, in pictures of `size`.
///
/// Views with fewer than 12 points do not count. Refuses what does not decide the lens to half a percent.
/// Zhang 2000, with OpenCV's distortion.
pub fn solve(views: &[View], size: Size) -> Result<Calibration, Undetermined> {
    let usable = |v: &&(usize, &View)| v.1.points.len() >= LEAST_POINTS;
    let all: Vec<(usize, &View)> = views.iter().enumerate().collect();
    let kept: Vec<(usize, &View, DMat3)> =
        all.iter().filter(usable).filter_map(|&(i, v)| Some((i, v, start::homography(v)?))).collect();
    if kept.len() < LEAST_VIEWS {
        return Err(Undetermined::Few(kept.len()));
    }
    let maps: Vec<DMat3> = kept.iter().map(|(_, _, map)| *map).collect();
    let guess = Lens::guess(size);
    let mut best: Option<Fit<'_>> = None;
    // the homographies' guess, and where that leads nowhere a wide and a long lens
    let starts = [start::lens(&maps, size), guess, Lens { focal: guess.focal * 2.5, ..guess }];
    for lens in starts {
        let placed: Option<Vec<Seen<'_>>> = kept
            .iter()
            .map(|&(index, view, map)| Some(Seen { index, view, pose: start::pose(&map, &lens)? }))
            .collect();
        let Some(seen) = placed else { continue };
        let mut fit = Fit { lens, seen, deviation: f64::INFINITY };
        fit.refine();
        if best.as_ref().is_none_or(|best| fit.deviation < best.deviation) {
            best = Some(fit);
        }
        if best.as_ref().is_some_and(|best| best.deviation < 0.3) {
            break;
        }
    }
    best.ok_or(Undetermined::Few(0))?.judged(size)
}

/// A view with its pose.
#[derive(Clone)]
struct Seen<'a> {
    index: usize,
    view: &'a View,
    pose: Pose,
}

/// A state of the fit.
#[derive(Clone)]
struct Fit<'a> {
    lens: Lens,
    seen: Vec<Seen<'a>>,
    /// Deviation of a coordinate, px, from the median distance.
    deviation: f64,
}

impl Fit<'_> {
    /// Few numbers first, then all; points weighed anew as the fit gets better.
    fn refine(&mut self) {
        self.deviation = self.median_deviation();
        for (count, rounds) in [(5, 2), (NUMBERS, 5)] {
            for _ in 0..rounds {
                self.descend(count);
                self.deviation = self.median_deviation();
            }
        }
    }

    /// Levenberg-Marquardt with the weights' scale held; the first `count` numbers of the lens move.
    fn descend(&mut self, count: usize) {
        let mut damping = 1e-4;
        let mut now = self.cost();
        for _ in 0..40 {
            let Some(next) = self.equations().and_then(|equations| self.stepped(&equations, count, damping))
            else {
                damping *= 10.0;
                if damping > 1e8 {
                    return;
                }
                continue;
            };
            let then = next.cost();
            if then < now {
                let gain = now - then;
                (*self, now) = (next, then);
                damping = (damping * 0.1).max(1e-12);
                if gain <= 1e-10 * now {
                    return;
                }
            } else {
                damping *= 10.0;
                if damping > 1e8 {
                    return;
                }
            }
        }
    }

    /// How far the points of a view are off: seen - expected, px. Not finite behind the camera.
    fn misses<'s>(&'s self, seen: &'s Seen<'_>) -> impl Iterator<Item = DVec2> + 's {
        seen.view.points.iter().map(|point| {
            let expected = self.lens.project(seen.pose.apply(point.sheet_mm.extend(0.0)));
            expected.map_or(DVec2::splat(f64::INFINITY), |expected| point.px - expected)
        })
    }

    fn median_deviation(&self) -> f64 {
        let mut all: Vec<f64> =
            self.seen.iter().flat_map(|seen| self.misses(seen)).map(|miss| miss.length()).collect();
        all.sort_by(f64::total_cmp);
        // the median distance of a normal deviate in the plane is √(2 ln 2) deviations
        (all.get(all.len() / 2).copied().unwrap_or_default() / 1.177_410_022_515_475).max(LEAST_DEVIATION_PX)
    }

    /// A point's weight: 1 up to [`FULL`] deviations, then falling with the square.
    fn weight(&self, miss: DVec2) -> f64 {
        let far = miss.length_squared() / (FULL * FULL * self.deviation * self.deviation);
        if far <= 1.0 { 1.0 } else { 1.0 / far }
    }

    /// The robust cost whose weights those are: ρ = r² up to the bound, then its logarithm.
    fn cost(&self) -> f64 {
        let bound = FULL * FULL * self.deviation * self.deviation;
        let rho = |miss: DVec2| {
            let square = miss.length_squared();
            if square <= bound { square } else { bound * (1.0 + libm::log(square / bound)) }
        };
        self.seen.iter().flat_map(|seen| self.misses(seen)).map(rho).sum()
    }

    fn equations(&self) -> Option<Equations> {
        let mut sum = Equations { a: [[0.0; NUMBERS]; NUMBERS], b: [0.0; NUMBERS], own: Vec::new() };
        for seen in &self.seen {
            let (mut v, mut right, mut w) = ([[0.0; 6]; 6], [0.0; 6], [[0.0; NUMBERS]; 6]);
            let unit = seen.pose.translation.length();
            for point in &seen.view.points {
                let (miss, by_lens, by_pose) =
                    derivatives(&self.lens, &seen.pose, unit, point.sheet_mm, point.px)?;
                let weight = self.weight(miss);
                for axis in 0..2 {
                    let (l, p, m) = (&by_lens[axis], &by_pose[axis], miss[axis] * weight);
                    for i in 0..NUMBERS {
                        for j in 0..=i {
                            sum.a[i][j] += weight * l[i] * l[j];
                        }
                        sum.b[i] += l[i] * m;
                    }
                    for i in 0..6 {
                        for j in 0..=i {
                            v[i][j] += weight * p[i] * p[j];
                        }
                        for j in 0..NUMBERS {
                            w[i][j] += weight * p[i] * l[j];
                        }
                        right[i] += p[i] * m;
                    }
                }
            }
            sum.own.push((v, right, w));
        }
        Some(sum)
    }

    /// The state after a damped step; `None` where the equations do not decide one.
    fn stepped(&self, equations: &Equations, count: usize, damping: f64) -> Option<Self> {
        let damped = |v: &[[f64; 6]; 6]| {
            let mut v = *v;
            v.iter_mut().enumerate().for_each(|(i, row)| row[i] += damping * row[i] + 1e-300);
            v
        };
        let (mut a, mut b) = (equations.a, equations.b);
        a.iter_mut().enumerate().for_each(|(i, row)| row[i] += damping * row[i] + 1e-300);
        let mut inner = Vec::with_capacity(equations.own.len());
        for (v, right, w) in &equations.own {
            let v = damped(v);
            eliminate(&v, right, w, &mut a, &mut b)?;
            inner.push(v);
        }
        hold(&mut a, &mut b, count);
        let step = solve_spd(a, b)?;
        let mut next = self.clone();
        next.lens.focal += DVec2::new(step[0], step[1]);
        next.lens.center += DVec2::new(step[2], step[3]);
        for (k, step) in next.lens.distortion.iter_mut().zip(&step[4..]) {
            *k += step;
        }
        for ((seen, v), (_, right, w)) in next.seen.iter_mut().zip(&inner).zip(&equations.own) {
            let rest =
                std::array::from_fn(|i| right[i] - (0..NUMBERS).map(|j| w[i][j] * step[j]).sum::<f64>());
            let own = solve_spd(*v, rest)?;
            let unit = seen.pose.translation.length();
            seen.pose = moved(&seen.pose, unit, own);
        }
        (next.lens.focal.min_element() > 0.0).then_some(next)
    }

    /// The finished calibration, or why it is none.
    fn judged(self, size: Size) -> Result<Calibration, Undetermined> {
        let scale = size.width.max(size.height) as f64 / 640.0;
        let mut taken = [[false; PARTS[0]]; PARTS[1]];
        let mut views = Vec::new();
        let (mut squares, mut weights, mut count, mut outliers) = (0.0, 0.0, 0, 0);
        for seen in &self.seen {
            let mut square = 0.0;
            let mut misses = Vec::with_capacity(seen.view.points.len());
            for (point, miss) in seen.view.points.iter().zip(self.misses(seen)) {
                let weight = self.weight(miss);
                (squares, weights) = (squares + weight * miss.length_squared(), weights + weight);
                outliers += usize::from(weight < 1.0 / (2.0 * 2.0));
                square += miss.length_squared();
                misses.push((point.px, miss));
                let at = |v: f64, side: usize, parts: usize| {
                    ((v + 0.5) / side as f64 * parts as f64).clamp(0.0, parts as f64 - 1.0) as usize
                };
                taken[at(point.px.y, size.height, PARTS[1])][at(point.px.x, size.width, PARTS[0])] = true;
            }
            count += misses.len();
            let rms_px = (square / misses.len() as f64).sqrt();
            let tilt = libm::acos(seen.pose.rotation.z_axis.z.abs().clamp(0.0, 1.0)).to_degrees();
            views.push(Fitted { index: seen.index, pose: seen.pose, rms_px, tilt_deg: tilt, misses });
        }
        let rms_px = (squares / weights).sqrt();
        if rms_px.is_nan() || rms_px > WORST_RMS_PX * scale {
            return Err(Undetermined::Misfit(rms_px));
        }
        let tilt = views.iter().map(|view| view.tilt_deg).fold(0.0, f64::max);
        let variance = squares / (2.0 * count as f64 - (6 * views.len() + NUMBERS) as f64).max(1.0);
        let deviations = self.equations().and_then(|equations| deviations(&equations, variance));
        let doubt = |d: &[f64; NUMBERS]| {
            let focal = (d[0] / self.lens.focal.x).max(d[1] / self.lens.focal.y);
            (focal, d[2].max(d[3]) / size.width as f64)
        };
        let parts = taken.iter().flatten().filter(|taken| **taken).count();
        let all = PARTS[0] * PARTS[1];
        let unsure = deviations.as_ref().map(doubt).filter(|(f, c)| *f <= DOUBT && *c <= DOUBT).is_none();
        if tilt < LEAST_TILT_DEG {
            return Err(Undetermined::Flat(tilt));
        }
        if (parts as f64) < LEAST_PARTS * all as f64 {
            return Err(Undetermined::Uncovered(parts, all));
        }
        match deviations {
            Some(deviations) if !unsure => {
                Ok(Calibration { lens: self.lens, deviations, views, rms_px, outliers, parts })
            }
            Some(deviations) => {
                let (focal, center) = doubt(&deviations);
                let text = format!(
                    "the focal length is known to {:.1} %, the middle to {:.1} px",
                    100.0 * focal,
                    center * size.width as f64
                );
                Err(Undetermined::Alike(text))
            }
            None => Err(Undetermined::Alike("the equations decide no lens".into())),
        }
    }
}

#[cfg(test)]
mod tests;
