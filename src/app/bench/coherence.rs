//! How calm a style is from frame to frame, and whether calming the camera's noise harms it.
//!
//! Still: the synthetic table from a tripod, with sensor noise; counted are pixels that jump by more than 40 levels
//! from one drawn frame to the next. Pan: the same table passing by at 2 px a frame; measured is how far the noisy
//! picture's style is from the clean picture's. Both with the camera's picture as it comes and steadied.
//!
//! Pattern: a camera that moves along stripes sees no change, so that what moves in the drawn picture is the style's
//! pattern alone. Measured is how well its motion correlates with the camera's, anchored or not.

use super::{Args, pool, say};
use crate::camera::{Synthetic, SyntheticConfig};
use crate::frame::Frame;
use crate::geometry::Similarity;
use crate::kernel::color;
use crate::pixels::simd::{self, Level};
use crate::pixels::{Plane, Rgb, Size, hash_noise};
use crate::retouch::steady::{self, Steady};
use crate::style::{Config, StyleInput, StyleName, Styler};
use clap::ValueEnum;
use glam::DVec2;
use rayon::prelude::*;

/// Standard deviation of the noise, levels.
const SIGMA: f64 = 3.0;
/// A change by more than this many levels is a jump.
const JUMP: u8 = 40;
/// Frames until the mean has settled.
const SETTLE: usize = 24;
/// Pixels a frame of the pan.
const PACE: usize = 2;
/// How the camera moves along the stripes, px a frame.
const PANS: [[isize; 2]; 8] = [[2, 1], [-1, 2], [-3, -1], [1, -3], [4, 0], [0, -4], [-4, 3], [3, 4]];
/// Frames of each of these pans; the pattern's motion is measured between the last two.
const PANNED: usize = 6;
/// Side of the patches whose motion is measured, px.
const PATCH: usize = 32;
/// Farthest motion along each axis that is looked for, px.
const SEARCH: isize = 8;

/// What was measured of one style; in each pair the camera's picture as it comes, then steadied.
#[derive(Clone, Copy, Debug)]
pub struct Coherence {
    /// The style.
    pub style: StyleName,
    /// Share of pixels that jump from one frame of a still scene to the next.
    pub jumps: [f64; 2],
    /// PSNR of the panned scene to the style of the clean picture, dB.
    pub psnr: [f64; 2],
    /// Correlation of the pattern's motion with the scene's, standing and anchored; `None` without a pattern.
    pub pattern: Option<[f64; 2]>,
}

impl Coherence {
    /// How many times fewer pixels jump when steadied; infinite when none does.
    pub fn ratio(&self) -> f64 {
        self.jumps[0] / self.jumps[1]
    }

    /// What steadying costs under the pan, dB; below 0 where it gains.
    pub fn loss(&self) -> f64 {
        self.psnr[0] - self.psnr[1]
    }
}

/// Prints every style's figures at 640x480, on the most threads asked for.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let pool = pool(args.threads.iter().copied().max().unwrap_or(2))?;
    if !args.json {
        say(
            "still scene, noise of 3 levels: pixels that jump > 40 levels a frame; pan of 2 px a frame: PSNR to the clean style;\npattern: correlation of its motion with the scene's\n",
        )?;
        say("style              jumps %  steadied    ratio   PSNR dB  steadied     loss  pattern  anchored")?;
    }
    for &name in StyleName::value_variants() {
        let size = Size::new(640, 480);
        let found = pool.install(|| measure(name, size, args.frames() as usize, simd::best()));
        let Coherence { style, jumps: [jumps, steadied], psnr: [psnr, psnr_steady], pattern } = found;
        if args.json {
            say(serde_json::json!({
                "coherence": style.name(), "jumps": jumps, "jumps_steady": steadied, "ratio": found.ratio(),
                "psnr_db": psnr, "psnr_steady_db": psnr_steady, "loss_db": found.loss(),
                "pattern_motion": pattern.map(|p| p[0]), "pattern_motion_anchored": pattern.map(|p| p[1]),
            }))?;
        } else {
            let (name, ratio, loss) = (style.name(), found.ratio(), found.loss());
            let (jumps, steadied) = (100.0 * jumps, 100.0 * steadied);
            let [loose, held] =
                pattern.map_or(["-", "-"].map(String::from), |p| p.map(|p| format!("{p:.3}")));
            say(format_args!(
                "{name:<17} {jumps:>8.4} {steadied:>9.4} {ratio:>8.1} {psnr:>9.2} {psnr_steady:>9.2} {loss:>8.2} {loose:>8} {held:>9}"
            ))?;
        }
    }
    Ok(())
}

