//! `vernissage bench --tracking`: the tracker on synthetic frames with exact truth, at each quality.
//!
//! The frames are made beforehand, on all threads. Every part gives one `Table`; the last is of films rather
//! than of single pictures.

use super::following::{Followed, follow};
use super::markers::{Difficulty, Setup, Shot, shots};
use super::motion::{self, Film};
use super::table::{Cell, Column, Table};
use super::tally::{Class, Still, Tally, every, ghosts, quantile};
use super::{Args, plot};
use crate::app::report::machine;
use crate::app::{pool, progress, say};
use crate::marker::Family;
use crate::pixels::{Plane, Size, simd};
use crate::track::{Config, Quality, Tracker};
use rayon::ThreadPool;
use std::time::{Duration, Instant};

const VGA: Size = Size { width: 640, height: 480 };
const HD: Size = Size { width: 1280, height: 720 };
/// Noise draws of a still scene.
const DRAWS: usize = 20;
/// Frames held in memory at once.
const BATCH: usize = 32;
/// Kinds of the speed set, in the order of [`Setup::speed`].
const KINDS: usize = 3;

/// The tracker's settings that are compared.
fn qualities() -> Vec<(&'static str, Config)> {
    let of = |quality| Config { quality, ..Config::default() };
    vec![
        ("quick", of(Quality::Quick)),
        ("normal", of(Quality::Normal)),
        ("full", of(Quality::Full)),
        ("normal, outline only", Config { align: false, ..of(Quality::Normal) }),
    ]
}

/// What the figures are of.
struct Bench<'a> {
    args: &'a Args,
    /// Frames of the accuracy set and of the negative one.
    frames: usize,
    /// Frames of each kind of the speed set, and scenes of each noise of the still one.
    few: usize,
    /// Where frames are made and, but for the speed set, searched.
    crew: ThreadPool,
    qualities: Vec<(&'static str, Config)>,
    plot: Vec<plot::Point>,
    /// Median corner error of each quality, px.
    corner_px: Vec<f64>,
}

/// Measures, prints, and leaves the plot.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let frames = args.frames.unwrap_or(60) as usize;
    let mut bench = Bench {
        args,
        frames,
        few: frames.div_ceil(10),
        crew: pool(args.threads.iter().copied().max().unwrap_or(2))?,
        qualities: qualities(),
        plot: Vec::new(),
        corner_px: Vec::new(),
    };
    let family = args.family;
    if args.json {
        let (family, repeat) = (family.name(), args.repeat);
        say(
            serde_json::json!({ "machine": machine(), "family": family, "frames": frames, "repeat": repeat }),
        )?;
    } else {
        say(format_args!("{}, {}, {frames} frames", machine(), family.name()))?;
    }
    let parts = [Bench::accuracy, Bench::stillness, Bench::negatives, Bench::speed, Bench::following];
    let bar = progress::bar(Some(parts.len() as u64), "parts");
    for part in parts {
        let table = part(&mut bench)?;
        bar.suspend(|| table.print(args.json))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let title = format!("vernissage bench --tracking: time against error, {}, {}", family.name(), machine());
    args.leave_plot("tracking.svg", &plot::svg(&title, "median error of a corner, px", &bench.plot))
}

