//! Nothing is allocated in the frame loop after warm-up: counted, for every style.
//!
//! The counter is the process's global allocator, so this test has a binary of its own.

#[path = "common/counting.rs"]
mod counting;

use clap::ValueEnum;
use counting::{watch, watched};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use vernissage::camera::{Synthetic, SyntheticConfig};
use vernissage::display::{Menu, Seen, Sink};
use vernissage::frame::Frame;
use vernissage::marker::Family;
use vernissage::pipeline::Pipeline;
use vernissage::pixels::{Rgb, Size, simd};
use vernissage::scene::{LightConfig, ModelConfig, Scene};
use vernissage::style::{self, StyleName};

/// Held by the test that counts: the others' allocations would be counted with its own.
static COUNTING: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    COUNTING.lock().unwrap_or_else(PoisonError::into_inner)
}

fn teapot() -> Scene {
    let text = "file = \"teapot\"\nmarker = { id = 7 }\n";
    let model: ModelConfig = toml::from_str(text).expect("a valid model table");
    let scene = Scene::build(&[model], &LightConfig::default(), std::path::Path::new("."));
    let scene = scene.expect("the built-in teapot");
    assert!(scene.models[0].anchor.takes(Family::Tag36h11, 7));
    scene
}

#[test]
fn three_hundred_frames_allocate_nothing_in_any_style() {
    let _alone = alone();
    let size = Size::new(320, 240);
    let settings = SyntheticConfig { samples: 1, pace: 3.0, ..SyntheticConfig::default() };
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| watch()).build().expect("a pool");
    pool.install(|| {
        for &name in StyleName::value_variants() {
            let style = style::Config { name, ..style::Config::default() };
            let mut camera = Synthetic::new(&settings, size, 30.0, simd::best());
            let mut pipeline =
                Pipeline::new(teapot(), camera.lens(), Default::default(), &style, simd::best());
            let mut sink = Sink::Null;
            let mut frame = Frame::default();
            let mut before = 0;
            let mut seen = 0;
            // warm-up: as long as it takes to see the whole path once, so that every buffer has its size
            for number in 0..600 {
                if number == 300 {
                    before = watched();
                    seen = 0;
                }
                assert!(camera.next(&mut frame));
                let drawn = pipeline.draw_frame(&frame);
                seen += usize::from(drawn.models == 1);
                sink.present(drawn.canvas).expect("nowhere takes everything");
            }
            let allocated = watched() - before;
            assert!(seen > 285, "{name}: the teapot was drawn in only {seen} of 300 frames");
            assert_eq!(allocated, 0, "{name}: {allocated} allocations in 300 frames");
        }
    });
}

#[test]
fn a_menu_over_the_picture_allocates_nothing() {
    let _alone = alone();
    watch();
    let canvas = Rgb::new(Size::new(640, 480), [90; 3]);
    let mut menu = Menu::default();
    menu.set_lines((0..20).map(|line| format!("line {line}")).collect());
    let mut before = 0;
    for second in 0..300_u64 {
        let time = Duration::from_secs(second);
        match second % 30 {
            0 => menu.open(time, |line| line == 3),
            1..15 => menu.step(time),
            _ => {} // it closes by itself
        }
        let shown = menu.over(&canvas, Seen::all(canvas.size()), time) != &canvas;
        assert_eq!(shown, second % 30 < 24, "{second}");
        if second == 30 {
            before = watched();
        }
    }
    assert_eq!(watched() - before, 0);
}

#[test]
fn with_every_option_on_switching_allocates_between_frames_only() {
    let _alone = alone();
    let size = Size::new(320, 240);
    // always the same picture: how full it is may not matter here
    let settings = SyntheticConfig { samples: 1, pace: 0.0, noise: 0.0, ..SyntheticConfig::default() };
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| watch()).build().expect("a pool");
    let cycle = StyleName::value_variants().to_vec();
    let part = toml::from_str("of = \"object\"").expect("a valid table");
    let config = style::Config {
        cycle: cycle.clone(),
        fade_ms: 100,
        part: Some(part),
        anchored: true,
        ..style::Config::default()
    };
    let retouch = toml::from_str("steady = {}\nhide = {}\nlight = {}\nshadow = {}").expect("a valid table");
    pool.install(|| {
        let mut camera = Synthetic::new(&settings, size, 30.0, simd::best());
        let mut pipeline = Pipeline::new(teapot(), camera.lens(), Default::default(), &config, simd::best())
            .retouched(&retouch);
        let mut frame = Frame::default();
        let (mut inside, mut faded) = (Vec::new(), 0);
        for number in 0..12 * (cycle.len() + 3) {
            assert!(camera.next(&mut frame));
            match (number % 12, number / 12) {
                (0, round) if round > cycle.len() => {
                    // a style that was not built ahead
                    let mut other = style::Config { name: StyleName::Watercolor, ..config.clone() };
                    other.watercolor.cell = 6 + round as u32;
                    pipeline.switch(&other);
                }
                (0, round) if round > 0 => pipeline.step_style(1),
                _ => {}
            }
            let before = watched();
            faded += usize::from(pipeline.draw_frame(&frame).plan.fade.runs);
            let allocated = watched() - before;
            if number >= 12 && allocated > 0 {
                inside.push((number, allocated));
            }
        }
        assert_eq!(faded, 2 * (cycle.len() + 2));
        assert!(inside.is_empty(), "frames that allocate, and how often: {inside:?}");
    });
}

#[test]
fn the_governors_steps_allocate_nothing() {
    let _alone = alone();
    let size = Size::new(320, 240);
    let settings = SyntheticConfig { samples: 1, pace: 0.0, noise: 0.0, ..SyntheticConfig::default() };
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| watch()).build().expect("a pool");
    pool.install(|| {
        for &name in StyleName::value_variants() {
            let config = style::Config { name, ..style::Config::default() };
            let mut camera = Synthetic::new(&settings, size, 30.0, simd::best());
            let mut pipeline =
                Pipeline::new(teapot(), camera.lens(), Default::default(), &config, simd::best()).governed();
            assert_eq!(pipeline.forms(), 1 + config.simpler().len(), "{name}");
            let mut frame = Frame::default();
            let (mut pictures, mut inside) = (Vec::new(), Vec::new());
            for number in 0..24 {
                assert!(camera.next(&mut frame));
                let before = watched();
                if number % 4 == 0 {
                    pipeline.set_quality(number / 4 % 3);
                }
                pipeline.draw_frame(&frame);
                let allocated = watched() - before;
                if number >= 4 && allocated > 0 {
                    inside.push((number, allocated));
                }
            }
            assert!(inside.is_empty(), "{name}: frames that allocate, and how often: {inside:?}");
            // the simplest is another picture
            for quality in 0..pipeline.forms() {
                pipeline.set_quality(quality);
                assert!(camera.next(&mut frame));
                pictures.push(pipeline.draw_frame(&frame).canvas.clone());
            }
            assert!(pictures.len() == 1 || pictures.first() != pictures.last(), "{name}");
        }
    });
}
