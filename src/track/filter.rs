//! A marker's pose over time: smooth at rest, without lag in motion.
//!
//! Two estimators look at every measured pose and its information. `Filter` moves with constant velocity (an
//! extended Kalman filter; Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, §6.2
//! and §11.4); the strength of its process noise follows the innovations: a surprise raises it at once, calm lowers
//! it frame by frame. `Rest` believes that nothing moves and averages; a drift shows in the sum of its
//! innovations long before it shows in one, and makes it start anew. What has rested long enough is reported from
//! there.
//!
//! Poses are in marker sides, not mm. Errors are a turn to the left of the rotation (radians about the camera's
//! axes) and a shift in sides, in this order.

use crate::geometry::Pose;
use glam::{DMat3, DVec3};

/// Six by six: turn and shift.
pub type Six = [[f64; 6]; 6];

/// Least and most deviation of the acceleration, rad/s² and sides/s².
const ACCELERATION: [f64; 2] = [0.02, 200.0];
/// Deviation of a velocity nothing is known about, rad/s and sides/s.
const SPEED: f64 = 5.0;
/// Squared length of six whitened innovations that chance exceeds once in 10⁵ frames.
const SURPRISE: f64 = 33.0;
/// The same that makes the process noise rise: once in 10².
const DOUBT: f64 = 17.0;
/// What is left of the process noise's variance after a frame without surprise.
const CALM: f64 = 0.7;
/// How long the sums of innovations remember: 1/(1 - x) frames.
const MEMORY: [f64; 2] = [0.7, 0.93];
/// Frames of rest that are averaged.
const LONGEST_REST: f64 = 120.0;
/// Frames of rest from which on, and until which more and more, the average is reported.
const TRUSTED_REST: [f64; 2] = [8.0, 20.0];

/// Both estimators.
#[derive(Clone, Debug)]
pub struct Filter {
    pose: Pose,
    turn: DVec3,
    shift: DVec3,
    /// Covariance of turn, shift and their velocities.
    covariance: [[f64; 12]; 12],
    /// Variance of the acceleration.
    power: f64,
    drift: Drift,
    rest: Rest,
}

/// Innovations in units of their deviation, summed with a short and a long memory.
#[derive(Clone, Copy, Debug, Default)]
struct Drift([[f64; 6]; 2]);

impl Drift {
    /// Squared length of the largest sum, in units of what is usual, once `white` is added.
    fn with(&self, white: &[f64; 6]) -> (Self, f64) {
        let (mut next, mut most) = (*self, white.iter().map(|v| v * v).sum::<f64>());
        for (sum, memory) in next.0.iter_mut().zip(MEMORY) {
            for (sum, white) in sum.iter_mut().zip(white) {
                *sum = *sum * memory + white;
            }
            most = most.max(sum.iter().map(|v| v * v).sum::<f64>() * (1.0 - memory * memory));
        }
        (next, most)
    }
}

/// The average of a marker that does not move.
#[derive(Clone, Debug)]
struct Rest {
    pose: Pose,
    information: Six,
    frames: f64,
    drift: Drift,
}

impl Filter {
    /// From the first measured pose and its information (inverse covariance, lower triangle).
    pub fn new(pose: Pose, information: &Six) -> Self {
        let mut covariance = [[0.0; 12]; 12];
        let spread = inverse(information).unwrap_or([[0.0; 6]; 6]);
        for i in 0..6 {
            covariance[i][..6].copy_from_slice(&spread[i]);
            covariance[i + 6][i + 6] = SPEED * SPEED;
        }
        let rest = Rest { pose, information: *information, frames: 1.0, drift: Drift::default() };
        let power = ACCELERATION[1] * ACCELERATION[1] * 0.01;
        Self { pose, turn: DVec3::ZERO, shift: DVec3::ZERO, covariance, power, drift: Drift::default(), rest }
    }

    /// The pose `dt` s after the last measurement, from the constant velocity alone.
    pub fn ahead(&self, dt: f64) -> Pose {
        moved(&self.pose, self.turn * dt, self.shift * dt)
    }