/// Measures one style with its default settings over `frames` frames of `size`.
pub fn measure(style: StyleName, size: Size, frames: usize, level: Level) -> Coherence {
    let config = Config { name: style, ..Config::default() };
    let (jumps, psnr) = (still(&config, size, frames, level), pan(&config, size, frames, level));
    let pattern = style.has_pattern().then(|| [false, true].map(|held| follow(&config, size, held, level)));
    Coherence { style, jumps, psnr, pattern }
}

/// The synthetic table without noise.
fn table(size: Size, level: Level) -> Rgb {
    let settings = SyntheticConfig { noise: 0.0, pace: 0.0, ..SyntheticConfig::default() };
    let mut frame = Frame::default();
    Synthetic::new(&settings, size, 30.0, level).next(&mut frame);
    frame.color
}

fn still(config: &Config, size: Size, frames: usize, level: Level) -> [f64; 2] {
    let clean = table(size, level);
    let mut stylers = [0; 2].map(|_| Styler::new(config, level));
    let mut steady = Steady::new(steady::Config::default(), level);
    let (mut frame, mut noisy) = (Frame::default(), Rgb::default());
    let mut drawn: [[Rgb; 2]; 2] = Default::default();
    let mut jumps = [0u64; 2];
    for number in 0..SETTLE + frames {
        add_noise(&clean, number as u64, &mut noisy);
        for (way, styler) in stylers.iter_mut().enumerate() {
            let picture = if way == 0 { &noisy } else { steady.run(&noisy) };
            frame.resize(size);
            frame.color.copy_from(picture);
            let [now, before] = &mut drawn[way];
            std::mem::swap(now, before);
            now.resize(size);
            styler.draw(StyleInput { frame: &frame, layer: None }, now);
            if number >= SETTLE {
                jumps[way] += jumping(now, before);
            }
        }
    }
    jumps.map(|count| count as f64 / (frames * size.area()).max(1) as f64)
}

fn pan(config: &Config, size: Size, frames: usize, level: Level) -> [f64; 2] {
    let wide = table(Size::new(size.width + PACE * (SETTLE + frames), size.height), level);
    let mut stylers = [0; 3].map(|_| Styler::new(config, level));
    let mut steady = Steady::new(steady::Config::default(), level);
    let (mut clean, mut noisy) = (Rgb::new(size, [0; 3]), Rgb::default());
    let mut frame = Frame::default();
    frame.resize(size);
    let mut drawn = [0; 3].map(|_| Rgb::new(size, [0; 3]));
    let mut squares = [0u64; 2];
    for number in 0..SETTLE + frames {
        for (to, from) in clean.planes.iter_mut().zip(&wide.planes) {
            for y in 0..size.height {
                to.row_mut(y).copy_from_slice(&from.row(y)[PACE * number..][..size.width]);
            }
        }
        add_noise(&clean, number as u64, &mut noisy);
        for (picture, (styler, out)) in
            [&clean, &noisy, steady.run(&noisy)].into_iter().zip(stylers.iter_mut().zip(&mut drawn))
        {
            frame.color.copy_from(picture);
            styler.draw(StyleInput { frame: &frame, layer: None }, out);
        }
        if number >= SETTLE {
            let [truth, noisy, steadied] = &drawn;
            squares[0] += square(truth, noisy);
            squares[1] += square(truth, steadied);
        }
    }
    squares.map(|sum| {
        let mean = sum as f64 / (3 * frames * size.area()).max(1) as f64;
        if mean == 0.0 { f64::INFINITY } else { 10.0 * libm::log10(255.0 * 255.0 / mean) }
    })
}

