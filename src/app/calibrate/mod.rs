//! `vernissage calibrate`: the camera's lens from pictures of a printed sheet of markers.

mod observe;
mod plot;

use super::config::{Config, ConfigError};
use super::sheet::columns_rows;
use super::{Failed, pool, say};
use crate::calibration::{self, Calibration, LensConfig, PARTS, View};
use crate::geometry::Lens;
use crate::marker::{Board, Family, Grid};
use crate::pixels::Size;
use crate::scene::Scene;
use anyhow::{Context, ensure};
use observe::{choose, observe, others};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Finds the lens of a camera from pictures of a flat sheet of markers.
///
/// Print `vernissage sheet --board`, glue it flat, film it or take 15 pictures and more: tilted by 30 degrees and more to
/// every side, near and far, and in the corners of the picture. The corners of all markers are aligned to a fraction of a
/// pixel; focal lengths, principal point and distortion (k1 k2 p1 p2 k3) come with their uncertainty. Leaves NAME.toml
/// (for `file` in a visor file's [lens] table, or --lens), NAME.yaml (OpenCV), NAME.ros.yaml (ROS) and NAME.svg (how far
/// off every corner is).
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage calibrate pictures/\n  \
    vernissage calibrate film.y4m --out left-camera\n  \
    vernissage calibrate pictures/ --board 4x5 --family aruco_5x5_100\n  \
    vernissage calibrate pictures/ --config visor.toml        the visor file's first [[board]] is the sheet")]
pub struct Args {
    /// Folder of pictures, or a Y4M clip
    #[arg(value_name = "CLIP|DIR")]
    input: PathBuf,
    /// The sheet's prints, columns x rows, as given to `vernissage sheet --board`
    #[arg(long, default_value = "5x7", value_name = "CxR", value_parser = columns_rows)]
    board: [u32; 2],
    /// Family of the sheet's markers
    #[arg(long, default_value = "tag36h11", value_name = "F", value_parser = Family::from_name)]
    family: Family,
    /// Number of the sheet's first marker
    #[arg(long, default_value_t = 0, value_name = "ID")]
    first: u32,
    /// Side of the sheet's black squares, mm: for the distances told, the lens does not depend on it
    #[arg(long, default_value_t = 30.5, value_name = "MM")]
    side_mm: f64,
    /// Visor file whose first [[board]] is the sheet
    #[arg(long, value_name = "FILE", conflicts_with_all = ["board", "family", "first", "side_mm"])]
    config: Option<PathBuf>,
    /// Most pictures that are used, those that differ most
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = clap::value_parser!(u16).range(3..=500))]
    views: u16,
    /// What the written files are called, without ending
    #[arg(long, default_value = "lens", value_name = "NAME")]
    out: PathBuf,
    /// Threads that compute
    #[arg(long, default_value_t = 2, value_name = "N")]
    threads: usize,
    /// Print the result as one JSON object
    #[arg(long)]
    json: bool,
}

/// How often the markers are aligned anew through the lens found so far.
const PASSES: usize = 2;

pub fn run(args: Args) -> anyhow::Result<()> {
    let board = sheet(&args)?;
    ensure!(args.input != Path::new("-"), "the pictures are looked at several times: give a file, not stdin");
    let (solved, counts) = pool(args.threads)?.install(|| solve(&args, &board))?;
    let files = write(&args.out, &solved)?;
    if args.json { say(json(&solved, &counts)) } else { report(&solved, &counts, &files) }
}

/// The sheet as told.
fn sheet(args: &Args) -> anyhow::Result<Board> {
    if let Some(path) = &args.config {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Read { path: path.clone(), source })?;
        let config = Config::parse(&text, path)?;
        let first = config.board.get(..1).with_context(|| {
            format!("{}: no [[board]] in it; `vernissage sheet --board` prints one", path.display())
        })?;
        let board = Scene::default().on_boards(first)?.boards.remove(0);
        let flat = board.prints.iter().all(|print| {
            print.to_board.translation.z == 0.0 && (print.to_board.rotation.z_axis.z - 1.0).abs() < 1e-9
        });
        ensure!(flat, "{}: its first [[board]] is not flat; give --board", path.display());
        return Ok(board);
    }
    ensure!(
        args.side_mm.is_finite() && args.side_mm > 0.0,
        "--side-mm {}: give a number above 0",
        args.side_mm
    );
    let [columns, rows] = args.board;
    let grid = Grid { family: args.family, first: args.first, columns, rows, side_mm: args.side_mm };
    grid.board().with_context(|| {
        format!(
            "--board {columns}x{rows} from id {}: {} has {} codes",
            args.first,
            args.family.name(),
            args.family.codes().len()
        )
    })
}

/// How many pictures there were, and which are used.
struct Counts {
    pictures: u64,
    seen: u64,
    numbers: Vec<u64>,
}

/// Finds, chooses, solves; then aligns the markers anew through that lens, and solves again.
fn solve(args: &Args, board: &Board) -> anyhow::Result<(Calibration, Counts)> {
    let path = &args.input;
    let all = observe(path, board, None, None)?;
    let numbers = choose(&all.views, all.size, usize::from(args.views));
    let mut solved = solution(path, &all.views, &numbers, all.size, all.pictures)
        .map_err(|error| explained(error, &all.seen, path, board))?;
    for _ in 0..PASSES {
        let again = observe(path, board, Some(&solved.lens), Some(&numbers))?;
        solved = solution(path, &again.views, &numbers, again.size, all.pictures)?;
    }
    Ok((solved, Counts { pictures: all.pictures, seen: all.seen, numbers }))
}

