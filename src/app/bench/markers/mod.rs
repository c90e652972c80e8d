//! Synthetic frames of markers with exact truth: what the tracker's bench looks at.
//!
//! A `Setup` says what stands before the camera; `clean` renders it without noise (prints area-sampled through
//! the lens, then blur, then light), `expose` adds the sensor's noise, `shots` does both for a whole set.
//! Everything is drawn from one seed.

mod background;
mod blur;

pub use background::Background;
pub use blur::Blur;

use crate::geometry::{Lens, Pose};
use crate::marker::Family;
use crate::pixels::{Plane, Size, SplitMix64};
use crate::track::solve::corners_mm;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Printed side of every marker, mm.
pub const SIDE_MM: f64 = 100.0;

/// How hard a marker is to read: *easy* = shortest edge ≥ 25 px, tilt < 45°, ink step ≥ 10 σ of the noise,
/// motion < 1 px, blur σ < .8 px; *hard* = shortest edge < 14 px, or tilt > 65°, or ink step < 4 σ, or
/// motion > 6 px; *medium* = the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Difficulty {
    /// Every detector should read it.
    Easy,
    /// The rest.
    Medium,
    /// Few detectors read it.
    Hard,
}

impl Difficulty {
    /// All, the easiest first.
    pub const ALL: [Self; 3] = [Self::Easy, Self::Medium, Self::Hard];

    /// Its word in tables.
    pub const fn name(self) -> &'static str {
        ["easy", "medium", "hard"][self as usize]
    }
}

/// A marker as it truly stands.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Its number.
    pub id: u32,
    /// TL TR BR BL in the picture, px.
    pub corners: [DVec2; 4],
    /// Marker → camera, mm.
    pub pose: Pose,
    /// Shortest edge, px.
    pub edge_px: f64,
    /// Angle between the print's normal and the ray to its center, degrees.
    pub tilt_deg: f64,
    /// Gray step of the inks, as lit, over the noise's deviation.
    pub snr: f64,
    /// How hard it is.
    pub difficulty: Difficulty,
}

/// The light on the scene: brightness times a ramp, and the edge of a shadow.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    level: f64,
    ramp: DVec2,
    /// Unit normal, offset (px), softness (px), darkness.
    shadow: Option<(DVec2, f64, f64, f64)>,
}

/// A scene before the camera.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The camera's lens and picture size.
    pub lens: Lens,
    /// Family of all its markers.
    pub family: Family,
    /// Markers by number and pose.
    pub prints: Vec<(u32, Pose)>,
    /// Gray of black and white ink under full light.
    pub inks: [f64; 2],
    /// What is behind them.
    pub background: Background,
    /// The light.
    pub light: Light,
    /// The blur.
    pub blur: Blur,
    /// Deviation of the sensor's noise, gray levels.
    pub sigma: f64,
    /// Seed of the background.
    pub seed: u64,
}

/// A setup and pictures of it that differ in their noise alone.
#[derive(Clone, Debug)]
pub struct Shot {
    /// What stood before the camera.
    pub setup: Setup,
    /// The truth about its markers.
    pub truth: Vec<Truth>,
    /// The pictures.
    pub pictures: Vec<Plane<u8>>,
}

/// The shots with these numbers of the set that `setup` draws from a number and its random numbers, `draws`
/// pictures each; in parallel.
pub fn shots(
    numbers: Range<usize>,
    draws: usize,
    setup: impl Fn(&mut SplitMix64, usize) -> Setup + Sync,
) -> Vec<Shot> {
    let shoot = |number: usize| {
        let mut rng = SplitMix64::new(1000 + 7919 * number as u64);
        let setup = setup(&mut rng, number);
        let clean = setup.clean();
        let pictures = (0..draws).map(|_| expose(&clean, setup.lens.size, setup.sigma, &mut rng)).collect();
        Shot { truth: setup.truth(), setup, pictures }
    };
    numbers.into_par_iter().map(shoot).collect()
}

impl Light {
    /// An even, full light.
    pub const EVEN: Light = Light::even(1.0);

