//! `vernissage stylize`: pictures through a style, without a camera or models; also the styles' stopwatch.

use super::render::open_sink;
use super::{Failed, progress, say};
use crate::camera::{Clip, Grab};
use crate::frame::Frame;
use crate::kernel::interleave;
use crate::pixels::{Plane, Rgb, Size, picture, simd};
use crate::style::{self, StyleInput, StyleName, Styler};
use anyhow::{Context, bail, ensure};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::HashSet;
use std::io::{BufWriter, IsTerminal};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Endings of pictures that are read.
const PICTURES: [&str; 6] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm"];
/// Frames drawn before the stopwatch starts.
const WARM_UP: u32 = 3;

/// Draw pictures in a style
///
/// Reads PNG, JPEG and PGM/PPM pictures, or folders of them in name order, and writes PNG. One picture goes to
/// the file that --out names; several go to the folder that --out names, each under its own name.
///
/// Reads Y4M clips too (- is stdin) and writes every frame to a folder or, where --out ends in .y4m or is -,
/// to one clip; pictures and folders of one size can become a clip as well.
#[derive(clap::Args, Default)]
#[command(after_help = after_help())]
pub struct Args {
    /// Pictures, folders of pictures, or Y4M clips (- is stdin).
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The style.
    #[arg(long, value_enum, value_name = "S")]
    style: StyleName,
    /// Changes one setting of the style; may be given several times.
    #[arg(long, value_name = "key=value")]
    set: Vec<String>,
    /// Threads in use, 1 to 64.
    #[arg(long, default_value_t = 2, value_name = "N")]
    threads: usize,
    /// Where the result goes: a PNG file for one picture, a folder for several, NAME.y4m or - for a clip.
    #[arg(long, value_name = "FILE|DIR", required_unless_present_any = ["repeat", "stages"])]
    out: Option<PathBuf>,
    /// Also writes the style's intermediate planes there as NAME.npy (f32, rows x columns [x channels]); with
    /// several inputs each gets a folder of its name. cartoon: small S eS eA I; bilateral-cartoon: pyramid
    /// filtered edges; sketch-like: edges; watercolor: labels means response edge sites (and cells.svg: its cells as
    /// colored polygons); illustrative: response intensity halftone; sketchy: blur edge fx fy stroke_len (one a
    /// stroke) stroke_pts (points x 2); pointillism: grid.
    #[arg(long, value_name = "DIR")]
    stages: Option<PathBuf>,
    /// Draws every input this often, from scratch each time, and prints the times: interleaved RGB bytes in
    /// memory to interleaved RGB bytes in memory, after three warm-up frames.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    repeat: Option<u32>,
    /// Prints the times as one JSON object an input: {"image", "style", "threads", "ms": [...]}.
    #[arg(long, requires = "repeat")]
    json: bool,
}

