//! A camera that needs no camera: a table with a printed marker and a few plain objects, seen from a seeded,
//! hand-held-looking path, drawn by our own rasteriser with exact truth.
//!
//! Comes in: a `Config`; goes out: frames, and for each its pose. Each pixel is the mean of `samples`²
//! samples, so edges are as soft as a sensor's. Everything depends on the settings and the frame number
//! alone: frame n is the same bytes on every machine.

mod table;

use crate::frame::{Frame, Needs};
use crate::geometry::{Lens, Pose};
use crate::marker::Family;
use crate::pixels::simd::Level;
use crate::pixels::{Plane, Size, SplitMix64, hash_noise};
use crate::render::{Camera, Placed, Renderer};
use crate::scene::Scene;
use glam::{DAffine3, DMat3, DVec2, DVec3};
use rayon::prelude::*;
use serde::Deserialize;
use std::f64::consts::TAU;
use std::time::Duration;

/// The `[camera.synthetic]` table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Seed of path, texture and noise.
    pub seed: u64,
    /// Frames until the clip ends; 0 = endless.
    pub frames: u64,
    /// Family of the printed marker.
    pub family: Family,
    /// Its number.
    pub id: u32,
    /// Printed side of its black border, mm.
    pub side_mm: f64,
    /// Samples a pixel along x and y, 1..4.
    pub samples: usize,
    /// Sensor noise, standard deviation in 8-bit levels, 0..64.
    pub noise: f64,
    /// Blur of the lens, standard deviation in px, 0..8.
    pub blur: f64,
    /// Lens distortion k1 (barrel below 0).
    pub k1: f64,
    /// How fast the camera moves; 1 = a calm hand, 0 = a tripod.
    pub pace: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 2005,
            frames: 0,
            family: Family::Tag36h11,
            id: 7,
            side_mm: 80.0,
            samples: 2,
            noise: 1.5,
            blur: 0.0,
            k1: 0.0,
            pace: 1.0,
        }
    }
}

/// The synthetic camera.
pub struct Synthetic {
    config: Config,
    lens: Lens,
    fps: f64,
    sequence: u64,
    path: Path,
    scene: Scene,
    renderer: Renderer,
    placed: Vec<Placed>,
    blur: Blur,
}

impl Synthetic {
    /// A synthetic camera of this picture size and frame rate (per second). Out-of-range settings are
    /// clamped to their documented ranges.
    pub fn new(config: &Config, size: Size, fps: f64, level: Level) -> Self {
        let mut config = config.clone();
        config.samples = config.samples.clamp(1, 4);
        config.noise = if config.noise.is_finite() { config.noise.clamp(0.0, 64.0) } else { 0.0 };
        config.blur = if config.blur.is_finite() { config.blur.clamp(0.0, 8.0) } else { 0.0 };
        config.pace = if config.pace.is_finite() { config.pace } else { 1.0 };
        let focal = 1.05 * size.width.max(size.height) as f64;
        let lens = Lens {
            focal: DVec2::splat(focal),
            distortion: [config.k1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            ..Lens::guess(size)
        };
        let scene = table::lay(&config);
        Self {
            path: Path::new(config.seed, config.pace),
            blur: Blur::new(config.blur),
            renderer: Renderer::new(level),
            placed: Vec::with_capacity(scene.models.len()),
            scene,
            lens,
            fps: if fps.is_finite() && fps > 0.0 { fps } else { 30.0 },
            sequence: 0,
            config,
        }
    }

    /// The lens the pictures are taken with: exact.
    pub fn lens(&self) -> Lens {
        self.lens
    }

    /// Frames until the end; `None` when endless.
    pub fn frames(&self) -> Option<u64> {
        (self.config.frames > 0).then_some(self.config.frames)
    }

    /// The exact pose of the printed marker in frame `sequence`.
    pub fn truth(&self, sequence: u64) -> Pose {
        self.path.pose(sequence as f64 / self.fps)
    }

    /// Whether the whole marker is inside frame `sequence`.
    pub fn shows_marker(&self, sequence: u64) -> bool {
        let (pose, half) = (self.truth(sequence), self.config.side_mm / 2.0);
        let size = self.lens.size;
        [(-half, half), (half, half), (half, -half), (-half, -half)].iter().all(|&(x, y)| {
            self.lens.project(pose.apply(DVec3::new(x, y, 0.0))).is_some_and(|p| {
                p.x > 1.0 && p.y > 1.0 && p.x < size.width as f64 - 2.0 && p.y < size.height as f64 - 2.0
            })
        })
    }

    /// The next frame drawn will be number `sequence`.
    pub fn skip_to(&mut self, sequence: u64) {
        self.sequence = sequence;
    }

    /// Draws the next frame; `false` after the last. Allocates nothing once the first frame is drawn.
    pub fn next(&mut self, frame: &mut Frame) -> bool {
        if self.frames().is_some_and(|end| self.sequence >= end) {
            return false;
        }
        self.draw(self.sequence, frame);
        self.sequence += 1;
        true
    }

    fn draw(&mut self, sequence: u64, frame: &mut Frame) {
        let (pose, n) = (self.truth(sequence), self.config.samples);
        let fine = Size::new(self.lens.size.width * n, self.lens.size.height * n);
        let lens = Lens {
            size: fine,
            focal: self.lens.focal * n as f64,
            // pixel centers at integers: the picture's edge stays at -.5
            center: (self.lens.center + 0.5) * n as f64 - 0.5,
            ..self.lens
        };
        let to_camera = DAffine3 { matrix3: pose.rotation, translation: pose.translation };
        self.placed.clear();
        for (model, m) in self.scene.models.iter().enumerate() {
            self.placed.push(Placed { model, to_camera: to_camera * m.to_marker });
        }
        // the lamp hangs in the room, not on the visor
        self.scene.light.direction = (pose.rotation * table::LAMP.normalize()).as_vec3();
        let camera = Camera { lens, near: 5.0, far: 20_000.0 };
        let layer = self.renderer.draw(&self.scene, &self.placed, &camera, Needs::COLOR);

        frame.resize(self.lens.size);
        for (channel, (to, from)) in frame.color.planes.iter_mut().zip(&layer.color.planes).enumerate() {
            average(from, n, to);
            self.blur.apply(to);
            add_noise(to, self.config.noise, self.config.seed + channel as u64, sequence);
        }
        let [r, g, b] = &frame.color.planes;
        frame.luma.view_mut().par_bands(64).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                let rgb = r.row(first + y).iter().zip(g.row(first + y)).zip(b.row(first + y));
                for (luma, ((&r, &g), &b)) in band.row_mut(y).iter_mut().zip(rgb) {
                    let sum = 9798 * u32::from(r) + 19235 * u32::from(g) + 3735 * u32::from(b);
                    *luma = ((sum + 16384) >> 15) as u8;
                }
            }
        });
        frame.sequence = sequence;
        frame.captured_at = Duration::from_secs_f64(sequence as f64 / self.fps);
    }
}