    /// An even light, `level` of the full one.
    pub const fn even(level: f64) -> Self {
        Light { level, ramp: DVec2::ZERO, shadow: None }
    }

    fn random(rng: &mut SplitMix64, size: Size) -> Self {
        let kind = rng.f64();
        let turn = rng.f64() * TAU;
        let along = DVec2::new(libm::cos(turn), libm::sin(turn));
        let mild = along * between(rng, 0.0, 0.12);
        if kind < 0.45 {
            Light { level: between(rng, 0.85, 1.0), ramp: mild, shadow: None }
        } else if kind < 0.65 {
            Light { level: 0.65, ramp: along * between(rng, 0.3, 0.5), shadow: None }
        } else if kind < 0.85 {
            let middle = DVec2::new(size.width as f64, size.height as f64)
                * DVec2::new(between(rng, 0.25, 0.75), between(rng, 0.25, 0.75));
            let turn = rng.f64() * TAU;
            let normal = DVec2::new(libm::cos(turn), libm::sin(turn));
            let shadow = (normal, normal.dot(middle), between(rng, 1.0, 12.0), between(rng, 0.35, 0.7));
            Light { level: 0.95, ramp: mild, shadow: Some(shadow) }
        } else {
            Light { level: between(rng, 0.12, 0.3), ramp: mild * 0.3, shadow: None }
        }
    }

    /// The factor on the ink at a pixel.
    fn at(&self, p: DVec2, size: Size) -> f64 {
        let half = DVec2::new(size.width as f64, size.height as f64) * 0.5;
        let factor = self.level * (1.0 + self.ramp.dot((p - half) / half.max_element()));
        let shade = self.shadow.map_or(1.0, |(normal, offset, soft, dark)| {
            let t = (0.5 + (normal.dot(p) - offset) / (2.0 * soft)).clamp(0.0, 1.0);
            1.0 - dark * t * t * (3.0 - 2.0 * t)
        });
        factor.max(0.05) * shade
    }
}

/// Uniform in [low, high).
fn between(rng: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.f64()
}

/// Logarithmically uniform in [low, high).
fn scaled(rng: &mut SplitMix64, low: f64, high: f64) -> f64 {
    libm::exp(between(rng, libm::log(low), libm::log(high)))
}

/// A deviate of the normal distribution (Box & Muller 1958).
pub fn normal(rng: &mut SplitMix64) -> f64 {
    (-2.0 * libm::log(1.0 - rng.f64())).sqrt() * libm::cos(TAU * rng.f64())
}

fn random_lens(rng: &mut SplitMix64, size: Size, distorted: bool) -> Lens {
    let mut lens = Lens::guess(size);
    lens.focal *= between(rng, 0.85, 1.3);
    lens.center += DVec2::new(between(rng, -8.0, 8.0), between(rng, -8.0, 8.0));
    if distorted {
        lens.distortion[0] = between(rng, -0.28, 0.08);
        lens.distortion[1] = between(rng, -0.02, 0.06);
        lens.distortion[2] = between(rng, -1e-3, 1e-3);
        lens.distortion[3] = between(rng, -1e-3, 1e-3);
    }
    lens
}

/// A print about `side_px` large at pixel `center`, spun by `spin` and tilted by `tilt` (radians) about an
/// axis of its plane's direction `about`, as seen from the camera.
pub fn pose_at(lens: &Lens, center: DVec2, side_px: f64, spin: f64, tilt: f64, about: f64) -> Option<Pose> {
    let ray = lens.undistort(center)?.extend(1.0);
    let forward = ray / ray.length();
    let right = DVec3::Y.cross(forward);
    let right = right / right.length();
    let down = forward.cross(right);
    // print facing the camera along its ray: x right, y up, z towards the viewer
    let facing = DMat3::from_cols(right, -down, -forward);
    let axis = DVec3::new(libm::cos(about), libm::sin(about), 0.0);
    let turn = DMat3::from_axis_angle(axis, tilt) * DMat3::from_axis_angle(DVec3::Z, spin);
    Some(Pose { rotation: facing * turn, translation: ray * (lens.focal.x * SIDE_MM / side_px) })
}