    /// The smoothed pose at the last measurement.
    pub fn pose(&self) -> Pose {
        let [from, to] = TRUSTED_REST;
        let share = ((self.rest.frames - from) / (to - from)).clamp(0.0, 1.0);
        let [turn, shift] = between(&self.pose, &self.rest.pose);
        moved(&self.pose, turn * share, shift * share)
    }

    /// Takes a pose measured `dt` s after the last one. `information`: its inverse covariance, lower triangle.
    pub fn update(&mut self, measured: &Pose, information: &Six, dt: f64) {
        self.rest.update(measured, information);
        let Some(spread) = inverse(information) else { return };
        self.predict(dt);
        let [turn, shift] = between(&self.pose, measured);
        let miss = [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z];
        let root = loop {
            let mut sum = spread;
            for (i, row) in sum.iter_mut().enumerate() {
                for (j, v) in row.iter_mut().enumerate() {
                    *v += self.covariance[i][j];
                }
            }
            let Some(root) = cholesky(&sum) else { return };
            let (drift, surprise) = self.drift.with(&forward(&root, &miss));
            let most = ACCELERATION[1] * ACCELERATION[1];
            if surprise <= DOUBT || self.power >= most {
                self.drift = drift;
                break root;
            }
            // it accelerates: believe so from the last frame on
            let next = (self.power * 10.0).min(most);
            self.accelerate(next - self.power, dt);
            self.power = next;
            self.drift = Drift::default();
        };
        self.correct(&root, &miss);
        self.power = (self.power * CALM).max(ACCELERATION[0] * ACCELERATION[0]);
    }

    fn predict(&mut self, dt: f64) {
        self.pose = self.ahead(dt);
        let c = &mut self.covariance;
        for i in 0..6 {
            for j in 0..6 {
                c[i][j] += dt * (c[i][j + 6] + c[i + 6][j]) + dt * dt * c[i + 6][j + 6];
            }
        }
        for i in 0..6 {
            for j in 0..6 {
                c[i][j + 6] += dt * c[i + 6][j + 6];
                c[j + 6][i] = c[i][j + 6];
            }
        }
        self.accelerate(self.power, dt);
    }

    /// Adds the noise of an acceleration of variance `power` that lasts `dt`.
    fn accelerate(&mut self, power: f64, dt: f64) {
        let c = &mut self.covariance;
        for i in 0..6 {
            c[i][i] += power * dt * dt * dt * dt * 0.25;
            c[i][i + 6] += power * dt * dt * dt * 0.5;
            c[i + 6][i] = c[i][i + 6];
            c[i + 6][i + 6] += power * dt * dt;
        }
    }

    /// Kalman's correction; `root`: Cholesky factor of the innovation's covariance.
    fn correct(&mut self, root: &Six, miss: &[f64; 6]) {
        // with whitened rows W = P Hᵀ L⁻ᵀ: gain · miss = W · L⁻¹ miss, P -= W Wᵀ
        let white = forward(root, miss);
        let mut rows = [[0.0; 6]; 12];
        for (row, line) in rows.iter_mut().zip(&self.covariance) {
            let mut seen = [0.0; 6];
            seen.copy_from_slice(&line[..6]);
            *row = forward(root, &seen);
        }
        let mut step = [0.0; 12];
        for i in 0..12 {
            step[i] = dot(&rows[i], &white);
            for j in 0..=i {
                let v = self.covariance[i][j] - dot(&rows[i], &rows[j]);
                self.covariance[i][j] = v;
                self.covariance[j][i] = v;
            }
        }
        let three = |i: usize| DVec3::new(step[i], step[i + 1], step[i + 2]);
        self.pose = moved(&self.pose, three(0), three(3));
        self.turn += three(6);
        self.shift += three(9);
    }
}

