//! `vernissage bench --budget-ms B`: what every style costs at each of its quality levels, and where the governor of a
//! running visor settles on this machine.

use super::{Args, Bench, Times};
use crate::app::report::machine;
use crate::app::{demo, pool, progress, say};
use crate::pipeline::governor::{Config, Governor};
use crate::style::StyleName;
use clap::ValueEnum;
use std::time::Duration;

/// From one picture to the next, as the governor is told.
const INTERVAL: Duration = Duration::from_nanos(33_333_333);
/// Pictures that the governor sees: a minute.
const PICTURES: u32 = 1800;

/// Measures and prints.
pub fn run(args: &Args, budget_ms: f64) -> anyhow::Result<()> {
    let config = Config { budget_ms };
    config.check().map_err(|reason| anyhow::anyhow!("--budget-ms: {reason}"))?;
    if args.json {
        say(serde_json::json!({ "machine": machine(), "budget_ms": budget_ms, "repeat": args.repeat }))?;
    } else {
        say(format_args!("{}, 640x480, whole frames, a budget of {budget_ms} ms", machine()))?;
        say(format_args!(
            "{:<18} {:>7}  {:<27} {:>7} {:>5} {:>6}",
            "style", "threads", "median ms by level", "settles", "steps", "over"
        ))?;
    }
    let bar = progress::bar(Some((StyleName::value_variants().len() * args.threads.len()) as u64), "styles");
    for &style in StyleName::value_variants() {
        for &threads in &args.threads {
            let line = pool(threads)?.install(|| measure(args, style, threads, &config))?;
            bar.suspend(|| line.print(args.json))?;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// One style.
struct Line {
    style: StyleName,
    threads: usize,
    medians: Vec<Duration>,
    settles: usize,
    steps: u32,
    /// Share of pictures over the budget.
    over: f64,
}

fn measure(args: &Args, style: StyleName, threads: usize, config: &Config) -> anyhow::Result<Line> {
    let bench = Bench::new(args, threads)?;
    let (pipeline, _) = demo::stage(style, 0)?;
    let mut pipeline = pipeline.governed();
    let levels = pipeline.forms();
    let mut medians = Vec::new();
    for level in 0..levels {
        pipeline.set_quality(level);
        for frame in bench.frames.iter().take(3) {
            pipeline.draw_frame(frame);
        }
        let mut all = Vec::new();
        for _ in 0..args.repeat {
            all.extend(bench.frames.iter().map(|frame| pipeline.draw_frame(frame).timings.frame()));
        }
        medians.push(Times::of(all).median);
    }
    pipeline.set_quality(0);
    let mut governor = Governor::new(config);
    let (mut steps, mut over) = (0, 0);
    for number in 0..PICTURES {
        let frame = &bench.frames[number as usize % bench.frames.len()];
        let cost = pipeline.draw_frame(frame).timings.frame();
        over += u32::from(cost.as_secs_f64() * 1e3 > config.budget_ms);
        if let Some(level) = governor.observe(cost, levels, number * INTERVAL) {
            pipeline.set_quality(level);
            steps += 1;
        }
    }
    let over = f64::from(over) / f64::from(PICTURES);
    Ok(Line { style, threads, medians, settles: governor.level(), steps, over })
}

impl Line {
    fn print(&self, json: bool) -> anyhow::Result<()> {
        let ms: Vec<f64> = self.medians.iter().map(|d| d.as_secs_f64() * 1e3).collect();
        if json {
            return say(serde_json::json!({
                "style": self.style.name(), "threads": self.threads, "median_ms": ms, "settles": self.settles,
                "steps": self.steps, "over": self.over,
            }));
        }
        let medians: Vec<String> = ms.iter().map(|ms| format!("{ms:8.3}")).collect();
        say(format_args!(
            "{:<18} {:>7}  {:<27} {:>7} {:>5} {:>5.1}%",
            self.style,
            self.threads,
            medians.join(" "),
            self.settles,
            self.steps,
            100.0 * self.over
        ))
    }
}