impl Setup {
    /// A calm scene of these prints: even light, a textured table, noise σ 2.
    pub fn calm(lens: &Lens, family: Family, prints: Vec<(u32, Pose)>, seed: u64) -> Self {
        Self {
            lens: *lens,
            family,
            prints,
            inks: [30.0, 210.0],
            background: Background::Texture,
            light: Light::EVEN,
            blur: Blur::Gaussian(0.5),
            sigma: 2.0,
            seed,
        }
    }

    /// Its picture, the noise drawn from its seed.
    pub fn shoot(&self) -> Plane<u8> {
        expose(&self.clean(), self.lens.size, self.sigma, &mut SplitMix64::new(self.seed))
    }

    /// Accuracy set: 1-6 markers, side log-uniform 15-250 px, tilt 0-75°; noise, blur, light, background and
    /// lens of every kind.
    pub fn accuracy(rng: &mut SplitMix64, size: Size, family: Family) -> Self {
        let sigma = match rng.f64() {
            k if k < 0.3 => between(rng, 0.0, 2.0),
            k if k < 0.7 => between(rng, 2.0, 8.0),
            _ => between(rng, 8.0, 20.0),
        };
        let blur = match rng.f64() {
            k if k < 0.4 => Blur::Sharp,
            k if k < 0.7 => Blur::Gaussian(between(rng, 0.6, 2.0)),
            _ => {
                let turn = rng.f64() * TAU;
                Blur::Motion(DVec2::new(libm::cos(turn), libm::sin(turn)) * between(rng, 2.0, 10.0))
            }
        };
        let background = match rng.f64() {
            k if k < 0.25 => Background::Plain,
            k if k < 0.55 => Background::Texture,
            _ => Background::Clutter,
        };
        let distorted = rng.f64() < 0.5;
        let mut setup = Self {
            lens: random_lens(rng, size, distorted),
            family,
            prints: Vec::new(),
            inks: [between(rng, 15.0, 45.0), between(rng, 190.0, 245.0)],
            background,
            light: Light::random(rng, size),
            blur,
            sigma,
            seed: rng.next_u64(),
        };
        let count = rng.int(1, 6) as usize;
        setup.place(rng, count, [15.0, 250.0], [0.0, 75.0]);
        setup
    }

    /// Speed set: 2-5 markers of 30-180 px, tilt below 60°; `kind` 0 calm (σ 2), 1 cluttered (σ 3), 2 noisy
    /// (σ 10).
    pub fn speed(rng: &mut SplitMix64, size: Size, family: Family, kind: usize) -> Self {
        let (sigma, background) =
            [(2.0, Background::Plain), (3.0, Background::Clutter), (10.0, Background::Texture)][kind % 3];
        let mut setup = Self {
            lens: random_lens(rng, size, false),
            family,
            prints: Vec::new(),
            inks: [30.0, 220.0],
            background,
            light: Light { level: 0.95, ramp: DVec2::new(0.1, 0.05), shadow: None },
            blur: Blur::Gaussian(0.6),
            sigma,
            seed: rng.next_u64(),
        };
        let count = rng.int(2, 5) as usize;
        setup.place(rng, count, [30.0, 180.0], [0.0, 60.0]);
        setup
    }

    /// Still set: one sharp marker, side 20-180 px (all as likely), tilt 2-65°; `kind` chooses σ 2, 5 or 10.
    pub fn still(rng: &mut SplitMix64, size: Size, family: Family, kind: usize) -> Self {
        let mut setup = Self {
            lens: random_lens(rng, size, false),
            family,
            prints: Vec::new(),
            inks: [30.0, 220.0],
            background: Background::Texture,
            light: Light { level: 0.95, ramp: DVec2::new(0.1, 0.05), shadow: None },
            blur: Blur::Sharp,
            sigma: [2.0, 5.0, 10.0][kind % 3],
            seed: rng.next_u64(),
        };
        let side_px = between(rng, 20.0, 180.0);
        setup.place(rng, 1, [side_px, side_px], [2.0, 65.0]);
        setup
    }