/// Pearson's correlation of how patches of the drawn picture move with how the scene does, over all pans.
fn follow(config: &Config, size: Size, anchored: bool, level: Level) -> f64 {
    let mut pairs = Vec::new();
    for pan in PANS {
        let mut styler = Styler::new(config, level);
        let mut frame = Frame::default();
        frame.resize(size);
        frame.color = stripes(size, pan);
        let (mut before, mut now) = (Rgb::new(size, [0; 3]), Rgb::new(size, [0; 3]));
        for number in 0..PANNED {
            std::mem::swap(&mut before, &mut now);
            let shift = DVec2::from(pan.map(|v| v as f64)) * number as f64;
            styler.anchor(anchored.then_some(Similarity { shift, ..Similarity::IDENTITY }));
            styler.draw(StyleInput { frame: &frame, layer: None }, &mut now);
        }
        for [x, y] in motions(&before, &now) {
            // the camera goes one way, what it sees the other
            pairs.extend([(-pan[0] as f64, x as f64), (-pan[1] as f64, y as f64)]);
        }
    }
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len().max(1) as f64;
    let [scene, pattern] = [mean(|pair| pair.0), mean(|pair| pair.1)];
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        pairs.iter().map(|pair| of(pair.0 - scene, pair.1 - pattern)).sum::<f64>()
    };
    let spread = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    // what never moves follows nothing
    if spread > 0.0 { sum(&|a, b| a * b) / spread } else { 0.0 }
}

/// Stripes along a pan, the same picture wherever the camera stands: ramps steep enough to be sketched, and not so
/// steep that they are outlines.
fn stripes(size: Size, [x, y]: [isize; 2]) -> Rgb {
    let length = ((x * x + y * y) as f64).sqrt();
    let plane = Plane::from_fn(size, |column, row| {
        let across = (x * row as isize - y * column as isize) as f64 / length;
        (30.0 + 16.2 * (across.rem_euclid(24.0) - 12.0).abs()) as u8
    });
    Rgb { planes: [plane.clone(), plane.clone(), plane] }
}

/// How the patches of a picture have moved: where the normalized cross-correlation of brightness is greatest.
/// Patches without a pattern are left out.
fn motions(before: &Rgb, now: &Rgb) -> Vec<[isize; 2]> {
    let size = before.size();
    let [before, now] =
        [before, now].map(|picture| Plane::from_fn(size, |x, y| color::reference(picture.at(x, y))[0]));
    let mut ways: Vec<[isize; 2]> =
        (-SEARCH..=SEARCH).flat_map(|y| (-SEARCH..=SEARCH).map(move |x| [x, y])).collect();
    // among equals the shortest
    ways.sort_by_key(|[x, y]| x * x + y * y);
    let margin = SEARCH as usize;
    let starts = |length: usize| (margin..(length + 1).saturating_sub(PATCH + margin)).step_by(PATCH);
    let patches: Vec<[usize; 2]> =
        starts(size.height).flat_map(|top| starts(size.width).map(move |left| [left, top])).collect();
    let moved = patches.into_par_iter().filter_map(|[left, top]| {
        let mut best = (0.0, None);
        for &[x, y] in &ways {
            let there = [left.checked_add_signed(x)?, top.checked_add_signed(y)?];
            let alike = correlation([&before, &now], [left, top], there);
            if alike > best.0 {
                best = (alike, Some([x, y]));
            }
        }
        best.1
    });
    moved.collect()
}

