//! `vernissage demo`: the main job on the synthetic camera, and one sheet of pictures to look at.

use super::config::Config;
use super::report::{machine, ms};
use super::{Failed, pool, say};
use crate::camera::{Synthetic, SyntheticConfig};
use crate::display::Sink;
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::pipeline::{Pipeline, Record, Stage};
use crate::pixels::{Rgb, Size, picture, simd};
use crate::scene::Scene;
use crate::style::StyleName;
use anyhow::Context;
use clap::ValueEnum;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Shows the main job without a camera: a teapot on a printed marker, tracked, drawn and restyled.
///
/// Plays a clip of a table with a printed marker, drawn by the program itself with exact truth, through the
/// whole pipeline, and prints frames per second, tracking, pose error and the time of every stage. Leaves
/// DIR/sheet.png: one moment as the camera's picture, as conventional AR, and in every style.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  vernissage demo\n  vernissage demo --style plain --frames 30 --out /tmp/demo"
)]
pub struct Args {
    /// Folder for the pictures
    #[arg(long, default_value = "demo", value_name = "DIR")]
    out: PathBuf,
    /// Style of the measured frames
    #[arg(long, default_value = "cartoon", value_name = "S")]
    style: StyleName,
    /// Frames to play, from 1
    #[arg(long, default_value_t = 240, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    frames: u64,
    /// Threads that compute
    #[arg(long, default_value_t = 2, value_name = "N")]
    threads: usize,
}

impl Default for Args {
    fn default() -> Self {
        Self { out: "demo".into(), style: StyleName::Cartoon, frames: 240, threads: 2 }
    }
}

/// Pictures in a row of the sheet.
const COLUMNS: usize = 3;
/// Frames that lead up to the sheet's moment: styles may carry their pattern from frame to frame.
const LEAD: u64 = 4;

pub fn run(args: Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot make this folder", args.out.display()))
        .context(Failed("cannot write the pictures"))?;
    pool(args.threads)?.install(|| play(&args))
}

/// The demo's scene in this style: the pipeline and its camera, both of the demo's settings.
pub fn stage(style: StyleName, frames: u64) -> anyhow::Result<(Pipeline, Synthetic)> {
    let text = include_str!("demo.toml");
    let mut config = Config::parse(text, Path::new("demo.toml"))?;
    config.style.name = style;
    let scene = Scene::build(&config.model, &config.light, Path::new("."))?;
    let settings = SyntheticConfig { frames, ..config.camera.synthetic.clone() };
    let size = Size::new(config.camera.width, config.camera.height);
    let camera = Synthetic::new(&settings, size, 30.0, simd::best());
    let pipeline = Pipeline::new(scene, camera.lens(), config.track, &config.style, simd::best());
    Ok((pipeline, camera))
}

/// What the run gathers.
struct Tally {
    stages: [Record; 5],
    latency: Record,
    rotation_deg: Vec<f64>,
    translation_percent: Vec<f64>,
    shown: u64,
    tracked: u64,
    spent: Duration,
}