    /// A frame without a marker of `family`: clutter, or (every second one) markers of `other`.
    pub fn negative(rng: &mut SplitMix64, size: Size, other: Family, with_other: bool) -> Self {
        let mut setup = Self::accuracy(rng, size, other);
        if !with_other {
            setup.prints.clear();
            setup.background = Background::Clutter;
        }
        setup
    }

    fn place(&mut self, rng: &mut SplitMix64, count: usize, side: [f64; 2], tilt: [f64; 2]) {
        let Size { width, height } = self.lens.size;
        let cells = self.family.cells() as f64;
        let mut taken: Vec<(DVec2, f64)> = Vec::new();
        for _ in 0..count * 40 {
            if self.prints.len() == count {
                break;
            }
            let side_px = scaled(rng, side[0], side[1]);
            let center = DVec2::new(rng.f64() * width as f64, rng.f64() * height as f64);
            let tilt = between(rng, tilt[0], tilt[1]).to_radians();
            let (spin, about) = (rng.f64() * TAU, rng.f64() * TAU);
            let Some(pose) = pose_at(&self.lens, center, side_px, spin, tilt, about) else { continue };
            let Some(outer) = self.corners(&pose, 1.0 + 2.0 / cells) else { continue };
            let inside = |p: &DVec2| {
                p.x >= 2.0 && p.y >= 2.0 && p.x <= width as f64 - 3.0 && p.y <= height as f64 - 3.0
            };
            let reach = outer.iter().fold(0.0f64, |most, p| most.max((*p - center).length()));
            let free = taken.iter().all(|(at, r)| (*at - center).length() > r + reach);
            let id = rng.int(0, self.family.codes().len() as i64 - 1) as u32;
            if outer.iter().all(inside) && free && self.prints.iter().all(|(other, _)| *other != id) {
                taken.push((center, reach));
                self.prints.push((id, pose));
            }
        }
    }

    /// Corners of the print grown by `grow` in the picture.
    fn corners(&self, pose: &Pose, grow: f64) -> Option<[DVec2; 4]> {
        let mut out = [DVec2::ZERO; 4];
        for (px, mm) in out.iter_mut().zip(corners_mm(SIDE_MM * grow)) {
            *px = self.lens.project(pose.apply(mm))?;
        }
        Some(out)
    }

    /// The truth about every marker in view.
    pub fn truth(&self) -> Vec<Truth> {
        let motion = if let Blur::Motion(v) = self.blur { v.length() } else { 0.0 };
        let blur = if let Blur::Gaussian(s) = self.blur { s } else { 0.0 };
        let of = |&(id, pose): &(u32, Pose)| {
            let corners = self.corners(&pose, 1.0)?;
            let edge_px =
                (0..4).map(|i| (corners[(i + 1) % 4] - corners[i]).length()).fold(f64::MAX, f64::min);
            let ray = pose.translation / pose.translation.length();
            let tilt_deg = libm::acos((-pose.rotation.z_axis.dot(ray)).clamp(-1.0, 1.0)) * 180.0 / PI;
            let center = (corners[0] + corners[1] + corners[2] + corners[3]) * 0.25;
            let step = (self.inks[1] - self.inks[0]) * self.light.at(center, self.lens.size);
            let snr = step / self.sigma.max(1e-3);
            let difficulty = if edge_px < 14.0 || tilt_deg > 65.0 || snr < 4.0 || motion > 6.0 {
                Difficulty::Hard
            } else if edge_px >= 25.0 && tilt_deg < 45.0 && snr >= 10.0 && motion < 1.0 && blur < 0.8 {
                Difficulty::Easy
            } else {
                Difficulty::Medium
            };
            Some(Truth { id, corners, pose, edge_px, tilt_deg, snr, difficulty })
        };
        self.prints.iter().filter_map(of).collect()
    }

