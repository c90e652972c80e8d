//! The tracker held to the figures of `vernissage bench --tracking`, on the same frames.

use vernissage::app::bench::markers::{Difficulty, Setup, Shot, shots};
use vernissage::app::bench::tally::{Class, Still, Tally, ghosts, quantile};
use vernissage::marker::Family;
use vernissage::pixels::{Size, simd};
use vernissage::track::{Config, Tracker};

const SIZE: Size = Size { width: 640, height: 480 };
const FAMILY: Family = Family::Tag36h11;

fn tracker() -> Tracker {
    Tracker::new(Config::default(), simd::best())
}

fn accuracy(config: Config, taken: &[Shot]) -> Tally {
    let (mut tally, mut tracker) = (Tally::default(), Tracker::new(config, simd::best()));
    taken.iter().for_each(|shot| tally.add(&mut tracker, shot));
    tally
}

fn say(name: &str, class: &Class) {
    println!(
        "{name}: {}/{} found; corners median {:.4} p90 {:.3} p99 {:.3} px; rotation {:.3}°; distance {:.3} %; flips {}",
        class.found,
        class.drawn,
        quantile(&class.corner_px, 0.5),
        quantile(&class.corner_px, 0.9),
        quantile(&class.corner_px, 0.99),
        quantile(&class.rotation_deg, 0.5),
        quantile(&class.distance_percent, 0.5),
        class.flipped
    );
}

#[test]
fn markers_are_found_and_sharp() {
    // the frames of `bench --tracking --frames 400`: fewer tell little, recall in forties of them is .66 to .82
    let taken = shots(0..400, 1, |rng, _| Setup::accuracy(rng, SIZE, FAMILY));
    let tally = accuracy(Config::default(), &taken);
    let (all, easy) = (tally.all(), tally.class(Difficulty::Easy));
    say("all", &all);
    Difficulty::ALL.iter().for_each(|&d| say(d.name(), tally.class(d)));
    assert_eq!(tally.ghosts, 0);
    assert!(all.recall() >= 0.72, "{}", all.recall());
    for (difficulty, least) in Difficulty::ALL.into_iter().zip([0.98, 0.89, 0.38]) {
        let class = tally.class(difficulty);
        assert!(class.drawn > 100 && class.recall() >= least, "{}: {}", difficulty.name(), class.recall());
    }
    assert!(quantile(&all.corner_px, 0.5) <= 0.04);
    assert!(quantile(&easy.corner_px, 0.5) <= 0.012);
    assert!(quantile(&all.corner_px, 0.99) <= 0.6);
    assert!(quantile(&all.rotation_deg, 0.5) <= 0.2);
    assert!(quantile(&all.distance_percent, 0.5) <= 0.1);
    assert!(all.flips() <= 0.02, "{} of {}", all.flipped, all.posed);
    // the outline alone finds as many and is several times less exact
    let outline = accuracy(Config { align: false, ..Config::default() }, &taken).all();
    say("outline", &outline);
    // what blur has opened or mixed is believed only where alignment confirms it
    assert!(
        outline.found <= all.found && 20 * outline.found >= 19 * all.found,
        "{} {}",
        outline.found,
        all.found
    );
    assert!(quantile(&outline.corner_px, 0.5) > 2.0 * quantile(&all.corner_px, 0.5));
}

#[test]
fn markers_at_rest_are_still() {
    let taken = shots(18..36, 20, |rng, number| Setup::still(rng, SIZE, FAMILY, number));
    let (mut still, mut tracker) = (Still::default(), tracker());
    taken.iter().for_each(|shot| still.add(&mut tracker, shot));
    let median = still.jitter(None, 0.5);
    let by_noise = [2.0, 5.0, 10.0].map(|sigma| still.jitter(Some(sigma), 0.5));
    println!(
        "{} of {} seen; jitter median {median:.4} px, by noise {by_noise:.4?}",
        still.steady, still.drawn
    );
    assert_eq!((still.steady, still.drawn), (18, 18));
    assert!(median <= 0.008, "{median}");
    assert!(by_noise.is_sorted(), "{by_noise:?}");
}

/// No clutter and no other family's marker is taken for a marker of a family.
#[test]
fn nothing_is_seen_where_nothing_is() {
    let taken = shots(0..100, 1, |rng, number| {
        let other = Family::ALL[number / 2 % Family::ALL.len()];
        Setup::negative(rng, SIZE, other, number % 2 == 1)
    });
    let mut tracker = tracker();
    let mut wrong = Vec::new();

    for family in Family::ALL {
        let seen: usize = taken.iter().map(|shot| ghosts(&mut tracker, shot, family)).sum();
        if seen > 0 {
            wrong.push((family, seen));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
