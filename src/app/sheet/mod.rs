//! `vernissage sheet`: markers to print, in their true size.

mod page;
mod pdf;
mod svg;

use super::{Failed, say};
use crate::marker::{Family, Grid};
use anyhow::{Context, bail, ensure};
use clap::ValueEnum;
use page::{Hold, Page, TEXT};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Makes pages of markers to print: true size, vectors, with quiet zones, cut marks and a ruler.
///
/// Without options: sheet.pdf, one A4 page of four tag36h11 markers, 80 mm wide. Print it at 100 % (not "fit to page"),
/// then lay a rule on the printed one. With --board the prints stay together: a sheet to calibrate the camera with, and
/// a board whose prints share one pose; its `[[board]]` table for the visor file is printed.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage sheet\n  \
    vernissage sheet --ids 0-11 --side-mm 50 --paper letter --out markers.pdf\n  \
    vernissage sheet --family aruco_4x4_50 --ids 7 --side-mm 150 --out seven.svg\n  \
    vernissage sheet --board --out board.pdf        for `vernissage calibrate`")]
pub struct Args {
    /// File to write: .pdf, or .svg (a file a page: NAME-2.svg and so on)
    #[arg(long, default_value = "sheet.pdf", value_name = "FILE")]
    out: PathBuf,
    /// Marker family: tag36h11, aruco_4x4_50 and others
    #[arg(long, default_value = "tag36h11", value_name = "F", value_parser = Family::from_name)]
    family: Family,
    /// Numbers of the markers, such as 7 or 0-5,9; left out: as many as a page holds, from 0. With --board: the first
    #[arg(long, value_name = "LIST")]
    ids: Option<String>,
    /// Side of the black square, mm; left out: 80, with --board as large as the page takes
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    side_mm: Option<f64>,
    /// Size of the paper
    #[arg(long, value_enum, default_value_t = Paper::A4, value_name = "P")]
    paper: Paper,
    /// Paper lies on its long side
    #[arg(long)]
    landscape: bool,
    /// One board of prints: columns x rows, 5x7 if not said
    #[arg(long, value_name = "CxR", num_args = 0..=1, default_missing_value = "5x7", value_parser = columns_rows)]
    board: Option<[u32; 2]>,
}

/// Sizes of paper.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Paper {
    A4,
    A3,
    Letter,
}

impl Paper {
    /// Width and height upright, mm.
    fn size(self) -> [f64; 2] {
        match self {
            Paper::A4 => [210.0, 297.0],
            Paper::A3 => [297.0, 420.0],
            Paper::Letter => [215.9, 279.4],
        }
    }

    fn name(self) -> &'static str {
        match self {
            Paper::A4 => "a4",
            Paper::A3 => "a3",
            Paper::Letter => "letter",
        }
    }
}

/// What printers leave white, mm.
const MARGIN: f64 = 5.0;
/// Height of the ruler with its text, mm.
const RULER: f64 = 16.0;
/// Height of the text under a marker, mm.
const LABEL: f64 = 5.0;
/// Most markers of one call.
const MOST: usize = 2000;

/// Columns and rows, such as 5x7.
pub fn columns_rows(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=40).contains(n));
    let sides = text.split_once('x').and_then(|(c, r)| Some([side(c)?, side(r)?]));
    sides
        .filter(|[c, r]| c * r > 1)
        .ok_or_else(|| "give columns x rows, 2 prints or more, such as 5x7".into())
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let side = args.side_mm;
    ensure!(
        side.is_none_or(|side| (1.0..=1000.0).contains(&side)),
        "--side-mm {}: give 1 to 1000 mm",
        side.unwrap_or_default()
    );
    let mut paper = args.paper.size();
    if args.landscape {
        paper.reverse();
    }
    let (pages, told) = match args.board {
        Some(board) => board_page(&args, paper, board)?,
        None => marker_pages(&args, paper)?,
    };
    let files = write(&args.out, &pages)?;
    // all of it is TOML: the text of a board may go straight into a visor file
    say(format_args!(
        "# {files}: {}, print it at 100 %, then check it with a rule\n{told}",
        args.paper.name()
    ))
}

