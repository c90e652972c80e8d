//! What happens between frames and around the styles: switching, and later the retouches, each held to what it says.

use clap::ValueEnum;
use vernissage::camera::{Synthetic, SyntheticConfig};
use vernissage::frame::Frame;
use vernissage::kernel::mix;
use vernissage::pipeline::{Pipeline, View};
use vernissage::pixels::{Rgb, Size, simd};
use vernissage::scene::{LightConfig, ModelConfig, Scene};
use vernissage::style::{self, StyleName};

const SIZE: Size = Size::new(320, 240);

fn teapot() -> Scene {
    let model: ModelConfig =
        toml::from_str("file = \"teapot\"\nmarker = { id = 7 }\n").expect("a valid table");
    Scene::build(&[model], &LightConfig::default(), std::path::Path::new(".")).expect("the built-in teapot")
}

fn camera(settings: SyntheticConfig) -> Synthetic {
    Synthetic::new(&settings, SIZE, 30.0, simd::best())
}

fn pipeline(scene: Scene, camera: &Synthetic, style: &style::Config) -> Pipeline {
    Pipeline::new(scene, camera.lens(), Default::default(), style, simd::best())
}

fn named(name: StyleName) -> style::Config {
    style::Config { name, fade_ms: 100, ..style::Config::default() }
}

#[test]
fn a_fade_mixes_whole_pictures_of_both_styles() {
    let mut camera = camera(SyntheticConfig::default());
    let mut live = pipeline(teapot(), &camera, &named(StyleName::Cartoon));
    let mut old = pipeline(teapot(), &camera, &named(StyleName::Cartoon));
    let mut new = pipeline(teapot(), &camera, &named(StyleName::Illustrative));
    let mut frame = Frame::default();
    let mut shares = Vec::new();
    for number in 0..10 {
        assert!(camera.next(&mut frame));
        if number == 4 {
            live.switch(&named(StyleName::Illustrative));
            assert!(live.plan(View::Models(1)).fade.runs);
            assert_eq!(live.style(), StyleName::Illustrative);
        }
        let before = old.draw_frame(&frame).canvas.clone();
        // every pipeline sees every frame: trackers remember
        let after = new.draw_frame(&frame).canvas.clone();
        let drawn = live.draw_frame(&frame);
        assert_eq!(drawn.plan.fade.runs, (4..6).contains(&number), "frame {number}");
        assert_eq!(drawn.models, 1, "frame {number}");
        if number < 4 {
            assert!(*drawn.canvas == before, "frame {number} is the first style's");
        } else {
            let share = ((number - 3) * 256 * 10 / 30).min(256);
            let mut mixed = after;
            mix::fade(simd::best(), &before, share, &mut mixed);
            assert!(*drawn.canvas == mixed, "frame {number} has {share} of 256 of the second style");
            shares.push(share);
        }
    }
    assert_eq!(shares, [85, 170, 256, 256, 256, 256]);
}

#[test]
fn without_a_fade_the_next_frame_is_the_other_style() {
    let mut camera = camera(SyntheticConfig::default());
    let style = |name| style::Config { fade_ms: 0, ..named(name) };
    let cycle = vec![StyleName::Cartoon, StyleName::Illustrative];
    let config = style::Config { cycle, ..style(StyleName::Cartoon) };
    let mut live = pipeline(teapot(), &camera, &config);
    let mut frame = Frame::default();
    let names = [StyleName::Cartoon, StyleName::Illustrative];
    let mut alone = names.map(|name| pipeline(teapot(), &camera, &style(name)));
    for turn in [0, 1, 0] {
        assert!(camera.next(&mut frame));
        // every pipeline sees every frame: trackers remember
        let pictures = alone.each_mut().map(|alone| alone.draw_frame(&frame).canvas.clone());
        assert!(*live.draw_frame(&frame).canvas == pictures[turn], "{}", names[turn]);
        live.step_style(1);
    }
}

