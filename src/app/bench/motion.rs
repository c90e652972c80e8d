//! Films of moving markers with exact truth.
//!
//! A `Film` moves prints before a resting camera by sums of sinusoids, as a hand does. Every picture is sampled
//! over the pixels' extent and the time the shutter is open, so that motion blur is exact; truth holds for the
//! middle of the exposure.

use super::markers::{Background, Blur, Light, SIDE_MM, Setup, normal, pose_at};
use crate::geometry::{Lens, Pose};
use crate::marker::Family;
use crate::pixels::{Plane, Size, SplitMix64};
use crate::track::solve::corners_mm;
use glam::{DMat3, DVec2};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Pictures a second.
pub const RATE: f64 = 30.0;
/// Share of a frame that the shutter is open.
const SHUTTER: f64 = 0.5;
/// Points of a pixel and moments of the exposure that are averaged.
const POINTS: usize = 64;

/// base + drift·t + Σ amplitude·sin(2π·rate·t + phase); t in s.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wave {
    /// At rest.
    pub base: f64,
    /// A second.
    pub drift: f64,
    /// Amplitude, Hz, phase.
    pub terms: [[f64; 3]; 3],
}

impl Wave {
    /// One that rests.
    pub fn rest(base: f64) -> Self {
        Self { base, ..Self::default() }
    }

    /// About `base`, never faster than `speed` a second: equal shares of .3-1, 1-2 and 2-3 Hz.
    pub fn hand(rng: &mut SplitMix64, base: f64, speed: f64) -> Self {
        let mut terms = [[0.0; 3]; 3];
        for (term, [low, high]) in terms.iter_mut().zip([[0.3, 1.0], [1.0, 2.0], [2.0, 3.0]]) {
            let rate = low + (high - low) * rng.f64();
            *term = [speed / 3.0 / (TAU * rate), rate, TAU * rng.f64()];
        }
        Self { base, drift: 0.0, terms }
    }

    fn at(&self, t: f64) -> f64 {
        let swing = |[a, rate, phase]: &[f64; 3]| a * libm::sin(TAU * rate * t + phase);
        self.base + self.drift * t + self.terms.iter().map(swing).sum::<f64>()
    }
}

/// A print that moves.
#[derive(Clone, Copy, Debug)]
pub struct Mover {
    /// Its number.
    pub id: u32,
    /// Its center, px.
    pub center: [Wave; 2],
    /// Its size when it faces the camera, px.
    pub side_px: Wave,
    /// Spin, and tilts about the print's axes, degrees.
    pub turn_deg: [Wave; 3],
    /// First frame and the one after the last in which it is there.
    pub there: [usize; 2],
    /// Frames from..to in which a gray bar covers it.
    pub covered: Option<[usize; 2]>,
}

/// A film.
#[derive(Clone, Debug)]
pub struct Film {
    /// Lens and size.
    pub lens: Lens,
    /// Family of every print.
    pub family: Family,
    /// What moves.
    pub movers: Vec<Mover>,
    /// How many pictures.
    pub frames: usize,
    /// What is behind.
    pub background: Background,
    /// Deviation of the noise, gray levels.
    pub sigma: f64,
    /// Seed of background and noise.
    pub seed: u64,
}

/// A print as it truly stands in a picture.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Its number.
    pub id: u32,
    /// TL TR BR BL, px.
    pub corners: [DVec2; 4],
    /// Marker → camera, mm.
    pub pose: Pose,
    /// Whether all of it is in the picture and uncovered.
    pub readable: bool,
}

const INKS: [f64; 2] = [35.0, 215.0];
const BAR: f64 = 128.0;

impl Film {
    /// An even or textured wall, no prints yet.
    pub fn new(size: Size, frames: usize, sigma: f64, seed: u64) -> Self {
        Self {
            lens: Lens::guess(size),
            family: Family::Tag36h11,
            movers: Vec::new(),
            frames,
            background: Background::Texture,
            sigma,
            seed,
        }
    }

    /// One print at rest, `side_px` large, tilted about an oblique axis.
    pub fn still(size: Size, frames: usize, sigma: f64, side_px: f64, tilt_deg: f64, seed: u64) -> Self {
        let mut film = Self::new(size, frames, sigma, seed);
        let (w, h) = (size.width as f64, size.height as f64);
        film.movers.push(Mover {
            id: 7,
            center: [Wave::rest(0.45 * w + 0.3), Wave::rest(0.53 * h + 0.1)],
            side_px: Wave::rest(side_px),
            turn_deg: [20.0, 0.8 * tilt_deg, 0.6 * tilt_deg].map(Wave::rest),
            there: [0, frames],
            covered: None,
        });
        film
    }

    /// One print that turns by 10° a second about an axis of its plane, and drifts.
    pub fn turning(size: Size, frames: usize, sigma: f64, side_px: f64, seed: u64) -> Self {
        let mut film = Self::still(size, frames, sigma, side_px, 0.0, seed);
        let middle = frames as f64 / RATE * 0.5;
        let mover = &mut film.movers[0];
        mover.turn_deg[1] = Wave { base: -10.0 * middle, drift: 10.0, ..Wave::default() };
        mover.center[0].drift = 20.0;
        film
    }

