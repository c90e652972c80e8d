//! The styles: camera picture and model layer become the canvas.
//!
//! One file (or folder) a style, each with its `Config`; [`Style`] is their contract, [`Styler`] the dispatch.
//! A style keeps its buffers, reads a [`StyleInput`], and writes every pixel of the canvas; it never draws
//! models (the renderer does) and never looks at markers.

pub mod bilateral;
pub mod brush;
pub mod cartoon;
pub mod composite;
mod config;
pub mod illustrative;
mod lattice;
pub mod plain;
pub mod pointillism;
pub mod sketchy;
mod table;
pub mod watercolor;

pub use config::{Config, ConfigError, StyleName};

use crate::frame::{Frame, Layer, Needs};
use crate::geometry::Similarity;
use crate::pixels::Rgb;
use crate::pixels::simd::Level;
use crate::render::Look;

/// What a style draws from.
#[derive(Clone, Copy)]
pub struct StyleInput<'a> {
    /// The camera picture.
    pub frame: &'a Frame,
    /// The drawn models; `None` when nothing is in view.
    pub layer: Option<&'a Layer>,
}

/// The contract of a style: the same frames in the same order give the same bytes for any thread count and SIMD
/// level, and nothing is allocated once the picture size has been seen.
pub trait Style {
    /// What it wants from the renderer: color alone, unless it says otherwise.
    fn look(&self) -> Look {
        Needs::COLOR.into()
    }

    /// Draws one frame; `out` is fitted to the frame's size.
    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb);
}

/// The style that `config` names in plain f64, over a picture with no model in view (for cartoon and watercolor,
/// which filter camera picture and models alike, an augmented one): slow, for tests and benchmarks.
pub fn reference(config: &Config, augmented: &Rgb) -> Rgb {
    match config.name {
        StyleName::Plain => augmented.clone(),
        StyleName::Cartoon => cartoon::reference(&config.cartoon, augmented),
        StyleName::BilateralCartoon => bilateral::reference(&config.bilateral_cartoon, augmented),
        StyleName::SketchLike => bilateral::sketch_reference(&config.sketch_like, augmented),
        StyleName::Watercolor => watercolor::reference(&config.watercolor, augmented),
        StyleName::Illustrative => illustrative::reference(&config.illustrative, augmented),
        StyleName::Pointillism => pointillism::reference(&config.pointillism, augmented),
        StyleName::Sketchy => sketchy::reference(&config.sketchy, augmented),
    }
}

/// One of the styles, ready to draw.
pub enum Styler {
    /// Conventional augmented reality.
    Plain(plain::Plain),
    /// The cartoon filter.
    Cartoon(Box<cartoon::Cartoon>),
    /// The bilateral cartoon filter.
    BilateralCartoon(Box<bilateral::BilateralCartoon>),
    /// Its edges alone.
    SketchLike(Box<bilateral::SketchLike>),
    /// Voronoi cells of mean color.
    Watercolor(Box<watercolor::Watercolor>),
    /// Edges and hatching on paper.
    Illustrative(Box<illustrative::Illustrative>),
    /// Small brush strokes.
    Pointillism(Box<pointillism::Pointillism>),
    /// A blurred picture on paper under pencil strokes.
    Sketchy(Box<sketchy::Sketchy>),
}

impl Styler {
    /// The style that `config` names, its bodies at `level`. Settings are taken as they are: see
    /// [`Config::validate`].
    pub fn new(config: &Config, level: Level) -> Self {
        match config.name {
            StyleName::Plain => Styler::Plain(plain::Plain),
            StyleName::Cartoon => Styler::Cartoon(Box::new(cartoon::Cartoon::new(config.cartoon, level))),
            StyleName::BilateralCartoon => {
                let style = bilateral::BilateralCartoon::new(config.bilateral_cartoon, level);
                Styler::BilateralCartoon(Box::new(style))
            }
            StyleName::SketchLike => {
                Styler::SketchLike(Box::new(bilateral::SketchLike::new(config.sketch_like, level)))
            }
            StyleName::Watercolor => {
                let config = config.watercolor.clone();
                Styler::Watercolor(Box::new(watercolor::Watercolor::new(config, level)))
            }
            StyleName::Illustrative => {
                Styler::Illustrative(Box::new(illustrative::Illustrative::new(config.illustrative, level)))
            }
            StyleName::Pointillism => {
                let config = config.pointillism.clone();
                Styler::Pointillism(Box::new(pointillism::Pointillism::new(config, level)))
            }
            StyleName::Sketchy => {
                Styler::Sketchy(Box::new(sketchy::Sketchy::new(config.sketchy.clone(), level)))
            }
        }
    }

    /// Which style this is.
    pub fn name(&self) -> StyleName {
        match self {
            Styler::Plain(_) => StyleName::Plain,
            Styler::Cartoon(_) => StyleName::Cartoon,
            Styler::BilateralCartoon(_) => StyleName::BilateralCartoon,
            Styler::SketchLike(_) => StyleName::SketchLike,
            Styler::Watercolor(_) => StyleName::Watercolor,
            Styler::Illustrative(_) => StyleName::Illustrative,
            Styler::Pointillism(_) => StyleName::Pointillism,
            Styler::Sketchy(_) => StyleName::Sketchy,
        }
    }

    /// What it wants from the renderer.
    pub fn look(&self) -> Look {
        match self {
            Styler::Plain(style) => style.look(),
            Styler::Cartoon(style) => style.look(),
            Styler::BilateralCartoon(style) => style.look(),
            Styler::SketchLike(style) => style.look(),
            Styler::Watercolor(style) => style.look(),
            Styler::Illustrative(style) => style.look(),
            Styler::Pointillism(style) => style.look(),
            Styler::Sketchy(style) => style.look(),
        }
    }

    /// Whether it changes the camera picture itself.
    pub fn filters(&self) -> bool {
        !matches!(self, Styler::Plain(_))
    }

    /// Forgets what earlier frames left behind: the next frame is drawn as a first one.
    pub fn restart(&mut self) {
        match self {
            Styler::Watercolor(style) => style.restart(),
            Styler::Sketchy(style) => style.restart(),
            _ => {}
        }
    }

    /// Says how the scene has moved before a frame is drawn: picture px → px of the plane that the style's pattern
    /// lies in. `None`: the pattern is the picture's, as in a still. Styles without a pattern do not care.
    pub fn anchor(&mut self, motion: Option<Similarity>) {
        match self {
            Styler::Watercolor(style) => style.anchor(motion),
            Styler::Illustrative(style) => style.anchor(motion),
            Styler::Pointillism(style) => style.anchor(motion),
            Styler::Sketchy(style) => style.anchor(motion),
            _ => {}
        }
    }

    /// Draws one frame; `out` is fitted to the frame's size.
    pub fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        match self {
            Styler::Plain(style) => style.draw(input, out),
            Styler::Cartoon(style) => style.draw(input, out),
            Styler::BilateralCartoon(style) => style.draw(input, out),
            Styler::SketchLike(style) => style.draw(input, out),
            Styler::Watercolor(style) => style.draw(input, out),
            Styler::Illustrative(style) => style.draw(input, out),
            Styler::Pointillism(style) => style.draw(input, out),
            Styler::Sketchy(style) => style.draw(input, out),
        }
    }
}
