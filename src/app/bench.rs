//! `vernissage bench`: time and error of every stage, side by side, with the machine's facts.

mod budget;
mod coherence;
pub mod following;
pub mod markers;
pub mod motion;
mod plot;
mod quality;
mod raster;
mod steps;
mod styles;
mod table;
pub mod tally;
mod tracking;

use super::report::machine;
use super::{Failed, demo, pool, progress, say};
use crate::camera::Synthetic;
use crate::display::Sink;
use crate::frame::{Frame, Needs};
use crate::geometry::Lens;
use crate::kernel::yuv::{self, Coding, Samples};
use crate::marker::Family;
use crate::pipeline::Stage;
use crate::pixels::{Plane, Rgb, Size, simd};
use crate::render::{Camera, Placed, Renderer};
use crate::retouch;
use crate::scene::{Mesh, Scene};
use crate::style::{self, StyleInput, StyleName, Styler};
use crate::track::{Tracker, Wanted};
use anyhow::Context;
use clap::ValueEnum;
use glam::{DAffine3, DVec2, DVec3};
use quality::Quality;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Prints how long each stage takes and how far it is from its f64 reference or the exact truth.
///
/// Frames come from the synthetic camera, drawn beforehand. Every figure is taken over --repeat runs of every
/// frame; min is what the machine can do, median what it did. Without a choice all parts are measured.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  vernissage bench\n  vernissage bench --styles --threads 1 --repeat 100 --json"
)]
pub struct Args {
    /// The styles only, in every variant: settings, SIMD levels, single steps; leaves a plot
    #[arg(long, conflicts_with_all = ["tracking", "raster"])]
    styles: bool,
    /// The tracker only, on synthetic frames with exact truth: recall, errors, jitter, false positives and time at
    /// each quality; leaves a plot
    #[arg(long, conflicts_with = "raster")]
    tracking: bool,
    /// The rasteriser only, on models of rising size: time, rates and error against the f64 reference
    #[arg(long)]
    raster: bool,
    /// Another model file for --raster; may be given more than once
    #[arg(long, value_name = "FILE", requires = "raster")]
    model: Vec<PathBuf>,
    /// How calm the styles are on a noisy, still scene, whether `[retouch.steady]` helps, and how well patterns follow
    /// the scene with `style.anchored`
    #[arg(long)]
    coherence: bool,
    /// Keeping to a budget of so many ms a frame: what every style costs at each of its quality levels, and where the
    /// governor settles
    #[arg(long, value_name = "B", conflicts_with_all = ["styles", "tracking", "raster", "coherence"])]
    budget_ms: Option<f64>,
    /// Thread counts to measure
    #[arg(long, value_delimiter = ',', default_value = "1,2", value_name = "N,N")]
    threads: Vec<usize>,
    /// Different frames; by default 12, with --tracking 60 (of which a tenth is timed)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    frames: Option<u64>,
    /// Runs of every frame
    #[arg(long, default_value_t = 20, value_name = "K", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    repeat: u64,
    /// Family of the markers that --tracking looks for
    #[arg(long, default_value = "tag36h11", value_name = "NAME", value_parser = Family::from_name)]
    family: Family,
    /// Where --styles and --tracking leave their plot of time against error; by default styles.svg, tracking.svg
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
}

/// One line of the table.
struct Row {
    stage: &'static str,
    variant: String,
    threads: usize,
    times: Times,
    error: String,
}

/// One part of the table.
type Part = fn(&Bench) -> Vec<Row>;

/// Times of many runs.
struct Times {
    min: Duration,
    median: Duration,
    p99: Duration,
}

impl Times {
    fn of(mut all: Vec<Duration>) -> Self {
        all.sort_unstable();
        let at = |share: f64| all[((share * all.len() as f64).ceil() as usize).clamp(1, all.len()) - 1];
        Self { min: all[0], median: at(0.5), p99: at(0.99) }
    }
}