    /// `count` prints held by hands: up to `speed` px a second, turning up to 20° either way, and covered now and
    /// then; all but the first come and go.
    pub fn hands(size: Size, frames: usize, sigma: f64, speed: f64, count: usize, seed: u64) -> Self {
        let mut film = Self::new(size, frames, sigma, seed);
        let mut rng = SplitMix64::new(seed ^ 0x5eed);
        let (w, h) = (size.width as f64, size.height as f64);
        let columns = if count > 1 { 2 } else { 1 };
        let rows = count.div_ceil(columns);
        for k in 0..count {
            let cell = DVec2::new(w / columns as f64, h / rows as f64);
            let base = cell * DVec2::new((k % columns) as f64 + 0.5, (k / columns) as f64 + 0.5);
            // what is crowded moves less: prints may not cover each other
            let speed = speed / columns as f64;
            let side = cell.min_element() * (0.17 + 0.12 * rng.f64());
            let mut wave = |base: f64, speed: f64| Wave::hand(&mut rng, base, speed);
            let center = [wave(base.x, 0.7 * speed), wave(base.y, 0.7 * speed)];
            let side_px = wave(side, 0.12 * speed);
            let turn_deg = [wave(0.0, 60.0), wave(20.0, 50.0), wave(-15.0, 50.0)];
            let from = if k == 0 { 0 } else { rng.int(0, frames as i64 / 3) as usize };
            let to = if k == 0 { frames } else { frames - rng.int(0, frames as i64 / 3) as usize };
            let covered = rng.int(30, (frames as i64 - 20).max(31)) as usize;
            let covered = Some([covered, covered + rng.int(3, 8) as usize]);
            film.movers.push(Mover {
                id: 7 + 11 * k as u32,
                center,
                side_px,
                turn_deg,
                there: [from, to],
                covered,
            });
        }
        film
    }

    /// Where a print is at a time; `None` where the lens cannot see it.
    fn pose(&self, mover: &Mover, t: f64) -> Option<Pose> {
        let center = DVec2::new(mover.center[0].at(t), mover.center[1].at(t));
        let [spin, x, y] = mover.turn_deg.map(|wave| wave.at(t).to_radians());
        let tilt = (x * x + y * y).sqrt();
        pose_at(&self.lens, center, mover.side_px.at(t).max(8.0), spin, tilt, libm::atan2(y, x))
    }

    fn corners(&self, pose: &Pose, grow: f64) -> Option<[DVec2; 4]> {
        let mut out = [DVec2::ZERO; 4];
        for (px, mm) in out.iter_mut().zip(corners_mm(SIDE_MM * grow)) {
            *px = self.lens.project(pose.apply(mm))?;
        }
        Some(out)
    }

    /// What stands truly in picture `frame`.
    pub fn truth(&self, frame: usize) -> Vec<Seen> {
        let size = DVec2::new(self.lens.size.width as f64, self.lens.size.height as f64);
        let grow = 1.0 + 2.0 / self.family.cells() as f64;
        let seen = |mover: &Mover| {
            if !(mover.there[0]..mover.there[1]).contains(&frame) {
                return None;
            }
            let pose = self.pose(mover, frame as f64 / RATE)?;
            let corners = self.corners(&pose, 1.0)?;
            let inside = |p: &DVec2| p.min_element() >= 1.0 && p.x < size.x - 2.0 && p.y < size.y - 2.0;
            let covered = mover.covered.is_some_and(|[from, to]| (from..to).contains(&frame));
            let readable = !covered && self.corners(&pose, grow)?.iter().all(inside);
            Some(Seen { id: mover.id, corners, pose, readable })
        };
        self.movers.iter().filter_map(seen).collect()
    }

    /// The pictures.
    pub fn shoot(&self) -> Vec<Plane<u8>> {
        let wall = Setup {
            lens: self.lens,
            family: self.family,
            prints: Vec::new(),
            inks: INKS,
            background: self.background,
            light: Light::EVEN,
            blur: Blur::Sharp,
            sigma: 0.0,
            seed: self.seed,
        };
        let wall = wall.clean();
        // rays through the pixels' corners, and noise to draw from
        let Size { width, height } = self.lens.size;
        let ray = |i: usize| {
            let corner = DVec2::new((i % (width + 1)) as f64 - 0.5, (i / (width + 1)) as f64 - 0.5);
            self.lens.undistort(corner).unwrap_or(DVec2::NAN)
        };
        let rays: Vec<DVec2> = (0..(width + 1) * (height + 1)).map(ray).collect();
        let mut rng = SplitMix64::new(self.seed);
        let grain: Vec<f32> = (0..1 << 16).map(|_| (self.sigma * normal(&mut rng)) as f32).collect();
        (0..self.frames).into_par_iter().map(|frame| self.picture(frame, &wall, &rays, &grain)).collect()
    }

