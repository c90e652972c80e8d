//! Following markers through films with exact truth: nothing readable is lost, nothing flips, nothing shimmers at
//! rest or lags in motion, and the result does not depend on threads nor on the SIMD level.

use std::time::Duration;
use vernissage::app::bench::following::{Followed, follow};
use vernissage::app::bench::markers::SIDE_MM;
use vernissage::app::bench::motion::{Film, RATE};
use vernissage::frame::{Sighting, State};
use vernissage::pixels::simd::{self, Level};
use vernissage::pixels::{Plane, Size};
use vernissage::track::{Config, Tracker, Wanted};

const SIZE: Size = Size { width: 320, height: 240 };

fn seen(film: &Film) -> Followed {
    follow(film, &film.shoot(), &Config::default(), simd::best(), 1)
}

#[test]
fn what_rests_does_not_shimmer() {
    for (sigma, tilt) in [(2.0, 5.0), (5.0, 5.0), (5.0, 40.0)] {
        let seen = seen(&Film::still(SIZE, 150, sigma, 80.0, tilt, 1));
        assert_eq!((seen.tracked, seen.flipped, seen.wrong), (150, 0, 0), "{seen:?}");
        let [turn_deg, far] = seen.jitter;
        assert!(turn_deg < 0.02 && far < 2e-4, "σ {sigma}, tilt {tilt}°: {seen:?}");
    }
}

#[test]
fn what_turns_is_not_late() {
    for sigma in [2.0, 5.0] {
        let seen = seen(&Film::turning(SIZE, 150, sigma, 80.0, 2));
        assert_eq!((seen.tracked, seen.flipped, seen.wrong), (150, 0, 0), "{seen:?}");
        assert!(seen.lag.iter().all(|frames| frames.abs() < 0.3), "σ {sigma}: {seen:?}");
    }
}

#[test]
fn hands_are_followed_through_blur_and_covers() {
    let (mut readable, mut tracked) = (0, 0);
    for (count, seed) in [(1, 10), (1, 11), (4, 30), (4, 31)] {
        let film = Film::hands(SIZE, 150, 3.0, 200.0, count, seed);
        let seen = seen(&film);
        assert_eq!((seen.flipped, seen.wrong), (0, 0), "{count} prints: {seen:?}");
        // the camera rests: what is new is where the picture changed
        assert!(seen.delay <= 3 && seen.lag.iter().all(|frames| frames.abs() < 0.3), "{seen:?}");
        (readable, tracked) = (readable + seen.readable, tracked + seen.tracked);
    }
    assert!(tracked * 100 >= readable * 99, "{tracked} of {readable}");
}

/// Everything that is reported about a film.
fn told(film: &Film, pictures: &[Plane<u8>], threads: usize, level: Level) -> Vec<Sighting> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    pool.install(|| {
        let wanted = [Wanted { family: film.family, id: None, side_mm: SIDE_MM }];
        let mut tracker = Tracker::new(Config::default(), level);
        let mut all = Vec::new();
        for (frame, picture) in pictures.iter().enumerate() {
            let at = Duration::from_secs_f64(frame as f64 / RATE);
            all.extend_from_slice(tracker.follow(picture.view(), &film.lens, &wanted, at));
        }
        all
    })
}

#[test]
fn same_for_every_thread_count_and_level() {
    let mut film = Film::hands(SIZE, 60, 3.0, 200.0, 4, 30);
    film.lens.distortion[0] = -0.2;
    let pictures = film.shoot();
    let first = told(&film, &pictures, 1, simd::available()[0]);
    for state in [State::Found, State::Followed, State::Held] {
        assert!(first.iter().any(|sighting| sighting.state == state), "no {state:?} in the film");
    }
    for threads in [1, 2, 4] {
        for level in simd::available() {
            let same = told(&film, &pictures, threads, level) == first;
            assert!(same, "{} with {threads} threads differs", simd::name(level));
        }
    }
}
