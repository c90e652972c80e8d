//! `vernissage render`: the same pipeline offline, every frame, into a clip or a folder.

use super::config::{Config, Loaded};
use super::{Failed, logging, pool, progress, say};
use crate::camera::{self, Grab, Source};
use crate::display::{self, Sink};
use crate::frame::{Frame, Sighting};
use crate::pipeline::{Drawn, Pipeline};
use crate::pixels::{Size, simd};
use anyhow::{Context, ensure};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Draws every frame of a clip, a folder of pictures or a trace as the visor would.
///
/// Without --input the scene file's camera is used, which must end by itself. Pictures of a folder may differ
/// in size when --out is a folder. With --trace the pictures that `run --trace` recorded are drawn again, and
/// each is compared with what the display showed.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    vernissage render --config scene.toml --input photos/ --out drawn/\n  \
    vernissage render --config scene.toml --input clip.y4m --out styled.y4m\n  \
    ffmpeg -i film.mp4 -f yuv4mpegpipe - | vernissage render --config scene.toml --input - --out - | mpv -")]
pub struct Args {
    /// Scene or visor file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Clip (Y4M, `-` = stdin), picture or folder of pictures instead of the scene's camera
    #[arg(long, value_name = "CLIP", conflicts_with = "trace")]
    input: Option<PathBuf>,
    /// Trace that `run --trace` wrote
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Clip (NAME.y4m, `-` = stdout) or folder
    #[arg(long, value_name = "CLIP|DIR")]
    out: PathBuf,
    /// Threads that compute instead of the file's
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// One JSON object a frame on stdout: the markers found and how many models were drawn
    #[arg(long)]
    json: bool,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let Loaded { config, scene } = Loaded::read(&args.config)?;
    let camera = input(&args, &config);
    ensure!(
        !(args.json && args.out == Path::new("-")),
        "--json and --out - both want stdout: write to a file"
    );
    ensure!(
        camera.source != camera::Kind::V4l2,
        "{}: its camera never ends; give --input or --trace",
        args.config.display()
    );
    ensure!(
        camera.source != camera::Kind::Synthetic || camera.synthetic.frames > 0,
        "{}: its camera never ends; set camera.synthetic.frames, or give --input or --trace",
        args.config.display()
    );
    let source = Source::open(&camera)?;
    let threads = args.threads.unwrap_or(config.threads());
    let mut pipeline = {
        let lens = source.lens().unwrap_or(config.lens(source.size()).0);
        Pipeline::new(scene, lens, config.track.clone(), &config.style, simd::best())
            .retouched(&config.retouch)
    };
    let replayed = pool(threads)?.install(|| draw_all(source, &mut pipeline, &config, &args))?;
    match replayed {
        Some((same, all)) if same < all => {
            Err(anyhow::anyhow!("{} of {all} frames differ from what was shown", all - same))
                .context(Failed("the replay differs"))
        }
        _ => Ok(()),
    }
}

/// The camera settings of this call.
fn input(args: &Args, config: &Config) -> camera::Config {
    let mut camera = config.camera.clone();
    if let Some(path) = args.input.as_ref().or(args.trace.as_ref()) {
        camera.source = if args.trace.is_some() { camera::Kind::Trace } else { camera::Kind::Clip };
        camera.path = path.clone();
    }
    camera
}

/// Where pictures go: a name that ends in .y4m (or `-`) is a clip, any other a folder.
pub(super) fn open_sink(out: &Path, size: Size, fps: f64) -> anyhow::Result<Sink> {
    let clip = out == Path::new("-") || out.extension().is_some_and(|e| e.eq_ignore_ascii_case("y4m"));
    let sink = if clip { display::Kind::Y4m } else { display::Kind::Png };
    Ok(Sink::open(
        &display::Config {
            sink,
            path: Some(out.into()),
            fps: fps.round() as u32,
            ..display::Config::default()
        },
        size,
    )?)
}

/// Draws all frames; for a trace, how many of how many equal what was shown.
fn draw_all(
    mut source: Source,
    pipeline: &mut Pipeline,
    config: &Config,
    args: &Args,
) -> anyhow::Result<Option<(u64, u64)>> {
    let mut sink = None;
    let mut frame = Frame::default();
    let (mut frames, mut with_model, mut same, mut compared) = (0u64, 0u64, 0u64, 0u64);
    let mut size = Size::new(0, 0);
    let bar = progress::bar(source.frames(), "frames");
    while let Grab::Frame = source.next(&mut frame, Duration::from_secs(10))? {
        if frame.size() != size {
            size = frame.size();
            let (lens, warning) = match source.lens() {
                Some(exact) => (exact, None),
                None => config.lens(size),
            };
            if let Some(warning) = warning {
                log::warn!("{warning}");
            }
            pipeline.set_lens(lens);
        }
        let drawn = pipeline.draw_frame(&frame);
        let sink = match &mut sink {
            Some(sink) => sink,
            none => none.insert(open_sink(&args.out, size, source.fps().unwrap_or(30.0))?),
        };
        sink.present(drawn.canvas)?;
        if args.json {
            say(line(frames, &drawn))?;
        }
        frames += 1;
        with_model += u64::from(drawn.models > 0);
        if let Some(entry) = source.recorded() {
            compared += 1;
            let [width, height] = entry.mode.map(|v| v as usize);
            let screen = display::compose(drawn.canvas, Size::new(width, height), config.display.layout());
            same += u64::from(screen.hash() == entry.shown_hash);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    ensure!(frames > 0, "no frames came: is the clip or folder empty?");
    logging::line(format_args!("{frames} frames drawn, {with_model} with a model"));
    if compared > 0 {
        logging::line(format_args!("replay: {same} of {compared} shown frames identical"));
    }
    Ok((compared > 0).then_some((same, compared)))
}

/// A frame's line of `--json`.
fn line(frame: u64, drawn: &Drawn<'_>) -> serde_json::Value {
    let marker = |s: &Sighting| {
        serde_json::json!({
            "family": s.family.name(), "id": s.id, "corners": s.corners.map(|c| c.to_array()),
            "hamming": s.hamming, "posed": s.pose.is_some(),
        })
    };
    let markers: Vec<_> = drawn.sightings.iter().map(marker).collect();
    serde_json::json!({ "frame": frame, "models": drawn.models, "markers": markers })
}