/// A scene file's tables in place of the demo's.
fn retouched(text: &str) -> (vernissage::retouch::Config, style::Config) {
    #[derive(serde::Deserialize)]
    struct Tables {
        #[serde(default)]
        retouch: vernissage::retouch::Config,
        style: style::Config,
    }
    let tables: Tables = toml::from_str(text).expect("valid tables");
    tables.retouch.validate().expect("in range");
    tables.style.validate().expect("in range");
    (tables.retouch, tables.style)
}

/// The first frame of the synthetic table drawn with these settings; also the frame.
fn first(text: &str, settings: &SyntheticConfig) -> (Rgb, Frame, Synthetic) {
    let (retouch, style) = retouched(text);
    let mut camera = camera(settings.clone());
    let mut frame = Frame::default();
    assert!(camera.next(&mut frame));
    let mut pipeline = pipeline(teapot(), &camera, &style).retouched(&retouch);
    (pipeline.draw_frame(&frame).canvas.clone(), frame, camera)
}

/// Gray values of the picture under a grid of marker-space places, from one radius (shares of half the border's side,
/// square) to another.
fn under(picture: &Rgb, camera: &Synthetic, radius: std::ops::RangeInclusive<f64>) -> Vec<f64> {
    let (pose, lens) = (camera.truth(0), camera.lens());
    let mut values = Vec::new();
    for (i, j) in (-60..=60).flat_map(|j| (-60..=60).map(move |i| (f64::from(i) / 30.0, f64::from(j) / 30.0)))
    {
        if radius.contains(&i.abs().max(j.abs())) {
            let at = lens
                .project(pose.apply(glam::DVec3::new(40.0 * i, 40.0 * j, 0.0)))
                .expect("in front")
                .round();
            if at.cmpge(glam::DVec2::ZERO).all() && at.x < SIZE.width as f64 && at.y < SIZE.height as f64 {
                let [r, g, b] = picture.at(at.x as usize, at.y as usize).map(f64::from);
                values.push(0.299 * r + 0.587 * g + 0.114 * b);
            }
        }
    }
    values
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::MAX, f64::min)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn a_hidden_marker_is_paper_or_nothing() {
    let settings = SyntheticConfig { noise: 0.0, ..SyntheticConfig::default() };
    // no model in the way: a teapot too small to be seen
    let draw = |text: &str| {
        let (retouch, style) = retouched(text);
        let model: ModelConfig =
            toml::from_str("file = \"teapot\"\nmarker = { id = 7 }\nscale = 0.001\n").expect("a valid table");
        let scene =
            Scene::build(&[model], &LightConfig::default(), std::path::Path::new(".")).expect("a scene");
        let mut camera = camera(settings.clone());
        let mut frame = Frame::default();
        assert!(camera.next(&mut frame));
        let mut pipeline = pipeline(scene, &camera, &style).retouched(&retouch);
        (pipeline.draw_frame(&frame).canvas.clone(), camera)
    };
    let (seen, camera) = draw("style = { name = \"plain\" }");
    assert!(least(&under(&seen, &camera, 0.1..=1.0)) < 40.0, "ink");
    // the quiet zone stays: white where the ink was, within a few levels of the paper around
    let (blank, camera) = draw("style = { name = \"plain\" }\n[retouch.hide]\nmargin = 1");
    let ring = under(&blank, &camera, 1.28..=1.4);
    let print = under(&blank, &camera, 0.1..=1.2);
    assert!(least(&print) > least(&ring) - 3.0, "print {} paper {}", least(&print), least(&ring));
    assert!((mean(&print) - mean(&ring)).abs() < 6.0, "print {} paper {}", mean(&print), mean(&ring));
    // past the sheet's edge (two cells = 1.5) nothing of it stays
    let (gone, camera) = draw("style = { name = \"plain\" }\n[retouch.hide]\nmargin = 2.5");
    let ring = under(&gone, &camera, 1.65..=1.75);
    let print = under(&gone, &camera, 0.1..=1.55);
    assert!(least(&print) > least(&ring) - 3.0, "print {} cloth {}", least(&print), least(&ring));
    assert!((mean(&print) - mean(&ring)).abs() < 12.0, "print {} cloth {}", mean(&print), mean(&ring));
}