/// Measures what was asked for and prints it.
pub fn run(args: Args) -> anyhow::Result<()> {
    if let Some(budget_ms) = args.budget_ms {
        return budget::run(&args, budget_ms);
    }
    if args.coherence {
        return coherence::run(&args);
    }
    if args.styles {
        return styles::run(&args);
    }
    if args.tracking {
        return tracking::run(&args);
    }
    if args.raster {
        return raster::run(&args);
    }
    let parts: [Part; 6] =
        [Bench::convert, Bench::tracking, Bench::raster, Bench::retouch, Bench::styles, Bench::whole];
    if args.json {
        say(serde_json::json!({ "machine": machine(), "frames": args.frames(), "repeat": args.repeat }))?;
    } else {
        say(format_args!("{}, 640x480, {} frames x {} runs\n", machine(), args.frames(), args.repeat))?;
        say(format_args!(
            "{:<8} {:<28} {:>7} {:>9} {:>9} {:>9}  error",
            "stage", "variant", "threads", "min ms", "median", "p99"
        ))?;
    }
    let wanted = parts.len() * args.threads.len();
    let bar = progress::bar(Some(wanted as u64), "parts");
    for &threads in &args.threads {
        pool(threads)?.install(|| -> anyhow::Result<()> {
            let bench = Bench::new(&args, threads)?;
            for part in &parts {
                for row in part(&bench) {
                    bar.suspend(|| row.print(args.json))?;
                }
                bar.inc(1);
            }
            Ok(())
        })?;
    }
    bar.finish_and_clear();
    Ok(())
}

impl Args {
    /// How many different frames most parts look at.
    fn frames(&self) -> u64 {
        self.frames.unwrap_or(12)
    }

    /// Writes a plot where it was asked for, or else to `name` in the working folder, and says so.
    fn leave_plot(&self, name: &str, svg: &str) -> anyhow::Result<()> {
        let file = self.plot.as_deref().unwrap_or(Path::new(name));
        std::fs::write(file, svg)
            .with_context(|| format!("{}: cannot write the plot", file.display()))
            .context(Failed("cannot write the plot"))?;
        if self.json { Ok(()) } else { say(format_args!("\nplot  {}", file.display())) }
    }
}

impl Row {
    fn print(&self, json: bool) -> anyhow::Result<()> {
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        let Times { min, median, p99 } = self.times;
        if json {
            let row = serde_json::json!({
                "stage": self.stage, "variant": self.variant, "threads": self.threads, "min_ms": ms(min),
                "median_ms": ms(median), "p99_ms": ms(p99), "error": self.error,
            });
            say(row)
        } else {
            say(format_args!(
                "{:<8} {:<28} {:>7} {:>9.3} {:>9.3} {:>9.3}  {}",
                self.stage,
                self.variant,
                self.threads,
                ms(min),
                ms(median),
                ms(p99),
                self.error
            ))
        }
    }
}

/// The frames every part works on.
struct Bench {
    frames: Vec<Frame>,
    camera: Synthetic,
    repeat: u64,
    threads: usize,
}

impl Bench {
    fn new(args: &Args, threads: usize) -> anyhow::Result<Self> {
        let (_, mut camera) = demo::stage(StyleName::Plain, 0)?;
        let mut frames = Vec::new();
        // spread over the path: every tenth frame
        for _ in 0..args.frames() {
            let mut frame = Frame::default();
            camera.skip_to(frames.len() as u64 * 10);
            camera.next(&mut frame);
            frames.push(frame);
        }
        Ok(Self { frames, camera, repeat: args.repeat, threads })
    }

    /// Runs `work` on every frame `repeat` times after a warm-up round.
    fn time(&self, mut work: impl FnMut(&Frame)) -> Times {
        self.frames.iter().take(3).for_each(&mut work);
        let mut all = Vec::with_capacity(self.frames.len() * self.repeat as usize);
        for _ in 0..self.repeat {
            for frame in &self.frames {
                let start = Instant::now();
                work(frame);
                all.push(start.elapsed());
            }
        }
        Times::of(all)
    }

    fn row(&self, stage: &'static str, variant: impl Into<String>, times: Times, error: String) -> Row {
        Row { stage, variant: variant.into(), threads: self.threads, times, error }
    }