/// The numbers of a list such as `0-5,9`.
fn numbers(list: &str, family: Family) -> anyhow::Result<Vec<u32>> {
    let codes = family.codes().len() as u32;
    let mut out = Vec::new();
    for part in list.split(',') {
        let (from, to) = part.split_once('-').unwrap_or((part, part));
        let number = |text: &str| {
            text.trim().parse::<u32>().with_context(|| format!("--ids {list}: write it as 7 or 0-5,9"))
        };
        let (from, to) = (number(from)?, number(to)?);
        let last = from.max(to);
        ensure!(last < codes, "--ids {list}: {} has ids 0 to {}, not {last}", family.name(), codes - 1);
        ensure!(from <= to, "--ids {list}: write {part} the other way round");
        out.extend(from..=to);
        ensure!(out.len() <= MOST, "--ids {list}: at most {MOST} markers at once");
    }
    Ok(out)
}

/// White around a black square: a cell of its code, and no less than 3 mm.
fn quiet(family: Family, side: f64) -> f64 {
    let cells = family.inner() as f64 + 2.0 * family.border();
    (side / cells).max(3.0)
}

/// Markers to be cut out, in rows.
fn marker_pages(args: &Args, paper: [f64; 2]) -> anyhow::Result<(Vec<Page>, String)> {
    let (family, side) = (args.family, args.side_mm.unwrap_or(80.0));
    let quiet = quiet(family, side);
    let cell = [side + 2.0 * quiet, side + 2.0 * quiet + LABEL];
    let room = [paper[0] - 2.0 * MARGIN, paper[1] - 2.0 * MARGIN - RULER];
    // a hair of room for sums that are not exact
    let [columns, rows] = [0, 1].map(|i| ((room[i] + 1e-6) / cell[i]).floor() as usize);
    if columns == 0 || rows == 0 {
        let most = (room[0] * side / cell[0]).min((room[1] - LABEL) * side / (cell[1] - LABEL));
        bail!(
            "--side-mm {side}: with its white border it does not fit on {}: give {:.0} mm at most, or a larger --paper",
            args.paper.name(),
            most.floor()
        );
    }
    let ids = match &args.ids {
        Some(list) => numbers(list, family)?,
        None => (0..family.codes().len().min(columns * rows) as u32).collect(),
    };
    let left = 0.5 * (paper[0] - columns as f64 * cell[0]);
    let mut pages = Vec::new();
    for ids in ids.chunks(columns * rows) {
        let mut page = Page { size: paper, marks: Vec::new() };
        for (k, &id) in ids.iter().enumerate() {
            let Some(code) = family.code(id) else { continue };
            let corner = [left + (k % columns) as f64 * cell[0], MARGIN + (k / columns) as f64 * cell[1]];
            page.print(family, code, side, [corner[0] + quiet, corner[1] + quiet]);
            for (x, y) in [(0.0, 0.0), (cell[0], 0.0), (0.0, cell[1]), (cell[0], cell[1])] {
                page.cross([corner[0] + x, corner[1] + y], 0.25 * quiet);
            }
            let below = [corner[0] + 0.5 * cell[0], corner[1] + cell[1] - 0.5 * LABEL + 0.35 * TEXT];
            page.text(below, Hold::Middle, format!("{} {id}, {side} mm", family.name()));
        }
        foot(&mut page);
        pages.push(page);
    }
    let list = ids.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
    Ok((pages, format!("# {} {list}, {side} mm wide", family.name())))
}

/// The ruler at the foot of a page.
fn foot(page: &mut Page) {
    let [width, height] = page.size;
    let centimetres = (((width - 4.0 * MARGIN) / 10.0) as usize).min(15);
    let at = [2.0 * MARGIN, height - MARGIN - RULER + 2.0];
    page.ruler(at, centimetres, false);
    let text = "mm. Printed at 100 %? Then this ruler is true.";
    page.text([at[0], at[1] + RULER - 3.0], Hold::Left, text);
}

