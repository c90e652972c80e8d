//! What happens between frames and around the styles: switching, and later the retouches, each held to what it says.

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
    // re-tiled from frame to frame: must begin when it is asked for
    let mut new = pipeline(teapot(), &camera, &named(StyleName::Watercolor));
    let mut frame = Frame::default();
    let mut shares = Vec::new();
    for number in 0..10 {
        assert!(camera.next(&mut frame));
        if number == 4 {
            live.switch(&named(StyleName::Watercolor));
            assert!(live.plan(View::Models(1)).fade.runs);
            assert_eq!(live.style(), StyleName::Watercolor);
        }
        let before = old.draw_frame(&frame).canvas.clone();
        let after = if number < 4 { Rgb::default() } else { new.draw_frame(&frame).canvas.clone() };
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
    for name in [StyleName::Cartoon, StyleName::Illustrative, StyleName::Cartoon] {
        assert!(camera.next(&mut frame));
        let alone = pipeline(teapot(), &camera, &style(name)).draw_frame(&frame).canvas.clone();
        assert!(*live.draw_frame(&frame).canvas == alone, "{name}");
        live.step_style(1);
    }
}