#[test]
fn a_part_is_styled_and_the_rest_is_not() {
    let settings = SyntheticConfig::default();
    let (plain, _, camera) = first("style = { name = \"plain\" }", &settings);
    let (styled, ..) = first("style = { name = \"illustrative\" }", &settings);
    for (of, inside, outside) in [("marker", 0.3..=0.9, 1.8..=2.0), ("object", 0.0..=0.0, 1.8..=2.0)] {
        for turned in [false, true] {
            let text = format!(
                "style = {{ name = \"illustrative\", part = {{ of = \"{of}\", outside = {turned}, softness = 2 }} }}"
            );
            let (part, ..) = first(&text, &settings);
            let (at, far) = if turned { (&plain, &styled) } else { (&styled, &plain) };
            assert_eq!(under(&part, &camera, inside.clone()), under(at, &camera, inside.clone()), "{text}");
            assert_eq!(
                under(&part, &camera, outside.clone()),
                under(far, &camera, outside.clone()),
                "{text}"
            );
        }
    }
    // no model in sight: nothing to style
    let (retouch, style) = retouched("style = { name = \"illustrative\", part = { of = \"object\" } }");
    let mut blind = pipeline(Scene::default(), &camera, &style).retouched(&retouch);
    let frame =
        Frame { luma: vernissage::pixels::Plane::new(SIZE, 90), color: plain.clone(), ..Frame::default() };
    assert!(*blind.draw_frame(&frame).canvas == plain);
}

#[test]
fn models_take_the_rooms_light_and_throw_shadows() {
    let settings = SyntheticConfig::default();
    let (plain, frame, camera) = first("style = { name = \"plain\" }", &settings);
    // the same frame under a reddish, dim lamp
    let mut warm = frame.clone();
    for (plane, share) in warm.color.planes.iter_mut().zip([0.8, 0.5, 0.4]) {
        plane.samples_mut().iter_mut().for_each(|v| *v = (f32::from(*v) * share) as u8);
    }
    let (retouch, style) = retouched("style = { name = \"plain\" }\n[retouch.light]\n");
    let mut lit = pipeline(teapot(), &camera, &style).retouched(&retouch);
    let white = lit.draw_frame(&frame).canvas.clone();
    let mut dim = pipeline(teapot(), &camera, &style).retouched(&retouch);
    let red = dim.draw_frame(&warm).canvas.clone();
    let body =
        camera.lens().project(camera.truth(0).apply(glam::DVec3::new(0.0, 0.0, 20.0))).expect("seen").round();
    let at = |picture: &Rgb| picture.at(body.x as usize, body.y as usize).map(f64::from);
    for c in 0..3 {
        let share = at(&red)[c] / at(&white)[c];
        assert!((share - [0.8, 0.5, 0.4][c]).abs() < 0.03, "channel {c} of the teapot: {share}");
    }
    // the shadow darkens the print beside the teapot, not the far table, never below its share
    let (shade, ..) =
        first("style = { name = \"plain\" }\n[retouch.shadow]\nstrength = 0.5\nsoftness = 0.2", &settings);
    let (mut darker, mut count) = (0, 0);
    for y in 0..SIZE.height {
        for x in 0..SIZE.width {
            for (a, b) in shade.at(x, y).into_iter().zip(plain.at(x, y)) {
                assert!(a <= b && f64::from(a) >= 0.5 * f64::from(b) - 1.0, "({x}, {y}): {a} of {b}");
                darker += usize::from(a < b);
                count += 1;
            }
        }
    }
    assert!((count / 200..count / 4).contains(&darker), "{darker} of {count} bytes are in the shadow");
}

