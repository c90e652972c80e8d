//! The whole pipeline gives the same bytes for 1, 2 and 4 threads and at every SIMD level, poses included.

use vernissage::camera::{Synthetic, SyntheticConfig};
use vernissage::frame::Frame;
use vernissage::pipeline::Pipeline;
use vernissage::pixels::simd::{self, Level};
use vernissage::pixels::{Rgb, Size};
use vernissage::scene::{LightConfig, ModelConfig, Scene};
use vernissage::style::{self, StyleName};

/// Canvases and pose numbers of a few frames.
fn play(style: StyleName, size: Size, k1: f64, threads: usize, level: Level) -> (Vec<Rgb>, Vec<u64>) {
    let models: Vec<ModelConfig> = [
        "file = \"teapot\"\nmarker = { id = 7 }\nscale = 1.4",
        "file = \"spot\"\nmarker = { id = 7 }\ntranslate_mm = [60, 40, 10]",
    ]
    .map(|text| toml::from_str(text).expect("a valid model table"))
    .into();
    let scene =
        Scene::build(&models, &LightConfig::default(), std::path::Path::new(".")).expect("built-in models");
    let settings = SyntheticConfig { samples: 1, pace: 20.0, k1, ..SyntheticConfig::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    pool.install(|| {
        let mut camera = Synthetic::new(&settings, size, 30.0, level);
        let config = style::Config { name: style, ..style::Config::default() };
        let mut pipeline = Pipeline::new(scene, camera.lens(), Default::default(), &config, level);
        let (mut canvases, mut numbers, mut frame) = (Vec::new(), Vec::new(), Frame::default());
        for _ in 0..4 {
            assert!(camera.next(&mut frame));
            let drawn = pipeline.draw_frame(&frame);
            canvases.push(drawn.canvas.clone());
            for solved in drawn.sightings.iter().filter_map(|s| s.pose) {
                let values = solved
                    .pose
                    .rotation
                    .to_cols_array()
                    .into_iter()
                    .chain(solved.pose.translation.to_array());
                numbers.extend(values.map(f64::to_bits));
            }
        }
        (canvases, numbers)
    })
}

#[test]
fn same_bytes_for_every_thread_count_and_level() {
    for (size, k1) in [(Size::new(320, 240), 0.0), (Size::new(333, 251), -0.25)] {
        for &style in StyleName::ALL {
            let first = play(style, size, k1, 1, simd::available()[0]);
            assert!(first.1.len() >= 3 * 12, "{style} {size}: the marker is seen in most frames");
            for threads in [1, 2, 4] {
                for level in simd::available() {
                    let same = play(style, size, k1, threads, level) == first;
                    assert!(same, "{style} {size}: {} with {threads} threads differs", simd::name(level));
                }
            }
        }
    }
}
