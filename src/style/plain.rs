//! Conventional augmented reality: the models over the camera picture, nothing stylized.

use super::{Style, StyleInput, composite};
use crate::pixels::Rgb;

/// The style without settings or state.
#[derive(Debug, Default)]
pub struct Plain;

impl Style for Plain {
    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        out.copy_from(&input.frame.color);
        if let Some(layer) = input.layer {
            composite::over(layer, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, Layer};
    use crate::pixels::{Plane, Size, TileGrid, TileSet};

    #[test]
    fn the_layer_covers_where_its_depth_is_finite() {
        let size = Size::new(70, 3);
        let frame = Frame { luma: Plane::new(size, 9), color: Rgb::new(size, [1, 2, 3]), ..Frame::default() };
        let grid = TileGrid::new(size);
        let mut touched = TileSet::new(grid);
        touched.insert(1);
        let depth = Plane::from_fn(size, |x, _| if x % 2 == 0 { 5.0 } else { f32::INFINITY });
        let layer =
            Layer { color: Rgb::new(size, [7, 8, 9]), depth, touched, grid: Some(grid), ..Layer::default() };
        let mut out = Rgb::default();
        Plain.draw(StyleInput { frame: &frame, layer: Some(&layer) }, &mut out);
        assert_eq!(out.at(66, 1), [7, 8, 9], "covered, touched tile");
        assert_eq!(out.at(67, 1), [1, 2, 3], "touched tile, nothing there");
        assert_eq!(out.at(2, 1), [1, 2, 3], "tile the renderer did not touch");
        Plain.draw(StyleInput { frame: &frame, layer: None }, &mut out);
        assert_eq!(out, frame.color);
    }
}