    /// The packed 4:2:2 picture that most cameras give.
    fn convert(&self) -> Vec<Row> {
        let size = self.camera.lens().size;
        let byte = |x: usize, y: usize| self.frames[0].color.planes[x % 3].at(x / 2, y);
        let bytes = Plane::from_fn(Size::new(2 * size.width, size.height), byte);
        let (samples, coding) = (Samples::Yuyv(bytes.view()), Coding::default());
        let (mut luma, mut color) = (Plane::default(), Rgb::default());
        let times = self.time(|_| yuv::to_rgb(simd::best(), &samples, size, coding, &mut luma, &mut color));
        let error = Quality::of(&color, &yuv::reference::to_rgb(&samples, size, coding).1).to_string();
        vec![self.row("camera", "yuyv to frame", times, error)]
    }

    fn tracking(&self) -> Vec<Row> {
        let lens = self.camera.lens();
        let wanted = [Wanted { family: Family::Tag36h11, id: Some(7), side_mm: 80.0 }];
        let mut tracker = Tracker::new(Default::default(), simd::best());
        let times = self.time(|frame| {
            tracker.find(frame.luma.view(), &lens, &wanted);
        });
        let (mut found, mut corners, mut turns, mut shifts) = (0, Vec::new(), Vec::new(), Vec::new());
        for frame in &self.frames {
            let truth = self.camera.truth(frame.sequence);
            let sightings = tracker.find(frame.luma.view(), &lens, &wanted);
            let Some((sighting, solved)) = sightings.iter().find_map(|s| s.pose.map(|p| (s, p))) else {
                continue;
            };
            found += 1;
            turns.push(solved.pose.angle_to(&truth).to_degrees());
            shifts.push(
                100.0 * (solved.pose.translation - truth.translation).length() / truth.translation.length(),
            );
            let square = [(-40.0, 40.0), (40.0, 40.0), (40.0, -40.0), (-40.0, -40.0)];
            for (corner, (x, y)) in sighting.corners.iter().zip(square) {
                let exact = lens.project(truth.apply(DVec3::new(x, y, 0.0)));
                corners.extend(exact.map(|exact| (*corner - exact).length()));
            }
        }
        let error = format!(
            "found {found}/{}; corners median {:.3} px; rotation {:.3}°, translation {:.3} % (medians)",
            self.frames.len(),
            median(&mut corners),
            median(&mut turns),
            median(&mut shifts)
        );
        vec![self.row("track", "tag36h11, full frame", times, error)]
    }

    fn raster(&self) -> Vec<Row> {
        let both = Needs::COLOR.and(Needs::DEPTH).and(Needs::NORMAL).and(Needs::SECOND_LAYER);
        let variants = [("smooth", Needs::COLOR.and(Needs::DEPTH)), ("both layers", both)];
        let mut rows = Vec::new();
        for name in crate::scene::BUILTIN {
            let Some((scene, placed, camera)) = view(name) else { continue };
            for (variant, needs) in variants {
                let mut renderer = Renderer::new(simd::best());
                let times = self.time(|_| {
                    renderer.restart();
                    renderer.draw(&scene, &placed, &camera, needs);
                });
                let layer = renderer.draw(&scene, &placed, &camera, needs);
                let error = ray_cast_error(&scene.models[0].mesh, &placed[0], &camera.lens, layer);
                rows.push(self.row("render", format!("{name}, {variant}"), times, error));
            }
        }
        rows
    }

    /// What settings may ask for before a style draws, the printed marker's exact pose given.
    fn retouch(&self) -> Vec<Row> {
        let (Some((scene, ..)), lens) = (view("teapot"), self.camera.lens()) else { return Vec::new() };
        let mark = |frame: &Frame| retouch::Mark {
            family: Family::Tag36h11,
            id: 7,
            side_mm: 80.0,
            pose: self.camera.truth(frame.sequence),
        };
        let mut rows = Vec::new();
        for table in ["steady", "hide", "light", "shadow"] {
            let Ok(config) = toml::from_str(&format!("{table} = {{}}")) else { continue };
            let mut retouch = retouch::Retouch::new(&config, &scene, simd::best());
            let times = self.time(|frame| {
                retouch.frame(frame, &scene, &[mark(frame)], &lens);
            });
            rows.push(self.row("retouch", table, times, String::new()));
        }
        rows
    }