/// Normalized cross-correlation of a patch of one plane with one of the other; 0 where one of them is even.
fn correlation([a, b]: [&Plane<f64>; 2], from: [usize; 2], to: [usize; 2]) -> f64 {
    let (mut sum, mut square, mut product) = ([0.0; 2], [0.0; 2], 0.0);
    for row in 0..PATCH {
        let a = &a.row(from[1] + row)[from[0]..][..PATCH];
        let b = &b.row(to[1] + row)[to[0]..][..PATCH];
        for (&a, &b) in a.iter().zip(b) {
            sum = [sum[0] + a, sum[1] + b];
            square = [square[0] + a * a, square[1] + b * b];
            product += a * b;
        }
    }
    let count = (PATCH * PATCH) as f64;
    let spread = |i: usize| square[i] - sum[i] * sum[i] / count;
    let both = spread(0) * spread(1);
    if both > 1e-6 { (product - sum[0] * sum[1] / count) / both.sqrt() } else { 0.0 }
}

/// A near-normal number of deviation `SIGMA` on every byte: the sum of four uniform 16-bit numbers.
fn add_noise(clean: &Rgb, sequence: u64, out: &mut Rgb) {
    out.resize(clean.size());
    let scale = (SIGMA / (65536.0 * 0.577_350_269_189_625_8)) as f32;
    for (channel, (from, to)) in clean.planes.iter().zip(&mut out.planes).enumerate() {
        to.view_mut().par_bands(32).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                let from = from.row(first + y);
                for (x, (value, &from)) in band.row_mut(y).iter_mut().zip(from).enumerate() {
                    let bits = hash_noise(x as u32, (first + y) as u32, 31 + channel as u64, sequence);
                    let sum: u32 = (0..4).map(|i| (bits >> (16 * i) & 0xffff) as u32).sum();
                    let noisy = f32::from(from) + (sum as f32 - 131_070.0) * scale;
                    *value = (noisy + 0.5).clamp(0.0, 255.0) as u8;
                }
            }
        });
    }
}

/// How many pixels differ by more than `JUMP` in some channel.
fn jumping(a: &Rgb, b: &Rgb) -> u64 {
    let apart = |a: &Plane<u8>, b: &Plane<u8>, i: usize| a.samples()[i].abs_diff(b.samples()[i]) > JUMP;
    let jumps = |i: &usize| a.planes.iter().zip(&b.planes).any(|(a, b)| apart(a, b, *i));
    (0..a.size().area()).into_par_iter().filter(jumps).count() as u64
}

/// The sum of squared differences.
fn square(a: &Rgb, b: &Rgb) -> u64 {
    let planes = a.planes.iter().zip(&b.planes);
    planes
        .map(|(a, b)| {
            let pairs = a.samples().iter().zip(b.samples());
            pairs.map(|(a, b)| u64::from(a.abs_diff(*b)) * u64::from(a.abs_diff(*b))).sum::<u64>()
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steadied_styles_jump_a_quarter_as_often_and_lose_nothing() {
        for &style in StyleName::value_variants() {
            let found = measure(style, Size::new(320, 240), 12, simd::best());
            let calm = found.jumps[0] < 1e-6 || found.ratio() >= 4.0;
            assert!(calm && found.loss() <= 0.5, "{found:?}");
        }
    }

    #[test]
    fn anchored_patterns_move_with_the_scene() {
        let size = Size::new(160, 120);
        let mut wrong = Vec::new();
        for &style in StyleName::value_variants().iter().filter(|style| style.has_pattern()) {
            let config = Config { name: style, ..Config::default() };
            let [loose, held] = [false, true].map(|held| follow(&config, size, held, simd::best()));
            if held < 0.9 || loose > 0.5 {
                wrong.push(format!("{style}: correlation {loose:.3}, anchored {held:.3}"));
            }
        }
        assert!(wrong.is_empty(), "{wrong:?}");
    }
}