/// Mean of n x n blocks, rounded.
fn average(from: &Plane<u8>, n: usize, to: &mut Plane<u8>) {
    let count = (n * n) as u32;
    to.view_mut().par_bands(32).for_each(|(first, mut band)| {
        for y in 0..band.size().height {
            for (x, value) in band.row_mut(y).iter_mut().enumerate() {
                let block = (0..n).flat_map(|v| &from.row((first + y) * n + v)[x * n..][..n]);
                *value = ((block.map(|&s| u32::from(s)).sum::<u32>() + count / 2) / count) as u8;
            }
        }
    });
}

/// Adds near-normal noise: the sum of four uniform 16-bit numbers has variance 4·65536²/12.
fn add_noise(plane: &mut Plane<u8>, sigma: f64, seed: u64, sequence: u64) {
    if sigma == 0.0 {
        return;
    }
    let scale = (sigma / (65536.0 * 0.577_350_269_189_625_8)) as f32;
    plane.view_mut().par_bands(32).for_each(|(first, mut band)| {
        for y in 0..band.size().height {
            for (x, value) in band.row_mut(y).iter_mut().enumerate() {
                let bits = hash_noise(x as u32, (first + y) as u32, seed, sequence);
                let sum: u32 = (0..4).map(|i| (bits >> (16 * i) & 0xffff) as u32).sum();
                let noisy = f32::from(*value) + (sum as f32 - 131_070.0) * scale;
                *value = (noisy + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    });
}

/// A separable Gaussian, radius 3σ, for the softness of a cheap lens.
struct Blur {
    weights: Vec<f32>,
    rows: Plane<f32>,
}

impl Blur {
    fn new(sigma: f64) -> Self {
        let radius = libm::ceil(3.0 * sigma) as i32;
        let raw: Vec<f64> = (-radius..=radius)
            .map(|i| if sigma > 0.0 { libm::exp(-0.5 * f64::from(i * i) / (sigma * sigma)) } else { 1.0 })
            .collect();
        let sum: f64 = raw.iter().sum();
        Self { weights: raw.iter().map(|w| (w / sum) as f32).collect(), rows: Plane::default() }
    }

    fn apply(&mut self, plane: &mut Plane<u8>) {
        if self.weights.len() < 2 {
            return;
        }
        let (radius, size) = (self.weights.len() / 2, plane.size());
        self.rows.resize(size, 0.0);
        let clamp = |i: usize, n: usize| i.saturating_sub(radius).min(n - 1);
        let weights = &self.weights;
        let source = &*plane;
        self.rows.view_mut().par_bands(32).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                let row = source.row(first + y);
                for (x, value) in band.row_mut(y).iter_mut().enumerate() {
                    let taps = weights.iter().enumerate();
                    *value = taps.map(|(k, w)| w * f32::from(row[clamp(x + k, size.width)])).sum();
                }
            }
        });
        let rows = &self.rows;
        plane.view_mut().par_bands(32).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                for (x, value) in band.row_mut(y).iter_mut().enumerate() {
                    let taps = weights.iter().enumerate();
                    let sum: f32 = taps.map(|(k, w)| w * rows.at(x, clamp(first + y + k, size.height))).sum();
                    *value = (sum + 0.5) as u8;
                }
            }
        });
    }
}