/// Examples, and every style's settings as they are by default.
fn after_help() -> String {
    let mut text = String::from(
        "Examples:
  vernissage stylize --style cartoon photo.jpg --out cartoon.png
  vernissage stylize --style cartoon --set steps=9 --set beta=.5 photo.jpg --out bold.png
  vernissage stylize --style cartoon holiday/ --out holiday-cartoon/
  vernissage stylize --style cartoon clip.y4m --out cartoon.y4m
  vernissage stylize --style cartoon photo.jpg --repeat 100 --json      time it

Settings and their defaults (a value out of range is answered with the range):
",
    );
    for &style in StyleName::value_variants() {
        let settings = style::Config::defaults_of(style).join(", ");
        if !settings.is_empty() {
            text.push_str(&format!("  {style}: {settings}\n"));
        }
    }
    text.push_str(
        "
Files: sites (watercolor, N x 2: x, y) and starts (sketchy, N x 2) are .npy, as is grid (pointillism, N x 6: x, y, \
         radius, dr, dg, db in drawing order); sprite, brush and paper are gray pictures; paper takes true and false as \
         well. Stages of one run may be fed to the next. The result is the same for any number of threads and on any \
         processor.",
    );
    text
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let mut config = style::Config { name: args.style, ..Default::default() };
    for setting in &args.set {
        let Some((key, value)) = setting.split_once('=') else {
            bail!("--set {setting}: write it as key=value");
        };
        config.set(key.trim(), value.trim()).with_context(|| format!("--set {setting}"))?;
    }
    if args.inputs.iter().chain(&args.out).any(|path| is_clip(path)) {
        return film(&args, &config);
    }
    let pictures = expand(&args.inputs)?;
    let outputs = outputs(&args, &pictures)?;
    let pool = super::pool(args.threads)?;
    let quiet = pictures.len() < 2 || args.json || !std::io::stderr().is_terminal();
    let progress = if quiet { ProgressBar::hidden() } else { ProgressBar::new(pictures.len() as u64) };
    if let Ok(look) = ProgressStyle::with_template("{wide_bar} {pos}/{len} {eta}") {
        progress.set_style(look);
    }
    let mut job = Job::new(&config);
    for (path, output) in pictures.iter().zip(outputs) {
        let input = picture::read(path)?;
        pool.install(|| job.load(&input));
        if let Some(repeat) = args.repeat {
            let times = pool.install(|| job.time(repeat));
            report(&args, path, &times)?;
        }
        if let Some(folder) = &output.stages {
            pool.install(|| job.write_stages(folder))?;
        }
        if let Some(file) = &output.picture {
            let drawn = pool.install(|| job.draw());
            picture::write_png(file, drawn).context(Failed("cannot write the result"))?;
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

/// Whether `path` names a Y4M clip; `-` is one on stdin or stdout.
fn is_clip(path: &Path) -> bool {
    path == Path::new("-") || has_extension(path, &["y4m"])
}

/// Draws every frame of the inputs, one after another, into one clip or folder.
fn film(args: &Args, config: &style::Config) -> anyhow::Result<()> {
    ensure!(
        args.repeat.is_none() && args.stages.is_none(),
        "--repeat and --stages take pictures, not clips: give pictures or a folder of them"
    );
    let out = args.out.as_deref().context("--out: name a clip (NAME.y4m or -) or a folder")?;
    ensure!(
        !has_extension(out, &PICTURES),
        "{}: a clip has many frames; give --out a NAME.y4m, - or a folder",
        out.display()
    );
    let pool = super::pool(args.threads)?;
    let mut styler = Styler::new(config, simd::best());
    let (mut frame, mut canvas, mut sink) = (Frame::default(), Rgb::default(), None);
    let mut frames = 0;
    let bar = progress::bar(None, "frames");
    for input in &args.inputs {
        let mut clip = Clip::open(input, 30.0)?;
        pool.install(|| -> anyhow::Result<()> {
            while clip.next(&mut frame)? == Grab::Frame {
                frame.sequence = frames;
                canvas.resize(frame.size());
                styler.draw(StyleInput { frame: &frame, layer: None }, &mut canvas);
                let sink = match &mut sink {
                    Some(sink) => sink,
                    none => none.insert(open_sink(out, frame.size(), clip.fps())?),
                };
                sink.present(&canvas)?;
                frames += 1;
                bar.inc(1);
            }
            Ok(())
        })?;
    }
    bar.finish_and_clear();
    ensure!(frames > 0, "no frames came: is the clip empty?");
    Ok(())
}

/// The pictures behind the inputs: folders are replaced by the pictures in them, in name order.
fn expand(inputs: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut pictures = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            pictures.push(input.clone());
            continue;
        }
        let unreadable = || format!("{}: cannot read folder", input.display());
        let mut found = Vec::new();
        for entry in std::fs::read_dir(input).with_context(unreadable)? {
            let path = entry.with_context(unreadable)?.path();
            if has_extension(&path, &PICTURES) && path.is_file() {
                found.push(path);
            }
        }
        ensure!(!found.is_empty(), "{}: no PNG, JPEG or PGM/PPM pictures in this folder", input.display());
        found.sort();
        pictures.extend(found);
    }
    Ok(pictures)
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e.to_lowercase().as_str()))
}

/// Where one input's results go.
struct Output {
    picture: Option<PathBuf>,
    stages: Option<PathBuf>,
}

