//! The styles: camera picture and model layer become the canvas.
//!
//! One file (or folder) a style, each with its `Config`; `Style` is their contract, `Styler` the dispatch.

use crate::frame::{Frame, Layer, Needs};
use crate::pixels::Rgb;

/// What a style draws from.
#[derive(Clone, Copy)]
pub struct StyleInput<'a> {
    /// The camera picture.
    pub frame: &'a Frame,
    /// The drawn models; `None` when nothing is in view.
    pub layer: Option<&'a Layer>,
}

/// The contract of a style: the same input, settings and sequence number give the same bytes for any thread
/// count and SIMD level, and nothing is allocated once the picture size has been seen.
pub trait Style {
    /// What it wants from the renderer.
    const NEEDS: Needs;

    /// Draws one frame; `out` has the frame's size.
    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb);
}