/// Where the visitor's hand holds the visor: slow swings around the marker with a little tremor.
struct Path {
    /// Phase (radians) of each swing.
    phases: [f64; 8],
    pace: f64,
}

impl Path {
    fn new(seed: u64, pace: f64) -> Self {
        let mut rng = SplitMix64::new(seed);
        Self { phases: std::array::from_fn(|_| rng.f64() * TAU), pace }
    }

    /// Marker → camera at `seconds`.
    fn pose(&self, seconds: f64) -> Pose {
        let swing = |i: usize, hertz: f64| libm::sin(TAU * hertz * seconds * self.pace + self.phases[i]);
        let azimuth = 0.55 * swing(0, 0.11) + 0.02 * swing(1, 1.3);
        let elevation = 0.80 + 0.17 * swing(2, 0.07) + 0.012 * swing(3, 1.7);
        let distance = 400.0 + 70.0 * swing(4, 0.09);
        let target = DVec3::new(16.0 * swing(5, 0.13), 14.0 * swing(6, 0.17), 25.0);
        let (sin_a, cos_a) = libm::sincos(azimuth);
        let (sin_e, cos_e) = libm::sincos(elevation);
        let eye = target + distance * DVec3::new(sin_a * cos_e, -cos_a * cos_e, sin_e);
        let roll = 0.06 * swing(7, 0.23);
        look(eye, target, roll)
    }
}

/// The pose of a camera at `eye` that looks at `target` with the marker's z up, rolled about its axis.
fn look(eye: DVec3, target: DVec3, roll: f64) -> Pose {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let down = forward.cross(right);
    let level = DMat3::from_cols(right, down, forward).transpose();
    let (sin, cos) = libm::sincos(roll);
    let turn = DMat3::from_cols(DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0), DVec3::Z);
    let rotation = turn * level;
    Pose { rotation, translation: -(rotation * eye) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::simd;

    fn camera(config: Config) -> Synthetic {
        Synthetic::new(&config, Size::new(160, 120), 30.0, simd::best())
    }

    #[test]
    fn truth_is_a_rotation_and_the_marker_stays_in_view() {
        let camera = camera(Config::default());
        for sequence in (0..3000).step_by(7) {
            let pose = camera.truth(sequence);
            let unit = pose.rotation * pose.rotation.transpose();
            assert!((unit - DMat3::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-12));
            assert!((pose.rotation.determinant() - 1.0).abs() < 1e-12);
            assert!(camera.shows_marker(sequence), "frame {sequence}");
            let toward = pose.rotation * DVec3::Z;
            assert!(toward.dot(pose.translation) < 0.0, "the print faces the camera");
        }
    }

    #[test]
    fn the_printed_marker_is_where_truth_says() {
        let config = Config { noise: 0.0, pace: 0.0, ..Config::default() };
        let mut camera = camera(config);
        let mut frame = Frame::default();
        assert!(camera.next(&mut frame));
        let pose = camera.truth(0);
        let value = |x: f64, y: f64| {
            let px = camera.lens().project(pose.apply(DVec3::new(x, y, 0.0))).expect("in front").round();
            frame.luma.at(px.x as usize, px.y as usize)
        };
        for (x, y) in [(-36.0, 36.0), (36.0, 36.0), (36.0, -36.0), (-36.0, -36.0)] {
            assert!(value(x, y) < 70, "border at {x},{y} is {}", value(x, y));
            assert!(value(x * 1.25, y * 1.25) > 110, "paper at {x},{y} is {}", value(x * 1.25, y * 1.25));
        }
    }

    #[test]
    fn a_frame_depends_on_its_number_alone() {
        let (mut a, mut b) = (camera(Config::default()), camera(Config::default()));
        let (mut fa, mut fb) = (Frame::default(), Frame::default());
        for _ in 0..3 {
            assert!(a.next(&mut fa));
        }
        b.skip_to(2);
        assert!(b.next(&mut fb));
        assert_eq!((fa.luma, fa.color), (fb.luma, fb.color));
    }

    #[test]
    fn it_ends_when_told() {
        let mut camera = camera(Config { frames: 2, ..Config::default() });
        let mut frame = Frame::default();
        assert!(camera.next(&mut frame) && camera.next(&mut frame) && !camera.next(&mut frame));
    }
}