    fn picture(&self, frame: usize, wall: &[f32], rays: &[DVec2], grain: &[f32]) -> Plane<u8> {
        let size = self.lens.size;
        let mut gray = wall.to_vec();
        for mover in &self.movers {
            if (mover.there[0]..mover.there[1]).contains(&frame) {
                self.print(&mut gray, mover, frame, rays);
            }
        }
        let mut rng = SplitMix64::new(self.seed ^ (frame as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let mut at = 0usize;
        Plane::from_fn(size, |x, y| {
            if x % 64 == 0 {
                at = rng.next_u64() as usize;
            }
            at += 1;
            let v = gray[y * size.width + x] + grain[at % grain.len()];
            (v + 0.5).clamp(0.0, 255.0) as u8
        })
    }

    /// Lays one print, and the bar over it, on the picture.
    fn print(&self, gray: &mut [f32], mover: &Mover, frame: usize, rays: &[DVec2]) {
        let Size { width, height } = self.lens.size;
        let Some(picture) = self.family.picture(mover.id) else { return };
        let samples = picture.size().width as f64;
        let cells = self.family.cells() as f64;
        // moments in an order that is even over every run of them
        let moment = |k: usize| ((k * 37 % POINTS) as f64 + 0.5) / POINTS as f64 - 0.5;
        let mut planes = Vec::with_capacity(POINTS);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for k in 0..POINTS {
            let Some(pose) = self.pose(mover, (frame as f64 + SHUTTER * moment(k)) / RATE) else { return };
            let r = pose.rotation;
            planes.push(DMat3::from_cols(r.x_axis, r.y_axis, pose.translation).inverse());
            let Some(outer) = self.corners(&pose, (samples + 1.0) / cells) else { return };
            for p in outer {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        for y in (low.y - 2.0).max(0.0) as usize..((high.y + 2.0).max(0.0) as usize + 1).min(height) {
            for x in (low.x - 2.0).max(0.0) as usize..((high.x + 2.0).max(0.0) as usize + 1).min(width) {
                let pixel = &mut gray[y * width + x];
                let corner = |dx: usize, dy: usize| rays[(y + dy) * (width + 1) + x + dx];
                let (a, b, c) = (corner(0, 0), corner(1, 0), corner(0, 1));
                let (mut sum, mut first, mut same) = (0.0, f64::NAN, true);
                let mut count = 0;
                for (k, plane) in planes.iter().enumerate() {
                    // a quarter of the points tells whether there is an edge at all
                    if k == POINTS / 4 && same {
                        break;
                    }
                    let (s, t) = (((k * 5 % 8) as f64 + 0.5) / 8.0, ((k * 27 / 8 % 8) as f64 + 0.5) / 8.0);
                    let q = *plane * (a + (b - a) * s + (c - a) * t).extend(1.0);
                    let p = DVec2::new(q.x / q.z, -q.y / q.z) * (cells / SIDE_MM) + 0.5 * samples;
                    let inside = q.z > 0.0 && p.min_element() >= 0.0 && p.max_element() < samples;
                    let ink = match inside {
                        true => INKS[usize::from(picture.at(p.x as usize, p.y as usize) > 0)],
                        false => f64::from(*pixel),
                    };
                    if k == 0 {
                        first = ink;
                    }
                    same &= ink == first;
                    sum += ink;
                    count += 1;
                }
                *pixel = (sum / f64::from(count)) as f32;
            }
        }
        if mover.covered.is_some_and(|[from, to]| (from..to).contains(&frame)) {
            let middle = (low + high) * 0.5;
            let half = (high - low) * DVec2::new(0.25, 0.7);
            let (low, high) = (middle - half, middle + half);
            for y in low.y.max(0.0) as usize..(high.y.max(0.0) as usize).min(height) {
                for x in low.x.max(0.0) as usize..(high.x.max(0.0) as usize).min(width) {
                    gray[y * width + x] = BAR as f32;
                }
            }
        }
    }
}

/// A few films at 640x480 of each kind, with its name. Still: a print of 80 px at rest, frontal and tilted, noise σ 5.
/// Turning: by 10° a second. Hand: one print, up to 400 px a second, covered now and then, noise σ 2 and 8. Hands:
/// four that move, come and go.
pub fn kinds() -> [(&'static str, Vec<Film>); 4] {
    let size = Size::new(640, 480);
    let hands = |count, seeds: [u64; 2]| {
        let film = |(sigma, seed)| Film::hands(size, 150, sigma, 400.0, count, seed);
        [2.0, 8.0].into_iter().zip(seeds).map(film).collect()
    };
    [
        ("still", [5.0, 35.0].map(|tilt| Film::still(size, 150, 5.0, 80.0, tilt, 1)).into()),
        ("turning", vec![Film::turning(size, 150, 5.0, 80.0, 2)]),
        ("hand", hands(1, [10, 12])),
        ("hands", hands(4, [30, 32])),
    ]
}