#[test]
fn everything_at_once_is_the_same_for_any_threads_and_level() {
    let text = "[retouch.steady]\n[retouch.hide]\nmargin = 2.5\n[retouch.light]\n[retouch.shadow]\n\
        [style]\nname = \"cartoon\"\nfade_ms = 100\nanchored = true\ncycle = [\"cartoon\", \"watercolor\"]\n\
        [style.part]\nof = \"marker\"\nscale = 2";
    let (retouch, style) = retouched(text);
    let play = |threads: usize, level| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let mut camera = Synthetic::new(&SyntheticConfig::default(), SIZE, 30.0, simd::best());
            let mut pipeline = Pipeline::new(teapot(), camera.lens(), Default::default(), &style, level);
            pipeline = pipeline.retouched(&retouch);
            let mut frame = Frame::default();
            (0..6)
                .map(|number| {
                    assert!(camera.next(&mut frame));
                    if number == 2 {
                        pipeline.step_style(1);
                    }
                    pipeline.draw_frame(&frame).canvas.clone()
                })
                .collect::<Vec<_>>()
        })
    };
    let truth = play(1, simd::available()[0]);
    for threads in [1, 2, 4] {
        for level in simd::available() {
            assert!(play(threads, level) == truth, "{} with {threads} threads", simd::name(level));
        }
    }
}

#[test]
fn anchored_patterns_follow_the_marker() {
    // the table seen twice, the second time as if the camera had turned by whole pixels
    let settings = SyntheticConfig { noise: 0.0, pace: 0.0, ..SyntheticConfig::default() };
    let wide = Size::new(SIZE.width + 24, SIZE.height + 9);
    let mut camera = Synthetic::new(&settings, wide, 30.0, simd::best());
    let (mut whole, mut frame) = (Frame::default(), Frame::default());
    assert!(camera.next(&mut whole));
    let lens = vernissage::geometry::Lens { size: SIZE, ..camera.lens() };
    let crop = |left: usize, top: usize, frame: &mut Frame| {
        frame.resize(SIZE);
        for (to, from) in frame.color.planes.iter_mut().zip(&whole.color.planes) {
            (0..SIZE.height)
                .for_each(|y| to.row_mut(y).copy_from_slice(&from.row(top + y)[left..][..SIZE.width]));
        }
        for y in 0..SIZE.height {
            frame.luma.row_mut(y).copy_from_slice(&whole.luma.row(top + y)[left..][..SIZE.width]);
        }
    };
    for &name in StyleName::value_variants().iter().filter(|name| name.has_pattern()) {
        let mut still = [0.0; 2];
        for (anchored, still) in [false, true].into_iter().zip(&mut still) {
            let style = style::Config { anchored, ..named(name) };
            let model: ModelConfig = toml::from_str("file = \"teapot\"\nmarker = { id = 7 }\nscale = 0.001")
                .expect("a valid table");
            let scene =
                Scene::build(&[model], &LightConfig::default(), std::path::Path::new(".")).expect("a scene");
            let mut live = Pipeline::new(scene, lens, Default::default(), &style, simd::best());
            crop(0, 0, &mut frame);
            (0..3).for_each(|_| assert_eq!(live.draw_frame(&frame).sightings.len(), 1));
            let before = live.draw_frame(&frame).canvas.clone();
            let lens =
                vernissage::geometry::Lens { center: lens.center - glam::DVec2::new(23.0, 9.0), ..lens };
            live.set_lens(lens);
            crop(23, 9, &mut frame);
            let drawn = live.draw_frame(&frame);
            assert_eq!((drawn.sightings.len(), drawn.plan.anchor.runs), (1, anchored));
            let after = drawn.canvas;
            // pixels that look as they did where they then were
            let (mut same, mut count) = (0.0, 0.0);
            for (x, y) in (20..SIZE.height - 20).flat_map(|y| (20..SIZE.width - 50).map(move |x| (x, y))) {
                let [a, b] = [before.at(x + 23, y + 9), after.at(x, y)];
                same += f64::from(u8::from(a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 24)));
                count += 1.0;
            }
            *still = same / count;
        }
        let [loose, held] = still;
        assert!(held > 0.9 && held > loose, "{name}: {loose:.3} of the pixels alike without, {held:.3} with");
    }
}