    /// The picture without noise, gray levels row by row.
    pub fn clean(&self) -> Vec<f32> {
        let size = self.lens.size;
        let mut frame = self.background.draw(size, self.seed);
        for (id, pose) in &self.prints {
            self.print(&mut frame, *id, pose);
        }
        self.blur.apply(&mut frame, size);
        for (i, v) in frame.iter_mut().enumerate() {
            let p = DVec2::new((i % size.width) as f64, (i / size.width) as f64);
            *v *= self.light.at(p, size) as f32;
        }
        frame
    }

    /// Area-sampled print: pixels that see one ink take it, the others average 64 points.
    fn print(&self, frame: &mut [f32], id: u32, pose: &Pose) {
        let Size { width, height } = self.lens.size;
        let Some(picture) = self.family.picture(id) else { return };
        let samples = picture.size().width as f64;
        let cells = self.family.cells() as f64;
        let r = pose.rotation;
        let plane = DMat3::from_cols(r.x_axis, r.y_axis, pose.translation).inverse();
        let Some(outer) = self.corners(pose, (samples + 1.0) / cells) else { return };
        let low = outer.iter().fold(DVec2::INFINITY, |a, b| a.min(*b)) - 2.0;
        let high = outer.iter().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b)) + 2.0;
        // a pixel's place on the print, in cells from its top-left corner
        let place = |seen: DVec2| {
            let q = plane * self.lens.undistort(seen)?.extend(1.0);
            (q.z > 0.0).then(|| DVec2::new(q.x / q.z, -q.y / q.z) * (cells / SIDE_MM) + 0.5 * samples)
        };
        let ink = |x: usize, y: usize| self.inks[usize::from(picture.at(x, y) > 0)];
        for y in low.y.max(0.0) as usize..(high.y.max(0.0) as usize + 1).min(height) {
            for x in low.x.max(0.0) as usize..(high.x.max(0.0) as usize + 1).min(width) {
                let at = DVec2::new(x as f64, y as f64);
                let pixel = &mut frame[y * width + x];
                let (mut least, mut most) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
                for (dx, dy) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
                    let p = place(at + DVec2::new(dx, dy)).unwrap_or(DVec2::NAN);
                    (least, most) = (least.min(p), most.max(p));
                }
                if most.min_element() <= 0.0 || least.max_element() >= samples {
                    continue;
                }
                // the pixel lies within the box of its corners: one ink there is its ink
                if least.min_element() >= 0.0 && most.max_element() < samples {
                    let first = ink(least.x as usize, least.y as usize);
                    let (mut columns, rows) =
                        (least.x as usize..=most.x as usize, least.y as usize..=most.y as usize);
                    if columns.all(|i| rows.clone().all(|j| ink(i, j) == first)) {
                        *pixel = first as f32;
                        continue;
                    }
                }
                let mut sum = 0.0;
                for k in 0..64u8 {
                    // Hammersley's points: every column and every row of 64 holds one, so that edges along the
                    // axes are as exact as others (an 8x8 grid misplaces them by up to 1/16 px)
                    let offset =
                        DVec2::new(f64::from(k), f64::from(k.reverse_bits() >> 2)) / 64.0 - 63.0 / 128.0;
                    let p =
                        place(at + offset).filter(|p| p.min_element() >= 0.0 && p.max_element() < samples);
                    sum += p.map_or(f64::from(*pixel), |p| ink(p.x as usize, p.y as usize));
                }
                *pixel = (sum / 64.0) as f32;
            }
        }
    }
}

/// The clean picture as the sensor saw it: normal noise, rounded.
pub fn expose(clean: &[f32], size: Size, sigma: f64, rng: &mut SplitMix64) -> Plane<u8> {
    Plane::from_fn(size, |x, y| {
        let v = f64::from(clean[y * size.width + x]) + sigma * normal(rng);
        (v + 0.5).clamp(0.0, 255.0) as u8
    })
}

#[cfg(test)]
mod tests;