    fn styles(&self) -> Vec<Row> {
        let mut rows = Vec::new();
        for &name in StyleName::value_variants() {
            let config = style::Config { name, ..style::Config::default() };
            let mut styler = Styler::new(&config, simd::best());
            let mut canvas = Rgb::new(self.camera.lens().size, [0; 3]);
            let times = self.time(|frame| styler.draw(StyleInput { frame, layer: None }, &mut canvas));
            // a first frame, as the reference draws it: styles may carry their pattern from frame to frame
            let frame = &self.frames[0];
            styler.restart();
            styler.draw(StyleInput { frame, layer: None }, &mut canvas);
            let error = Quality::of(&canvas, &style::reference(&config, &frame.color)).to_string();
            rows.push(self.row("style", name.to_string(), times, error));
        }
        rows
    }

    fn whole(&self) -> Vec<Row> {
        let mut rows = Vec::new();
        for &name in StyleName::value_variants() {
            let Ok((mut pipeline, _)) = demo::stage(name, 0) else { continue };
            let mut sink = Sink::Null;
            let mut stages: [Vec<Duration>; 5] = Default::default();
            let times = self.time(|frame| {
                let drawn = pipeline.draw_frame(frame);
                for stage in [Stage::Track, Stage::Render, Stage::Style] {
                    stages[stage as usize].push(drawn.timings.of(stage));
                }
                // the null sink cannot refuse
                let _ = sink.present(drawn.canvas);
            });
            rows.push(self.row("frame", format!("teapot, {name}"), times, "in → out".into()));
            for stage in [Stage::Track, Stage::Render, Stage::Style] {
                let times = Times::of(std::mem::take(&mut stages[stage as usize]));
                rows.push(self.row("", format!("  {}", stage.name()), times, String::new()));
            }
        }
        rows
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// A built-in model filling most of a 640x480 picture.
fn view(name: &str) -> Option<(Scene, Vec<Placed>, Camera)> {
    let table = format!("file = \"{name}\"\nmarker = {{ side_mm = 100 }}\n");
    let model = toml::from_str(&table).ok()?;
    let scene = Scene::build(&[model], &Default::default(), std::path::Path::new(".")).ok()?;
    let lens = Lens::guess(Size::new(640, 480));
    // marker z up becomes camera y up; look down a little
    let tilt = glam::DMat3::from_rotation_x(std::f64::consts::FRAC_PI_2 + 0.4);
    let to_camera = DAffine3 { matrix3: tilt, translation: DVec3::new(0.0, 18.0, 170.0) };
    let placed = vec![Placed { model: 0, to_camera: to_camera * scene.models[0].to_marker }];
    Some((scene, placed, Camera { lens, near: 10.0, far: 1e5 }))
}

/// Compares depth with exact f64 ray casting at a grid of pixels.
fn ray_cast_error(mesh: &Mesh, placed: &Placed, lens: &Lens, layer: &crate::frame::Layer) -> String {
    let at = |i: u32| placed.to_camera.transform_point3(mesh.positions[i as usize].as_dvec3());
    let triangles: Vec<[DVec3; 3]> = mesh.triangles.iter().map(|t| t.map(at)).collect();
    let (mut worst, mut pixels, mut differ) = (0.0f64, 0, 0);
    for y in (0..lens.size.height).step_by(23) {
        for x in (0..lens.size.width).step_by(19) {
            let ray = ((DVec2::new(x as f64, y as f64) - lens.center) / lens.focal).extend(1.0);
            let exact = triangles.iter().filter_map(|t| hit(ray, t)).fold(f64::INFINITY, f64::min);
            let drawn = f64::from(layer.depth.at(x, y));
            pixels += 1;
            if exact.is_finite() != drawn.is_finite() {
                differ += 1;
            } else if exact.is_finite() {
                worst = worst.max((drawn - exact).abs() / exact);
            }
        }
    }
    format!("depth {worst:.1e} relative, coverage {differ}/{pixels} (ray casting, unsnapped)")
}

/// Depth z at which a ray from the origin with z = 1 meets a triangle (Möller & Trumbore 1997).
fn hit(ray: DVec3, [a, b, c]: &[DVec3; 3]) -> Option<f64> {
    let (e1, e2) = (*b - *a, *c - *a);
    let p = ray.cross(e2);
    let det = e1.dot(p);
    let u = -a.dot(p) / det;
    let q = (-*a).cross(e1);
    let v = ray.dot(q) / det;
    let z = e2.dot(q) / det;
    (det != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && z > 0.0).then_some(z)
}
