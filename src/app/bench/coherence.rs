//! How calm a style is from frame to frame, and whether calming the camera's noise harms it.
//!
//! Still: the synthetic table from a tripod, with sensor noise; counted are pixels that jump by more than 40 levels
//! from one drawn frame to the next. Pan: the same table passing by at 2 px a frame; measured is how far the noisy
//! picture's style is from the clean picture's. Both with the camera's picture as it comes and steadied.

use super::{Args, pool, say};
use crate::camera::{Synthetic, SyntheticConfig};
use crate::frame::Frame;
use crate::pixels::simd::{self, Level};
use crate::pixels::{Plane, Rgb, Size, hash_noise};
use crate::retouch::steady::{self, Steady};
use crate::style::{Config, StyleInput, StyleName, Styler};
use clap::ValueEnum;
use rayon::prelude::*;

/// Standard deviation of the noise, levels.
const SIGMA: f64 = 3.0;
/// A change by more than this many levels is a jump.
const JUMP: u8 = 40;
/// Frames until the mean has settled.
const SETTLE: usize = 24;
/// Pixels a frame of the pan.
const PACE: usize = 2;

/// What was measured of one style; in each pair the camera's picture as it comes, then steadied.
#[derive(Clone, Copy, Debug)]
pub struct Coherence {
    /// The style.
    pub style: StyleName,
    /// Share of pixels that jump from one frame of a still scene to the next.
    pub jumps: [f64; 2],
    /// PSNR of the panned scene to the style of the clean picture, dB.
    pub psnr: [f64; 2],
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
            "still scene, noise of 3 levels: pixels that jump > 40 levels a frame; pan of 2 px a frame: PSNR to the clean style\n",
        )?;
        say("style              jumps %  steadied    ratio   PSNR dB  steadied     loss")?;
    }
    for &name in StyleName::value_variants() {
        let size = Size::new(640, 480);
        let found = pool.install(|| measure(name, size, args.frames as usize, simd::best()));
        let Coherence { style, jumps: [jumps, steadied], psnr: [psnr, psnr_steady] } = found;
        if args.json {
            say(serde_json::json!({
                "coherence": style.name(), "jumps": jumps, "jumps_steady": steadied, "ratio": found.ratio(),
                "psnr_db": psnr, "psnr_steady_db": psnr_steady, "loss_db": found.loss(),
            }))?;
        } else {
            let (name, ratio, loss) = (style.name(), found.ratio(), found.loss());
            let (jumps, steadied) = (100.0 * jumps, 100.0 * steadied);
            say(format_args!(
                "{name:<17} {jumps:>8.4} {steadied:>9.4} {ratio:>8.1} {psnr:>9.2} {psnr_steady:>9.2} {loss:>8.2}"
            ))?;
        }
    }
    Ok(())
}

/// Measures one style with its default settings over `frames` frames of `size`.
pub fn measure(style: StyleName, size: Size, frames: usize, level: Level) -> Coherence {
    let config = Config { name: style, ..Config::default() };
    let (jumps, psnr) = (still(&config, size, frames, level), pan(&config, size, frames, level));
    Coherence { style, jumps, psnr }
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
}
