//! `vernissage bench --styles`: every style and every variant of its steps, time against error.

use super::quality::Quality;
use super::{Args, Bench, Times, plot, steps};
use crate::app::report::machine;
use crate::app::{pool, progress, say};
use crate::pixels::{Rgb, simd};
use crate::style::{self, StyleInput, StyleName, Styler};
use clap::ValueEnum;

/// Settings that trade quality for time, each measured against the style's own defaults.
fn ladder(style: StyleName) -> &'static [&'static [(&'static str, &'static str)]] {
    match style {
        StyleName::Plain | StyleName::SketchLike | StyleName::Illustrative => &[],
        StyleName::Cartoon => &[
            &[("steps", "5")],
            &[("steps", "3")],
            &[("steps", "1")],
            &[("shrunk_width", "160"), ("shrunk_height", "120")],
            &[("shrunk_width", "160"), ("shrunk_height", "120"), ("steps", "3")],
            &[("shrunk_width", "320"), ("shrunk_height", "240")],
        ],
        StyleName::BilateralCartoon => {
            &[&[("iterations", "1")], &[("levels", "3")], &[("levels", "1")], &[("levels", "4")]]
        }
        StyleName::Watercolor => &[&[("cell", "6")], &[("cell", "12")], &[("cell", "16")]],
        StyleName::Pointillism => &[
            &[("col_skip", "4"), ("row_skip", "4")],
            &[("col_skip", "6"), ("row_skip", "6")],
            &[("col_skip", "8"), ("row_skip", "8")],
        ],
        StyleName::Sketchy => &[
            &[("density", ".06")],
            &[("points", "6")],
            &[("renderer", "polygons")],
            &[("renderer", "sprites")],
            &[("blur", "false")],
            &[("strokes", "false")],
        ],
    }
}

/// One measured variant.
struct Line {
    style: StyleName,
    variant: String,
    threads: usize,
    times: Times,
    quality: Quality,
}

impl Line {
    fn print(&self, json: bool) -> anyhow::Result<()> {
        let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
        let (min, median, quality) = (ms(self.times.min), ms(self.times.median), &self.quality);
        if json {
            // JSON has no infinity: equal pictures have a PSNR of null
            return say(serde_json::json!({
                "style": self.style.name(), "variant": self.variant, "threads": self.threads, "min_ms": min,
                "median_ms": median, "max": quality.max, "over_two": quality.over_two,
                "psnr": quality.psnr.is_finite().then_some(quality.psnr), "ssim": quality.ssim,
                "delta_e_mean": quality.delta_e_mean, "delta_e_p99": quality.delta_e_p99,
            }));
        }
        let (style, variant, threads) = (self.style, &self.variant, self.threads);
        say(format_args!("{style:<18} {variant:<36} {threads:>7} {min:>9.3} {median:>9.3}  {quality}"))
    }
}

/// Measures, prints, and leaves the plot.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.json {
        say(serde_json::json!({ "machine": machine(), "frames": args.frames(), "repeat": args.repeat }))?;
    } else {
        say(format_args!("{}, 640x480, {} frames x {} runs", machine(), args.frames(), args.repeat))?;
        say(
            "errors are those of a first frame: defaults and SIMD levels against the style's f64 reference,",
        )?;
        say("other settings against the f64 reference of the defaults (what they cost in likeness)\n")?;
        say(format_args!(
            "{:<18} {:<36} {:>7} {:>9} {:>9}  error",
            "style", "variant", "threads", "min ms", "median"
        ))?;
    }
    let bar = progress::bar(Some(StyleName::value_variants().len() as u64), "styles");
    let mut points = Vec::new();
    for &style in StyleName::value_variants() {
        let mut truth = None;
        for &threads in &args.threads {
            pool(threads)?.install(|| -> anyhow::Result<()> {
                let bench = Bench::new(args, threads)?;
                let defaults = style::Config { name: style, ..style::Config::default() };
                let truth = truth.get_or_insert_with(|| style::reference(&defaults, &bench.frames[0].color));
                for line in lines(&bench, &defaults, truth)? {
                    bar.suspend(|| line.print(args.json))?;
                    points.push(plot::Point {
                        series: format!("{style}, {threads} threads"),
                        label: line.variant.clone(),
                        ms: line.times.min.as_secs_f64() * 1e3,
                        error: line.quality.delta_e_mean,
                    });
                }
                Ok(())
            })?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !args.json {
        say(format_args!(
            "\n{:<18} {:<36} {:>7} {:>9} {:>9}  error",
            "step", "", "threads", "min ms", "median"
        ))?;
    }
    for &threads in &args.threads {
        pool(threads)?.install(|| -> anyhow::Result<()> {
            let bench = Bench::new(args, threads)?;
            steps::all(&bench).iter().try_for_each(|step| step.print(threads, args.json))
        })?;
    }
    let title = format!("vernissage bench --styles: time against error, 640x480, {}", machine());
    args.leave_plot("styles.svg", &plot::svg(&title, "mean ΔE00 from the f64 reference", &points))
}

/// The defaults at the machine's best level, at every other level, and the settings that trade quality for time.
fn lines(bench: &Bench, defaults: &style::Config, truth: &Rgb) -> anyhow::Result<Vec<Line>> {
    let best = simd::name(simd::best());
    let mut variants = vec![(format!("defaults, {best}"), defaults.clone(), simd::best())];
    for level in simd::available().into_iter().filter(|&level| simd::name(level) != best) {
        variants.push((format!("defaults, {}", simd::name(level)), defaults.clone(), level));
    }
    for settings in ladder(defaults.name) {
        let mut config = defaults.clone();
        for (key, value) in *settings {
            config.set(key, value)?;
        }
        let label: Vec<String> = settings.iter().map(|(key, value)| format!("{key} {value}")).collect();
        variants.push((label.join(", "), config, simd::best()));
    }
    let measure = |(variant, config, level): (String, style::Config, simd::Level)| {
        let mut styler = Styler::new(&config, level);
        let mut canvas = Rgb::new(truth.size(), [0; 3]);
        let times = bench.time(|frame| styler.draw(StyleInput { frame, layer: None }, &mut canvas));
        // a first frame, as the reference draws it: styles may carry their pattern from frame to frame
        styler.restart();
        styler.draw(StyleInput { frame: &bench.frames[0], layer: None }, &mut canvas);
        let quality = Quality::of(&canvas, truth);
        Line { style: config.name, variant, threads: bench.threads, times, quality }
    };
    Ok(variants.into_iter().map(measure).collect())
}
