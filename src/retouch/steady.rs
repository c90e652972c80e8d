//! Calming the sensor's noise: a temporal mean that forgets where something moves.
//!
//! 1. `noise`: the noise of the camera is measured from what differs between neighbors and between frames.
//! 2. A pixel's difference is that of its most different channel from the mean so far. Where any difference within
//!    two pixels exceeds the gate (a multiple of the noise), the pixel begins anew with the camera's.
//! 3. Elsewhere mean += w (pixel - mean); w falls as w - w² from a half, nearly 1/n, to 1/frames.
//!
//! Means are kept in 1/128 levels, weights in 1/256. Thresholds downstream then see steady values, and edges that move
//! drag nothing behind them, since the gate opens around them two pixels wide.

mod noise;
mod reference;

pub use reference::Reference;

use super::{RangeError, check};
use crate::kernel::band_rows;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rgb};
use fearless_simd::Simd;
use noise::Noise;
use rayon::prelude::*;
use serde::Deserialize;

/// The `[retouch.steady]` table.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Difference, times the noise, from which a pixel and its neighbors begin anew, 2 to 10. Default 4.
    pub gate: f64,
    /// Frames that the mean runs over at most, 2 to 16. Default 16.
    pub frames: u32,
    /// Standard deviation of the camera's noise, 8-bit levels, 0 (measured) to 32. Default 0.
    pub noise: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { gate: 4.0, frames: 16, noise: 0.0 }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        check("retouch.steady.gate", self.gate, (2.0..=10.0).contains(&self.gate), "2 to 10")?;
        let frames = (2..=16).contains(&self.frames);
        check("retouch.steady.frames", self.frames.into(), frames, "2 to 16 frames")?;
        check("retouch.steady.noise", self.noise, (0.0..=32.0).contains(&self.noise), "0 to 32 levels")
    }

    /// The difference above which pixels begin anew, in levels.
    fn levels(&self, noise: f64) -> u8 {
        (self.gate * noise.max(0.5) + 0.5).min(255.0) as u8
    }
}

/// Levels are kept times this.
const UNIT: i16 = 128;
/// Pixels around a difference that begin anew with it.
const REACH: usize = 2;
const ROWS: usize = 2 * REACH + 1;
/// The first weight after a beginning, and the largest.
const HALF: u8 = 127;

/// The mean of the frames so far.
pub struct Steady {
    config: Config,
    level: Level,
    noise: Noise,
    /// Means in 1/128 levels.
    mean: [Plane<i16>; 3],
    /// The next weight of a pixel, of 256.
    weight: Plane<u8>,
    /// The means in whole levels: of this frame and of the one before.
    shown: [Rgb; 2],
    scratch: Vec<Scratch>,
}

/// What one band works in.
#[derive(Default)]
struct Scratch {
    /// Differences of a row, `REACH` zeros on either side.
    line: Vec<u8>,
    /// The largest differences within `REACH` columns, of the rows around.
    rows: [Vec<u8>; ROWS],
    /// The largest within `REACH` rows and columns.
    most: Vec<u8>,
}

impl Steady {
    /// With these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            config,
            level,
            noise: Noise::default(),
            mean: Default::default(),
            weight: Plane::default(),
            shown: Default::default(),
            scratch: Vec::new(),
        }
    }

    /// The noise taken for the camera's, levels.
    pub fn noise(&self) -> f64 {
        if self.config.noise > 0.0 { self.config.noise } else { self.noise.sigma() }
    }

    /// Takes the next picture in and returns the mean. Allocates only when the size changes.
    pub fn run(&mut self, picture: &Rgb) -> &Rgb {
        let size = picture.size();
        if self.config.noise == 0.0 {
            self.noise.measure(&picture.planes[1]);
        }
        if self.shown[0].size() != size {
            self.begin(picture);
            return &self.shown[0];
        }
        let gate = self.config.levels(self.noise());
        let least = (256 / self.config.frames.clamp(2, 16)) as u8;
        let rows = band_rows(size.height, 16);
        let bands = size.height.div_ceil(rows.max(1));
        if self.scratch.len() < bands {
            self.scratch.resize_with(bands, Scratch::default);
        }
        self.scratch.iter_mut().for_each(|scratch| scratch.fit(size.width));
        self.shown.swap(0, 1);
        let [shown, before] = &mut self.shown;
        let work = Work { picture, before, gate, least };
        let level = self.level;
        let [r, g, b] = shown.planes.each_mut().map(|plane| plane.view_mut().par_bands(rows));
        let shown = r.zip(g).zip(b);
        let [r, g, b] = self.mean.each_mut().map(|plane| plane.view_mut().par_bands(rows));
        let mean = r.zip(g).zip(b);
        let weight = self.weight.view_mut().par_bands(rows);
        shown.zip(mean).zip(weight).zip(&mut self.scratch).for_each(
            |(((((shown_r, shown_g), shown_b), ((mean_r, mean_g), mean_b)), (first, weight)), scratch)| {
                let shown = [shown_r.1, shown_g.1, shown_b.1];
                let mean = [mean_r.1, mean_g.1, mean_b.1];
                dispatch!(level, simd => run_band(simd, work, first, shown, mean, weight, scratch));
            },
        );
        &self.shown[0]
    }

    fn begin(&mut self, picture: &Rgb) {
        let size = picture.size();
        self.shown[0].copy_from(picture);
        self.shown[1].resize(size);
        for (mean, from) in self.mean.iter_mut().zip(&picture.planes) {
            mean.resize(size, 0);
            for y in 0..size.height {
                for (to, &from) in mean.row_mut(y).iter_mut().zip(from.row(y)) {
                    *to = i16::from(from) * UNIT;
                }
            }
        }
        self.weight.resize(size, HALF);
        self.weight.fill(HALF);
    }
}