impl Bench<'_> {
    /// Makes `count` shots on all threads, a batch at a time, and hands them to `look`, which runs there too.
    fn each(
        &self,
        count: usize,
        draws: usize,
        setup: impl Fn(&mut crate::pixels::SplitMix64, usize) -> Setup + Sync,
        mut look: impl FnMut(&Shot) + Send,
    ) {
        self.crew.install(|| {
            for first in (0..count).step_by(BATCH) {
                shots(first..count.min(first + BATCH), draws, &setup).iter().for_each(&mut look);
            }
        });
    }

    fn trackers(&self) -> Vec<Tracker> {
        self.qualities.iter().map(|(_, config)| Tracker::new(config.clone(), simd::best())).collect()
    }

    /// Recall and errors by difficulty.
    fn accuracy(&mut self) -> anyhow::Result<Table> {
        let mut trackers = self.trackers();
        let mut tallies = vec![Tally::default(); trackers.len()];
        let family = self.args.family;
        self.each(
            self.frames,
            1,
            |rng, _| Setup::accuracy(rng, VGA, family),
            |shot| {
                for (tally, tracker) in tallies.iter_mut().zip(&mut trackers) {
                    tally.add(tracker, shot);
                }
            },
        );
        let row = |quality: &str, name: &str, class: &Class, ghosts: Option<usize>| -> Vec<Cell> {
            let corner = |q| quantile(&class.corner_px, q).into();
            vec![
                quality.into(),
                name.into(),
                class.drawn.into(),
                (100.0 * class.recall()).into(),
                ghosts.map_or(f64::NAN, |ghosts| ghosts as f64).into(),
                corner(0.5),
                corner(0.9),
                corner(0.99),
                quantile(&class.rotation_deg, 0.5).into(),
                quantile(&class.distance_percent, 0.5).into(),
                (100.0 * class.flips()).into(),
            ]
        };
        let mut rows = Vec::new();
        for ((quality, _), tally) in self.qualities.iter().zip(&tallies) {
            let all = tally.all();
            self.corner_px.push(quantile(&all.corner_px, 0.5));
            rows.push(row(quality, "all", &all, Some(tally.ghosts)));
            rows.extend(Difficulty::ALL.map(|d| row(quality, d.name(), tally.class(d), None)));
        }
        const COLUMNS: &[Column] = &[
            Column("quality", "quality", 0),
            Column("markers", "difficulty", 0),
            Column("count", "markers", 0),
            Column("recall %", "recall_percent", 1),
            Column("false", "false_positives", 0),
            Column("corner px: median", "corner_px_median", 4),
            Column("p90", "corner_px_p90", 3),
            Column("p99", "corner_px_p99", 3),
            Column("rotation °", "rotation_deg_median", 3),
            Column("distance %", "distance_percent_median", 3),
            Column("flips %", "flips_percent", 2),
        ];
        let about = format!(
            "{} frames of 640x480 with 1-6 markers, sides 15-250 px, tilts to 75°, every noise, blur and light",
            self.frames
        );
        Ok(Table { part: "accuracy", about, columns: COLUMNS, rows })
    }

    /// Jitter of markers that rest before a resting camera.
    fn stillness(&mut self) -> anyhow::Result<Table> {
        let mut trackers = self.trackers();
        let mut stills = vec![Still::default(); trackers.len()];
        let (family, scenes) = (self.args.family, KINDS * self.few);
        self.each(
            scenes,
            DRAWS,
            |rng, number| Setup::still(rng, VGA, family, number),
            |shot| {
                for (still, tracker) in stills.iter_mut().zip(&mut trackers) {
                    still.add(tracker, shot);
                }
            },
        );
        let row = |((quality, _), still): (&(&'static str, _), &Still)| -> Vec<Cell> {
            let jitter = |sigma, q| still.jitter(sigma, q).into();
            vec![
                (*quality).into(),
                still.drawn.into(),
                (100.0 * still.steady as f64 / still.drawn as f64).into(),
                jitter(None, 0.5),
                jitter(None, 0.9),
                jitter(Some(2.0), 0.5),
                jitter(Some(5.0), 0.5),
                jitter(Some(10.0), 0.5),
            ]
        };
        let rows = self.qualities.iter().zip(&stills).map(row).collect();
        const COLUMNS: &[Column] = &[
            Column("quality", "quality", 0),
            Column("scenes", "scenes", 0),
            Column("seen %", "seen_percent", 1),
            Column("jitter px: median", "jitter_px_median", 4),
            Column("p90", "jitter_px_p90", 4),
            Column("σ 2", "jitter_px_sigma_2", 4),
            Column("σ 5", "jitter_px_sigma_5", 4),
            Column("σ 10", "jitter_px_sigma_10", 4),
        ];
        let about = format!(
            "{scenes} scenes at rest, {DRAWS} noise draws each, every picture on its own: RMS of a corner about its mean"
        );
        Ok(Table { part: "still", about, columns: COLUMNS, rows })
    }

    /// What is seen where nothing is, in every family; alignment has no say in it.
    fn negatives(&mut self) -> anyhow::Result<Table> {
        let mut trackers = self.trackers();
        // cluttered tables, and in every second picture markers of one family after the other
        let setup = |rng: &mut _, number: usize| {
            let other = Family::ALL[number / 2 % Family::ALL.len()];
            Setup::negative(rng, VGA, other, number % 2 == 1)
        };
        let mut seen = [[0; 3]; Family::ALL.len()];
        self.each(self.frames, 1, setup, |shot| {
            for (family, seen) in Family::ALL.into_iter().zip(&mut seen) {
                for (tracker, seen) in trackers.iter_mut().zip(seen) {
                    *seen += ghosts(tracker, shot, family);
                }
            }
        });
        let row = |(family, seen): (Family, [usize; 3])| -> Vec<Cell> {
            let mut row = vec![family.name().into(), family.chance(family.max_hamming()).into()];
            row.extend(seen.map(Cell::from));
            row
        };
        let rows = Family::ALL.into_iter().zip(seen).map(row).collect();
        const COLUMNS: &[Column] = &[
            Column("false positives", "family", 0),
            Column("chance of random bits", "chance", 7),
            Column("quick", "false_quick", 0),
            Column("normal", "false_normal", 0),
            Column("full", "false_full", 0),
        ];
        let (clutter, others) = (self.frames.div_ceil(2), self.frames / 2);
        let about = format!("{clutter} frames of clutter, {others} frames with markers of other families");
        Ok(Table { part: "negative", about, columns: COLUMNS, rows })
    }

    /// Mean over frames of each frame's least time.
    fn speed(&mut self) -> anyhow::Result<Table> {
        let (family, few) = (self.args.family, self.few);
        let mut rows = Vec::new();
        for (size, name) in [(VGA, "640x480"), (HD, "1280x720")] {
            let taken = self
                .crew
                .install(|| shots(0..KINDS * few, 1, |rng, number| Setup::speed(rng, size, family, number)));
            for ((quality, config), corner_px) in self.qualities.iter().zip(&self.corner_px) {
                for &threads in &self.args.threads {
                    let ms = pool(threads)?.install(|| time(config, &taken, self.args.repeat));
                    let mean = ms.iter().sum::<f64>() / KINDS as f64;
                    let mut row: Vec<Cell> = vec![(*quality).into(), name.into(), threads.into()];
                    row.extend(ms.iter().chain([&mean]).map(|&ms| Cell::Number(ms)));
                    rows.push(row);
                    self.plot.push(plot::Point {
                        series: format!("{name}, {threads} threads"),
                        label: (*quality).into(),
                        ms: mean,
                        error: *corner_px,
                    });
                }
            }
        }
        const COLUMNS: &[Column] = &[
            Column("quality", "quality", 0),
            Column("frame", "size", 0),
            Column("threads", "threads", 0),
            Column("calm ms", "calm_ms", 3),
            Column("cluttered", "cluttered_ms", 3),
            Column("noisy", "noisy_ms", 3),
            Column("mean", "mean_ms", 3),
        ];
        let about = format!(
            "{few} frames of each kind with 2-5 markers of 30-180 px; mean of each frame's least time of {} runs",
            self.args.repeat
        );
        Ok(Table { part: "speed", about, columns: COLUMNS, rows })
    }

    /// What following films comes to.
    fn following(&mut self) -> anyhow::Result<Table> {
        let mut rows = Vec::new();
        let (config, level, repeat) = (Config::default(), simd::best(), self.args.repeat as usize);
        for (kind, films) in motion::kinds() {
            let films = films.into_iter().map(|film| Film { family: self.args.family, ..film });
            let shot: Vec<_> =
                self.crew.install(|| films.map(|film| (film.shoot(), film)).collect::<Vec<_>>());
            for &threads in &self.args.threads {
                let of = |(pictures, film): &(Vec<Plane<u8>>, Film)| {
                    follow(film, pictures, &config, level, repeat)
                };
                let each: Vec<Followed> = pool(threads)?.install(|| shot.iter().map(of).collect());
                let Some(all) = each.into_iter().reduce(|a, b| a.and(&b)) else { continue };
                // what moves does not rest
                let rests = |v: f64| if kind == "still" { v } else { f64::NAN };
                rows.push(vec![
                    kind.into(),
                    threads.into(),
                    all.readable.into(),
                    (100.0 * all.tracked as f64 / all.readable as f64).into(),
                    all.wrong.into(),
                    all.flipped.into(),
                    all.delay.into(),
                    all.lag[0].into(),
                    all.lag[1].into(),
                    rests(all.jitter[0]).into(),
                    rests(100.0 * all.jitter[1]).into(),
                    all.error[0].into(),
                    all.error[1].into(),
                    all.ms[0].into(),
                    all.ms[1].into(),
                ]);
            }
        }
        const COLUMNS: &[Column] = &[
            Column("film", "film", 0),
            Column("threads", "threads", 0),
            Column("readable", "readable", 0),
            Column("tracked %", "tracked_percent", 1),
            Column("wrong", "wrong", 0),
            Column("flips", "flips", 0),
            Column("frames until seen", "delay_frames", 0),
            Column("lag of rotation, frames", "lag_rotation_frames", 3),
            Column("of translation", "lag_translation_frames", 3),
            Column("jitter °", "jitter_deg", 4),
            Column("of distance %", "jitter_distance_percent", 4),
            Column("corner px: RMS", "corner_px_rms", 3),
            Column("rotation ° RMS", "rotation_deg_rms", 3),
            Column("ms a followed picture", "followed_ms", 3),
            Column("a searched one", "searched_ms", 3),
        ];
        let about =
            "films of 5 s at 30 fps, one print or four, the worse of two films; ms: means of least times"
                .into();
        Ok(Table { part: "following", about, columns: COLUMNS, rows })
    }
}

/// Mean least time of each kind of frame, ms.
fn time(config: &Config, taken: &[Shot], repeat: u64) -> [f64; KINDS] {
    let mut tracker = Tracker::new(config.clone(), simd::best());
    let mut least = vec![Duration::MAX; taken.len()];
    // one round more, to warm up
    for round in 0..=repeat {
        for (shot, least) in taken.iter().zip(&mut least) {
            let (picture, wanted) = (shot.pictures[0].view(), every(shot.setup.family));
            let start = Instant::now();
            tracker.find(picture, &shot.setup.lens, &wanted);
            let time = start.elapsed();
            if round > 0 {
                *least = time.min(*least);
            }
        }
    }
    std::array::from_fn(|kind| {
        let of: Vec<f64> = least.iter().skip(kind).step_by(KINDS).map(|t| t.as_secs_f64() * 1e3).collect();
        of.iter().sum::<f64>() / of.len() as f64
    })
}