/// A board of prints, as large as the page takes or as asked for.
fn board_page(
    args: &Args,
    paper: [f64; 2],
    [columns, rows]: [u32; 2],
) -> anyhow::Result<(Vec<Page>, String)> {
    let family = args.family;
    let first = match &args.ids {
        None => 0,
        Some(first) => first
            .trim()
            .parse()
            .with_context(|| format!("--ids {first}: with --board give the first number alone"))?,
    };
    let grid = Grid { family, first, columns, rows, side_mm: 1.0 };
    let count = grid.count();
    let Some(_) = grid.board() else {
        let codes = family.codes().len();
        bail!(
            "--board {columns}x{rows} needs ids {first} to {}: {} has {codes} codes",
            first + count - 1,
            family.name()
        )
    };
    let room = [paper[0] - 4.0 * MARGIN, paper[1] - 3.0 * MARGIN - RULER - LABEL];
    let extent = grid.extent_mm();
    let most = (room[0] / extent[0]).min(room[1] / extent[1]);
    // half millimetres are read off a rule
    let side = args.side_mm.unwrap_or((2.0 * most).floor() * 0.5);
    ensure!(
        side <= most + 1e-9 && side > 0.0,
        "--side-mm {side}: {columns}x{rows} prints fit on {} up to {most:.1} mm",
        args.paper.name()
    );
    let grid = Grid { side_mm: side, ..grid };
    let [width, height] = grid.extent_mm();
    let middle = [0.5 * paper[0], 1.5 * MARGIN + 0.5 * height];
    let mut page = Page { size: paper, marks: Vec::new() };
    let board = grid.board().unwrap_or_default();
    for print in &board.prints {
        let at = print.to_board.translation;
        let corner = [middle[0] + at.x - 0.5 * side, middle[1] - at.y - 0.5 * side];
        page.print(family, family.code(print.id).unwrap_or_default(), side, corner);
    }
    let below = [middle[0], middle[1] + 0.5 * height + 0.25 * side.min(16.0) + TEXT];
    let name = format!("{} {first} to {}, {columns}x{rows}", family.name(), first + count - 1);
    page.text(below, Hold::Middle, format!("{name}, {side} mm each, {width} x {height} mm"));
    foot(&mut page);
    let mut told =
        format!("# {name}\n[[board]]\nfamily = \"{}\"\nside_mm = {side}\nprints = [\n", family.name());
    for print in &board.prints {
        let at = print.to_board.translation;
        _ = writeln!(told, "  {{ id = {}, at_mm = [{}, {}, 0] }},", print.id, tidy(at.x), tidy(at.y));
    }
    Ok((vec![page], told + "]"))
}

/// Without the dust of sums.
fn tidy(mm: f64) -> f64 {
    // + 0 turns -0 into 0
    (mm * 1e6).round() / 1e6 + 0.0
}

/// Writes the pages; says where.
fn write(out: &Path, pages: &[Page]) -> anyhow::Result<String> {
    let save = |path: &Path, bytes: &[u8]| {
        std::fs::write(path, bytes)
            .with_context(|| format!("{}: cannot write; choose another --out", path.display()))
            .context(Failed("cannot write the sheet"))
    };
    let ending = out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "pdf" => save(out, &pdf::pdf(pages))?,
        "svg" => {
            for (k, page) in pages.iter().enumerate() {
                let name = match k {
                    0 => out.to_path_buf(),
                    k => {
                        let stem = out.file_stem().map(|s| s.to_string_lossy().into_owned());
                        out.with_file_name(format!("{}-{}.svg", stem.unwrap_or_default(), k + 1))
                    }
                };
                save(&name, svg::svg(page).as_bytes())?;
            }
        }
        _ => bail!("--out {}: name a .pdf or an .svg file", out.display()),
    }
    let more = if pages.len() > 1 { format!(", {} pages", pages.len()) } else { String::new() };
    Ok(format!("{}{more}", out.display()))
}