fn play(args: &Args) -> anyhow::Result<()> {
    let (mut pipeline, mut camera) = stage(args.style, args.frames)?;
    let mut sink = Sink::Null;
    let mut frame = Frame::default();
    let moment = args.frames / 2;
    let mut kept: Vec<Frame> = Vec::new();
    let mut tally = Tally {
        stages: std::array::from_fn(|_| Record::new(args.frames as usize)),
        latency: Record::new(args.frames as usize),
        rotation_deg: Vec::new(),
        translation_percent: Vec::new(),
        shown: 0,
        tracked: 0,
        spent: Duration::ZERO,
    };
    let bar = super::progress::bar(Some(args.frames), "frames");
    loop {
        let fetch = Instant::now();
        if !camera.next(&mut frame) {
            break;
        }
        tally.stages[Stage::Camera as usize].push(fetch.elapsed());
        let arrived = Instant::now();
        let mut drawn = pipeline.draw_frame(&frame);
        let timings = &mut drawn.timings;
        timings
            .measure(Stage::Show, || sink.present(drawn.canvas))
            .context(Failed("cannot show the picture"))?;
        tally.spent += arrived.elapsed();
        tally.latency.push(arrived.elapsed());
        for stage in Stage::ALL.into_iter().skip(1) {
            tally.stages[stage as usize].push(timings.of(stage));
        }
        if camera.shows_marker(frame.sequence) {
            tally.shown += 1;
            if let Some(pose) = drawn.sightings.iter().find_map(|s| s.pose) {
                tally.tracked += 1;
                tally.compare(&pose.pose, &camera.truth(frame.sequence));
            }
        }
        if (moment.saturating_sub(LEAD)..=moment).contains(&frame.sequence) {
            kept.push(frame.clone());
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    drop(pipeline);
    let path = args.out.join("sheet.png");
    picture::write_png(&path, &contact_sheet(&kept)?).context(Failed("cannot write the sheet"))?;
    tally.print(args, camera.lens().size, &path)
}

/// The last of the frames as it came and in every style, in rows.
fn contact_sheet(frames: &[Frame]) -> anyhow::Result<Rgb> {
    let last = frames.last().context("the clip has no frames")?;
    let styles = StyleName::value_variants();
    let mut sheet = Sheet::new(last.size(), 1 + styles.len());
    sheet.add(&last.color);
    for &style in styles {
        let (mut pipeline, _) = stage(style, 0)?;
        for frame in &frames[..frames.len() - 1] {
            pipeline.draw_frame(frame);
        }
        sheet.add(pipeline.draw_frame(last).canvas);
    }
    Ok(sheet.picture)
}

impl Tally {
    fn compare(&mut self, pose: &Pose, truth: &Pose) {
        self.rotation_deg.push(pose.angle_to(truth).to_degrees());
        let miss = (pose.translation - truth.translation).length();
        self.translation_percent.push(100.0 * miss / truth.translation.length());
    }

    fn print(&mut self, args: &Args, size: Size, path: &Path) -> anyhow::Result<()> {
        let frames = self.latency.count();
        let style = args.style;
        say(format_args!("{}, {} threads, {size}, style {style}", machine(), args.threads))?;
        let rate = frames as f64 / self.spent.as_secs_f64().max(1e-9);
        say(format_args!(
            "frames      {frames}, {rate:.0} frames/s (the synthetic camera's own drawing not counted)"
        ))?;
        say(format_args!("tracked     {} of {} frames that show the marker", self.tracked, self.shown))?;
        let (rotation, translation) = (spread(&mut self.rotation_deg), spread(&mut self.translation_percent));
        say(format_args!("pose error  rotation median {:.3}°, max {:.3}°", rotation.0, rotation.1))?;
        say(format_args!(
            "            translation median {:.3} %, max {:.3} % of the distance",
            translation.0, translation.1
        ))?;
        say(format_args!("\nstage      median ms    p99 ms"))?;
        for stage in Stage::ALL {
            let record = &self.stages[stage as usize];
            say(format_args!(
                "{:<9} {:>10} {:>9}",
                stage.name(),
                ms(record.percentile(0.5)),
                ms(record.percentile(0.99))
            ))?;
        }
        let latency = &self.latency;
        say(format_args!(
            "{:<9} {:>10} {:>9}",
            "in → out",
            ms(latency.percentile(0.5)),
            ms(latency.percentile(0.99))
        ))?;
        say(format_args!(
            "\npicture     {} (one moment: the camera's picture, then {})",
            path.display(),
            StyleName::value_variants().iter().map(|style| style.name()).collect::<Vec<_>>().join(", ")
        ))
    }
}

/// Median and maximum; zeros when empty.
fn spread(values: &mut [f64]) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let median = values.get(values.len() / 2).copied().unwrap_or_default();
    (median, values.last().copied().unwrap_or_default())
}

/// Pictures of one size side by side on white.
struct Sheet {
    picture: Rgb,
    cell: Size,
    count: usize,
}

/// White between and around the sheet's pictures, px.
const MARGIN: usize = 12;

impl Sheet {
    fn new(cell: Size, pictures: usize) -> Self {
        let size = |count: usize, side: usize| count * (side + MARGIN) + MARGIN;
        let whole = Size::new(size(COLUMNS, cell.width), size(pictures.div_ceil(COLUMNS), cell.height));
        Self { picture: Rgb::new(whole, [250; 3]), cell, count: 0 }
    }

    fn add(&mut self, picture: &Rgb) {
        let left = MARGIN + self.count % COLUMNS * (self.cell.width + MARGIN);
        let top = MARGIN + self.count / COLUMNS * (self.cell.height + MARGIN);
        for (to, from) in self.picture.planes.iter_mut().zip(&picture.planes) {
            for y in 0..self.cell.height {
                to.row_mut(top + y)[left..][..self.cell.width].copy_from_slice(from.row(y));
            }
        }
        self.count += 1;
    }
}