impl Rest {
    fn update(&mut self, measured: &Pose, information: &Six) {
        let [turn, shift] = between(&self.pose, measured);
        let miss = [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z];
        let Some(root) = cholesky(information) else { return };
        // L Lᵀ = information: Lᵀ·miss has unit variance, and the average's own error on top
        let over = 1.0 / (1.0 + 1.0 / self.frames).sqrt();
        let mut white = [0.0; 6];
        for (j, v) in white.iter_mut().enumerate() {
            *v = (j..6).map(|i| root[i][j] * miss[i]).sum::<f64>() * over;
        }
        let (drift, surprise) = self.drift.with(&white);
        let keep = 1.0 - 1.0 / LONGEST_REST;
        let mut sum = self.information;
        for i in 0..6 {
            for j in 0..=i {
                sum[i][j] = sum[i][j] * keep + information[i][j];
            }
        }
        let mut pull = [0.0; 6];
        for (i, v) in pull.iter_mut().enumerate() {
            *v = (0..6).map(|j| information[i.max(j)][i.min(j)] * miss[j]).sum();
        }
        let step = cholesky(&sum).map(|root| backward(&root, &forward(&root, &pull)));
        let Some(step) = step.filter(|_| surprise < SURPRISE) else {
            *self = Self { pose: *measured, information: *information, frames: 1.0, drift: Drift::default() };
            return;
        };
        let three = |i: usize| DVec3::new(step[i], step[i + 1], step[i + 2]);
        self.pose = moved(&self.pose, three(0), three(3));
        self.information = sum;
        self.frames = (self.frames * keep) + 1.0;
        self.drift = drift;
    }
}

fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    (0..6).map(|i| a[i] * b[i]).sum()
}

/// The pose turned (radians about the camera's axes) and shifted.
pub fn moved(pose: &Pose, turn: DVec3, shift: DVec3) -> Pose {
    let angle = turn.length();
    let rotation = if angle > 1e-12 {
        DMat3::from_axis_angle(turn / angle, angle) * pose.rotation
    } else {
        pose.rotation
    };
    Pose { rotation, translation: pose.translation + shift }
}

/// Turn and shift that take one pose to another.
pub fn between(from: &Pose, to: &Pose) -> [DVec3; 2] {
    let d = to.rotation * from.rotation.transpose();
    let skew = DVec3::new(d.y_axis.z - d.z_axis.y, d.z_axis.x - d.x_axis.z, d.x_axis.y - d.y_axis.x);
    let (sine, trace) = (skew.length(), d.x_axis.x + d.y_axis.y + d.z_axis.z);
    let turn = if sine > 1e-12 { skew / sine * libm::atan2(sine, trace - 1.0) } else { DVec3::ZERO };
    [turn, to.translation - from.translation]
}

/// Cholesky's factor of a positive definite matrix of which the lower triangle is read.
fn cholesky(a: &Six) -> Option<Six> {
    let mut l = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return None;
                }
                l[i][i] = sum.sqrt();
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    Some(l)
}