impl Scratch {
    fn fit(&mut self, width: usize) {
        self.line.resize(width + 2 * REACH, 0);
        self.line.fill(0);
        self.rows.iter_mut().for_each(|row| row.resize(width, 0));
        self.most.resize(width, 0);
    }
}

/// Borrowed inputs of a band.
#[derive(Clone, Copy)]
struct Work<'a> {
    picture: &'a Rgb,
    before: &'a Rgb,
    gate: u8,
    least: u8,
}

#[inline(always)]
fn run_band<S: Simd>(
    simd: S,
    work: Work<'_>,
    first: usize,
    mut shown: [PlaneMut<'_, u8>; 3],
    mut mean: [PlaneMut<'_, i16>; 3],
    mut weight: PlaneMut<'_, u8>,
    scratch: &mut Scratch,
) {
    let Work { picture, gate, least, .. } = work;
    let Scratch { line, rows, most } = scratch;
    rows.iter_mut().for_each(|row| row.fill(0));
    for y in first.saturating_sub(REACH)..first + REACH {
        differ(simd, work, y, line, rows);
    }
    for y in 0..weight.size().height {
        differ(simd, work, first + y + REACH, line, rows);
        highest(simd, rows, most);
        let weight = weight.row_mut(y);
        for c in 0..3 {
            let now = picture.planes[c].row(first + y);
            average(simd, now, most, gate, weight, mean[c].row_mut(y), shown[c].row_mut(y));
        }
        age(simd, most, gate, least, weight);
    }
}

/// The largest differences within `REACH` columns of row `y`, 0 below the picture, into its place in `rows`.
#[inline(always)]
fn differ<S: Simd>(simd: S, work: Work<'_>, y: usize, line: &mut [u8], rows: &mut [Vec<u8>; ROWS]) {
    let size = work.picture.size();
    let row = &mut rows[y % ROWS];
    if y < size.height {
        let now = work.picture.planes.each_ref().map(|plane| plane.row(y));
        let before = work.before.planes.each_ref().map(|plane| plane.row(y));
        difference(simd, now, before, &mut line[REACH..REACH + size.width]);
        widest(simd, line, row);
    } else {
        row.fill(0);
    }
}

/// The difference of every pixel: of its most different channel.
#[inline(always)]
fn difference<S: Simd>(_simd: S, now: [&[u8]; 3], before: [&[u8]; 3], out: &mut [u8]) {
    let n = out.len();
    let ([r, g, b], [r0, g0, b0]) = (now.map(|row| &row[..n]), before.map(|row| &row[..n]));
    for x in 0..n {
        out[x] = r[x].abs_diff(r0[x]).max(g[x].abs_diff(g0[x])).max(b[x].abs_diff(b0[x]));
    }
}

/// The largest of the five values around each.
#[inline(always)]
fn widest<S: Simd>(_simd: S, line: &[u8], out: &mut [u8]) {
    let n = out.len();
    let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|shift| &line[shift..][..n]);
    for x in 0..n {
        out[x] = a[x].max(b[x]).max(c[x]).max(d[x]).max(e[x]);
    }
}

/// The largest of the five rows.
#[inline(always)]
fn highest<S: Simd>(_simd: S, rows: &[Vec<u8>; ROWS], out: &mut [u8]) {
    let n = out.len();
    let [a, b, c, d, e] = rows.each_ref().map(|row| &row[..n]);
    for x in 0..n {
        out[x] = a[x].max(b[x]).max(c[x]).max(d[x]).max(e[x]);
    }
}

/// One channel's means, and their whole levels.
#[inline(always)]
fn average<S: Simd>(
    _simd: S,
    now: &[u8],
    most: &[u8],
    gate: u8,
    weight: &[u8],
    mean: &mut [i16],
    shown: &mut [u8],
) {
    let n = shown.len();
    let (now, most, weight, mean) = (&now[..n], &most[..n], &weight[..n], &mut mean[..n]);
    for x in 0..n {
        // without branches, in 16 bits: one multiplication that keeps the high half
        let (new, old) = (i16::from(now[x]) * UNIT, mean[x]);
        let share = i16::from(weight[x] & HALF) << 8;
        let step = ((i32::from(new.wrapping_sub(old)) * i32::from(share)) >> 16) as i16;
        let open = -i16::from(most[x] > gate);
        let next = (new & open) | (old.wrapping_add(step) & !open);
        mean[x] = next;
        shown[x] = (next.wrapping_add(UNIT / 2) >> 7) as u8;
    }
}

/// The next weights: w - w², down to `least`, or a half after a beginning.
#[inline(always)]
fn age<S: Simd>(_simd: S, most: &[u8], gate: u8, least: u8, weight: &mut [u8]) {
    for (weight, &most) in weight.iter_mut().zip(most) {
        let w = u16::from(*weight);
        let next = ((w - ((w * w) >> 8)) as u8).max(least);
        *weight = if most > gate { HALF } else { next };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;
    use crate::pixels::{Size, SplitMix64, hash_noise};

    /// A scene of a ramp and a bright square that jumps at frame 6, with noise of one standard deviation.
    fn scene(size: Size, frame: usize, sigma: f64) -> Rgb {
        let noise = |x: usize, y: usize, c: u64| {
            let bits = hash_noise(x as u32, y as u32, c, frame as u64);
            let sum: u64 = (0..4).map(|i| bits >> (16 * i) & 0xffff).sum();
            (sum as f64 - 131_070.0) / (65536.0 * 0.577_350_269_189_625_8) * sigma
        };
        let left = if frame < 6 { size.width / 4 } else { size.width / 2 };
        let planes = [0, 1, 2].map(|c| {
            Plane::from_fn(size, |x, y| {
                let inside = (left..left + size.width / 4).contains(&x) && y > size.height / 2;
                let clean = if inside { 200.0 } else { 60.0 + (x + y) as f64 / 2.0 };
                (clean + noise(x, y, c) + 0.5).clamp(0.0, 255.0) as u8
            })
        });
        Rgb { planes }
    }

    #[test]
    fn the_fast_form_is_the_reference() {
        for (w, h) in [(1, 1), (3, 2), (33, 31), (67, 45), (160, 120)] {
            let size = Size::new(w, h);
            let config = Config { noise: 3.0, ..Config::default() };
            let fast = sweep::everywhere("steady", |level| {
                let mut steady = Steady::new(config, level);
                (0..12).map(|frame| steady.run(&scene(size, frame, 3.0)).clone()).collect::<Vec<_>>()
            });
            let mut reference = Reference::new(config);
            let (mut far, mut count) = (0, 0);
            for (frame, fast) in fast.iter().enumerate() {
                let truth = reference.run(&scene(size, frame, 3.0), 3.0);
                for (truth, fast) in truth.iter().zip(&fast.planes) {
                    for (&truth, &fast) in truth.samples().iter().zip(fast.samples()) {
                        count += 1;
                        far += usize::from((truth - f64::from(fast)).abs() > 1.0);
                    }
                }
            }
            // the gate compares whole levels, where a rounded mean may open it a frame earlier or later
            assert!(far * 500 <= count, "{size}: {far} of {count} off by more than a level");
        }
    }

    #[test]
    fn still_noise_shrinks_and_what_moved_is_seen_at_once() {
        let size = Size::new(160, 120);
        let mut steady = Steady::new(Config::default(), crate::pixels::simd::best());
        let mut jumped = 0;
        for frame in 0..40 {
            let clean = scene(size, frame, 0.0);
            let out = steady.run(&scene(size, frame, 3.0)).clone();
            let mut square = 0.0;
            for (clean, out) in clean.planes[1].samples().iter().zip(out.planes[1].samples()) {
                let miss = f64::from(*clean) - f64::from(*out);
                square += miss * miss;
                jumped += usize::from(frame == 6 && miss.abs() > 20.0);
            }
            let rms = (square / size.area() as f64).sqrt();
            assert!(frame < 30 || rms < 1.1, "frame {frame}: {rms} levels of noise left of 3");
        }
        assert_eq!(jumped, 0, "no pixel lags behind the square");
        assert!((2.4..3.6).contains(&steady.noise()), "measured {} for 3", steady.noise());
    }

    #[test]
    fn any_picture_is_taken() {
        let mut rng = SplitMix64::new(1);
        let mut steady = Steady::new(Config::default(), crate::pixels::simd::best());
        for (w, h) in [(1, 1), (16, 16), (2, 5), (0, 0), (31, 3)] {
            for _ in 0..3 {
                let size = Size::new(w, h);
                let noise = Rgb { planes: [0; 3].map(|_| Plane::from_fn(size, |_, _| rng.next_u64() as u8)) };
                assert_eq!(steady.run(&noise).size(), size);
            }
        }
    }
}