fn solution(
    path: &Path,
    views: &BTreeMap<u64, View>,
    numbers: &[u64],
    size: Size,
    pictures: u64,
) -> anyhow::Result<Calibration> {
    let chosen: Vec<View> = numbers.iter().map(|n| views.get(n).cloned().unwrap_or_default()).collect();
    calibration::solve(&chosen, size)
        .with_context(|| format!("{}: {pictures} pictures do not tell the lens", path.display()))
}

/// The error, with the likely mistake where no marker of the sheet was seen.
fn explained(error: anyhow::Error, seen: &u64, path: &Path, board: &Board) -> anyhow::Error {
    match (seen, others(path, board)) {
        (0, Some(family)) => {
            anyhow::anyhow!(
                "{}: the pictures show {1} markers: give --family {1}",
                path.display(),
                family.name()
            )
        }
        _ => error,
    }
}

/// Writes the four files; says which.
fn write(out: &Path, solved: &Calibration) -> anyhow::Result<Vec<PathBuf>> {
    ensure!(
        out.file_name().is_some(),
        "--out {}: give a name for the files, such as left-camera",
        out.display()
    );
    let lens = LensConfig::of(&solved.lens);
    let name = out.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let remark = format!(
        "calibrated from {} pictures, RMS {:.3} px; --lens FILE, or in a visor file: [lens] file = \"{name}.toml\"",
        solved.views.len(),
        solved.rms_px
    );
    let mut files = Vec::new();
    for (ending, text) in [
        (".toml", lens.to_toml(&remark)),
        (".yaml", lens.to_opencv(solved.rms_px)),
        (".ros.yaml", lens.to_ros(&name)),
        (".svg", plot::svg(solved)),
    ] {
        let mut path = out.as_os_str().to_owned();
        path.push(ending);
        let path = PathBuf::from(path);
        std::fs::write(&path, text)
            .with_context(|| format!("{}: cannot write; choose another --out", path.display()))
            .context(Failed("cannot write the calibration"))?;
        files.push(path);
    }
    Ok(files)
}

/// Name, value and deviation of the lens's numbers.
fn numbers(solved: &Calibration) -> Vec<(&'static str, f64, f64)> {
    let Lens { focal, center, distortion: k, .. } = solved.lens;
    let names = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];
    let values = [focal.x, focal.y, center.x, center.y, k[0], k[1], k[2], k[3], k[4]];
    names.into_iter().zip(values).zip(solved.deviations).map(|((name, v), d)| (name, v, d)).collect()
}

fn report(solved: &Calibration, counts: &Counts, files: &[PathBuf]) -> anyhow::Result<()> {
    let corners: usize = solved.views.iter().map(|view| view.misses.len()).sum();
    say(format_args!(
        "pictures    {} of {} used, the sheet seen in {}; {corners} corners, {} far off and weighed down",
        solved.views.len(),
        counts.pictures,
        counts.seen,
        solved.outliers
    ))?;
    say(format_args!("RMS         {:.4} px, pictures of {}", solved.rms_px, solved.lens.size))?;
    let tilt = solved.views.iter().map(|view| view.tilt_deg);
    say(format_args!(
        "coverage    {} of {} parts of the picture; sheet tilted {:.0}° to {:.0}°",
        solved.parts,
        PARTS[0] * PARTS[1],
        tilt.clone().fold(f64::INFINITY, f64::min),
        tilt.fold(0.0, f64::max)
    ))?;
    say(format_args!("\n            value   one deviation"))?;
    for (name, value, deviation) in numbers(solved) {
        let digits = if name.starts_with(['f', 'c']) { 3 } else { 6 };
        say(format_args!("{name:<4} {value:>12.digits$} {deviation:>15.digits$}"))?;
    }
    say(format_args!("\npicture  corners   RMS px   tilt   distance"))?;
    for view in &solved.views {
        say(format_args!(
            "{:>7} {:>8} {:>8.4} {:>5.0}° {:>7.0} mm",
            counts.numbers.get(view.index).copied().unwrap_or_default(),
            view.misses.len(),
            view.rms_px,
            view.tilt_deg,
            view.pose.translation.length()
        ))?;
    }
    let files: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
    say(format_args!("\nwritten     {}", files.join(", ")))?;
    if solved.parts < PARTS[0] * PARTS[1] * 3 / 4 {
        log::warn!(
            "parts of the picture were not seen: distortion is guessed there; add pictures of the corners"
        );
    }
    Ok(())
}

fn json(solved: &Calibration, counts: &Counts) -> serde_json::Value {
    let of = |pick: fn(&(&'static str, f64, f64)) -> f64| -> serde_json::Map<String, serde_json::Value> {
        numbers(solved).iter().map(|number| (number.0.to_string(), pick(number).into())).collect()
    };
    let views: Vec<_> = solved
        .views
        .iter()
        .map(|view| {
            serde_json::json!({
                "picture": counts.numbers.get(view.index), "corners": view.misses.len(), "rms_px": view.rms_px,
                "tilt_deg": view.tilt_deg, "distance_mm": view.pose.translation.length(),
            })
        })
        .collect();
    serde_json::json!({
        "width": solved.lens.size.width, "height": solved.lens.size.height, "rms_px": solved.rms_px,
        "lens": of(|number| number.1), "deviation": of(|number| number.2), "pictures": counts.pictures,
        "outliers": solved.outliers, "parts": [solved.parts, PARTS[0] * PARTS[1]], "views": views,
    })
}