/// L⁻¹·b.
fn forward(l: &Six, b: &[f64; 6]) -> [f64; 6] {
    let mut x = *b;
    for i in 0..6 {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

/// L⁻ᵀ·b.
fn backward(l: &Six, b: &[f64; 6]) -> [f64; 6] {
    let mut x = *b;
    for i in (0..6).rev() {
        for k in i + 1..6 {
            x[i] -= l[k][i] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

/// The inverse of a positive definite matrix of which the lower triangle is read.
fn inverse(a: &Six) -> Option<Six> {
    let root = cholesky(a)?;
    let mut out = [[0.0; 6]; 6];
    for (i, row) in out.iter_mut().enumerate() {
        let mut unit = [0.0; 6];
        unit[i] = 1.0;
        *row = backward(&root, &forward(&root, &unit));
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    const DT: f64 = 1.0 / 30.0;
    const SIGMA: f64 = 1e-3;

    /// Every number of the pose measured to `SIGMA`.
    fn information() -> Six {
        let mut information = [[0.0; 6]; 6];
        for (i, row) in information.iter_mut().enumerate() {
            row[i] = 1.0 / (SIGMA * SIGMA);
        }
        information
    }

    fn at(x: f64) -> Pose {
        Pose { rotation: DMat3::IDENTITY, translation: DVec3::new(x, 0.0, 8.0) }
    }

    /// A pose measured with noise.
    fn noisy(pose: &Pose, rng: &mut SplitMix64) -> Pose {
        let mut bell = || SIGMA * ((0..12).map(|_| rng.f64()).sum::<f64>() - 6.0);
        let mut three = || DVec3::new(bell(), bell(), bell());
        let (turn, shift) = (three(), three());
        moved(pose, turn, shift)
    }

    /// Kalata's closed form (1984): with the tracking index Λ = σ_a·dt²/σ the corrected place has the variance
    /// α·σ², α = 1 - r², r = (4 + Λ - sqrt(8Λ + Λ²))/4.
    #[test]
    fn steady_state_is_kalatas() {
        let mut filter = Filter::new(at(0.0), &information());
        for _ in 0..3000 {
            filter.update(&at(0.0), &information(), DT);
        }
        let index = ACCELERATION[0] * DT * DT / SIGMA;
        let r = (4.0 + index - (8.0 * index + index * index).sqrt()) / 4.0;
        for i in 0..6 {
            // calm comes after the correction: the last prediction used the least noise
            let alpha = filter.covariance[i][i] / (SIGMA * SIGMA);
            assert!((alpha / (1.0 - r * r) - 1.0).abs() < 1e-6, "{i}: {alpha} against {}", 1.0 - r * r);
        }
    }

    /// The average at rest is the plain one, newer frames counting a little more.
    #[test]
    fn rest_is_the_weighted_mean() {
        let mut rng = SplitMix64::new(4);
        let poses: Vec<Pose> = (0..60).map(|_| at(SIGMA * (rng.f64() - 0.5))).collect();
        let mut filter = Filter::new(poses[0], &information());
        poses[1..].iter().for_each(|pose| filter.update(pose, &information(), DT));
        let keep: f64 = 1.0 - 1.0 / LONGEST_REST;
        let (mut sum, mut weight) = (0.0, 0.0);
        for pose in &poses {
            (sum, weight) = (sum * keep + pose.translation.x, weight * keep + 1.0);
        }
        assert!((filter.pose().translation.x - sum / weight).abs() < 1e-12);
        assert!((filter.rest.frames - weight).abs() < 1e-9);
    }

    /// What moves evenly is not late, what starts to is not for long, and what rests is ten times calmer than its
    /// measurements.
    #[test]
    fn motion_has_no_lag_and_rest_no_shimmer() {
        let mut rng = SplitMix64::new(9);
        let mut filter = Filter::new(noisy(&at(0.0), &mut rng), &information());
        let (mut square, mut count) = (0.0, 0.0);
        for frame in 1..300 {
            filter.update(&noisy(&at(0.0), &mut rng), &information(), DT);
            if frame > 150 {
                square += filter.pose().translation.x * filter.pose().translation.x;
                count += 1.0;
            }
        }
        let spread: f64 = square / count;
        assert!(spread.sqrt() < 0.15 * SIGMA, "{}", spread.sqrt() / SIGMA);
        // ten deviations a frame from now on
        let (step, mut late, mut count) = (10.0 * SIGMA, 0.0, 0.0);
        for frame in 1..100 {
            let truth = at(step * f64::from(frame));
            filter.update(&noisy(&truth, &mut rng), &information(), DT);
            let behind = (truth.translation.x - filter.pose().translation.x) / step;
            assert!(behind.abs() < 0.6, "frame {frame}: {behind} frames behind");
            if frame > 10 {
                (late, count) = (late + behind, count + 1.0);
            }
        }
        assert!((late / count).abs() < 0.05, "{} frames behind", late / count);
    }

    #[test]
    fn turns_and_shifts_are_undone() {
        let mut rng = SplitMix64::new(2);
        for _ in 0..100 {
            let mut three = || DVec3::new(rng.f64() - 0.5, rng.f64() - 0.5, rng.f64() - 0.5) * 3.0;
            let pose = moved(&at(0.0), three(), three());
            let (turn, shift) = (three(), three());
            let [back, way] = between(&pose, &moved(&pose, turn, shift));
            assert!((back - turn).length() < 1e-9 && (way - shift).length() < 1e-12);
        }
    }

    #[test]
    fn nonsense_changes_nothing_but_the_time() {
        let mut filter = Filter::new(at(0.0), &information());
        filter.update(&at(0.0), &[[f64::NAN; 6]; 6], DT);
        filter.update(&at(0.0), &[[0.0; 6]; 6], DT);
        assert_eq!(filter.pose(), at(0.0));
    }
}