/// Names every result and makes the folders; two inputs of one name would overwrite each other and are refused.
fn outputs(args: &Args, pictures: &[PathBuf]) -> anyhow::Result<Vec<Output>> {
    let many = pictures.len() > 1 || args.inputs.iter().any(|input| input.is_dir());
    let into_folder = args.out.as_ref().is_some_and(|out| {
        let named = out.as_os_str().as_encoded_bytes().ends_with(b"/");
        many || named || out.is_dir()
    });
    if let Some(out) = args.out.as_deref().filter(|_| !into_folder) {
        let other = has_extension(out, &PICTURES) && !has_extension(out, &["png"]);
        ensure!(!other, "{}: only PNG is written; name it .png", out.display());
    }
    let make = |folder: &Path| {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot make folder", folder.display()))
            .context(Failed("cannot write the result"))
    };
    if into_folder && let Some(out) = &args.out {
        make(out)?;
    }
    let mut names = HashSet::new();
    let mut outputs = Vec::new();
    for picture in pictures {
        let stem = picture.file_stem().unwrap_or_default();
        let taken = !names.insert(stem.to_owned());
        ensure!(
            !taken || !(into_folder || (many && args.stages.is_some())),
            "{}: another input has the same name, so one result would overwrite the other; rename one",
            picture.display()
        );
        let file = args.out.as_ref().map(|out| match into_folder {
            true => out.join(stem).with_added_extension("png"),
            false => out.clone(),
        });
        let stages = args.stages.as_ref().map(|folder| if many { folder.join(stem) } else { folder.clone() });
        if let Some(folder) = &stages {
            make(folder)?;
        }
        outputs.push(Output { picture: file, stages });
    }
    Ok(outputs)
}

/// Prints one input's times.
fn report(args: &Args, path: &Path, times: &[f64]) -> anyhow::Result<()> {
    if args.json {
        let rounded: Vec<f64> = times.iter().map(|ms| (ms * 1e4).round() / 1e4).collect();
        say(serde_json::json!({
            "image": path.to_string_lossy(),
            "style": args.style.name(),
            "threads": args.threads,
            "ms": rounded,
        }))
    } else {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (least, middle) = (sorted.first().copied(), sorted.get(sorted.len() / 2).copied());
        let (least, middle) = (least.unwrap_or(0.0), middle.unwrap_or(0.0));
        say(format_args!("{}: {least:.2} ms at best, {middle:.2} ms in the middle", path.display()))
    }
}

/// One style and the buffers of one picture on its way through it.
struct Job {
    config: style::Config,
    level: simd::Level,
    styler: Styler,
    size: Size,
    input: Vec<u8>,
    output: Vec<u8>,
    frame: Frame,
    canvas: Rgb,
}

impl Job {
    fn new(config: &style::Config) -> Self {
        let level = simd::best();
        Self {
            config: config.clone(),
            level,
            styler: Styler::new(config, level),
            size: Size::new(0, 0),
            input: Vec::new(),
            output: Vec::new(),
            frame: Frame::default(),
            canvas: Rgb::default(),
        }
    }

    /// Takes a picture as interleaved bytes, as a decoder would leave it.
    fn load(&mut self, picture: &Rgb) {
        self.size = picture.size();
        self.input.resize(3 * self.size.area(), 0);
        self.output.resize(3 * self.size.area(), 0);
        interleave::join(self.level, picture, &mut self.input);
    }

    /// One frame: interleaved bytes in, interleaved bytes out.
    fn frame(&mut self) {
        self.draw();
        interleave::join(self.level, &self.canvas, &mut self.output);
    }

    fn draw(&mut self) -> &Rgb {
        self.frame.resize(self.size);
        interleave::split(self.level, &self.input, self.size, &mut self.frame.color);
        self.styler.restart();
        self.styler.draw(StyleInput { frame: &self.frame, layer: None }, &mut self.canvas);
        &self.canvas
    }

    /// Milliseconds of each of `repeat` frames, after the warm-up.
    fn time(&mut self, repeat: u32) -> Vec<f64> {
        (0..WARM_UP).for_each(|_| self.frame());
        let mut times = Vec::with_capacity(repeat as usize);
        for _ in 0..repeat {
            let start = Instant::now();
            self.frame();
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times
    }

    fn write_stages(&mut self, folder: &Path) -> anyhow::Result<()> {
        self.draw();
        let input = StyleInput { frame: &self.frame, layer: None };
        let (config, level, out) = (&self.config, self.level, &mut self.canvas);
        let mut lists: Vec<(&str, Vec<f32>)> = Vec::new();
        let planes: Vec<(&str, Vec<Plane<f32>>)> = match config.name {
            StyleName::Plain => bail!("style plain has no stages"),
            StyleName::Cartoon => {
                let stages = style::cartoon::Cartoon::new(config.cartoon, level).stages(input, out);
                vec![
                    ("small", stages.small.into()),
                    ("S", stages.simplified.into()),
                    ("eS", vec![stages.edge_s]),
                    ("eA", vec![stages.edge_a]),
                    ("I", vec![stages.lines]),
                ]
            }
            StyleName::BilateralCartoon => {
                let mut style = style::bilateral::BilateralCartoon::new(config.bilateral_cartoon, level);
                let stages = style.stages(input, out);
                vec![
                    ("pyramid", stages.pyramid.into()),
                    ("filtered", stages.filtered.into()),
                    ("edges", vec![stages.edges]),
                ]
            }
            StyleName::SketchLike => {
                let mut style = style::bilateral::SketchLike::new(config.sketch_like, level);
                vec![("edges", vec![style.edges(input, out)])]
            }
            StyleName::Watercolor => {
                let config = config.watercolor.clone();
                let stages = style::watercolor::Watercolor::new(config, level).stages(input, out);
                let file = folder.join("cells.svg");
                let drawing = style::watercolor::cells::svg(&stages.cells, &stages.means, self.size);
                std::fs::write(&file, drawing)
                    .with_context(|| format!("{}: cannot write the cells", file.display()))
                    .context(Failed("cannot write the stages"))?;
                vec![
                    ("labels", vec![stages.labels]),
                    ("means", vec![stages.means]),
                    ("response", vec![stages.response]),
                    ("edge", vec![stages.edge]),
                    ("sites", vec![stages.sites]),
                ]
            }
            StyleName::Illustrative => {
                let config = config.illustrative;
                let stages = style::illustrative::Illustrative::new(config, level).stages(input, out);
                vec![
                    ("response", vec![stages.response]),
                    ("intensity", vec![stages.intensity]),
                    ("halftone", vec![stages.halftone]),
                ]
            }
            StyleName::Pointillism => {
                let style = style::pointillism::Pointillism::new(config.pointillism.clone(), level);
                vec![("grid", vec![style.grid(self.size)])]
            }
            StyleName::Sketchy => {
                let config = config.sketchy.clone();
                let stages = style::sketchy::Sketchy::new(config, level).stages(input, out);
                lists.push(("stroke_len", stages.stroke_len));
                vec![
                    ("blur", stages.blur.into()),
                    ("edge", vec![stages.edge]),
                    ("fx", vec![stages.fx]),
                    ("fy", vec![stages.fy]),
                    ("stroke_pts", vec![stages.stroke_pts]),
                ]
            }
        };
        let write = |name: &str, shape: &[u64], values: &mut dyn Iterator<Item = f32>| {
            let file = folder.join(name).with_added_extension("npy");
            write_npy(&file, shape, values)
                .with_context(|| format!("{}: cannot write stage", file.display()))
                .context(Failed("cannot write the stages"))
        };
        for (name, list) in &lists {
            write(name, &[list.len() as u64], &mut list.iter().copied())?;
        }
        for (name, planes) in &planes {
            let size = planes.first().map_or(Size::new(0, 0), Plane::size);
            let shape = [size.height as u64, size.width as u64, planes.len() as u64];
            let pixels = (0..size.area()).map(|i| (i % size.width, i / size.width));
            let mut values = pixels.flat_map(|(x, y)| planes.iter().map(move |plane| plane.at(x, y)));
            // one plane has no channel axis
            write(name, if planes.len() > 1 { &shape } else { &shape[..2] }, &mut values)?;
        }
        Ok(())
    }
}

fn write_npy(path: &Path, shape: &[u64], values: &mut dyn Iterator<Item = f32>) -> std::io::Result<()> {
    use npyz::WriterBuilder;
    let file = BufWriter::new(std::fs::File::create(path)?);
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(file).begin_nd()?;
    writer.extend(values)?;
    writer.finish()
}
