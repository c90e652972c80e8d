//! Camera picture and model layer as one picture: what conventional AR shows, and what post-processing styles
//! filter.

use super::StyleInput;
use crate::frame::Layer;
use crate::pixels::{Rgb, Size};

/// Puts the layer over `picture`: its color wherever its depth is finite. Looks only at touched tiles; a layer of
/// another size is left out.
pub fn over(layer: &Layer, picture: &mut Rgb) {
    let Some(grid) = layer.grid else { return };
    let size = picture.size();
    if layer.depth.size() != size || layer.color.size() != size || !covers(&grid, size) {
        return;
    }
    for tile in layer.touched.iter().take_while(|&tile| tile < grid.count()) {
        let area = grid.rect(tile);
        for y in area.y0..area.y1 {
            let depth = &layer.depth.row(y)[area.x0..area.x1];
            for (to, from) in picture.planes.iter_mut().zip(&layer.color.planes) {
                let to = &mut to.row_mut(y)[area.x0..area.x1];
                let from = &from.row(y)[area.x0..area.x1];
                for ((to, &from), &z) in to.iter_mut().zip(from).zip(depth) {
                    *to = if z < f32::INFINITY { from } else { *to };
                }
            }
        }
    }
}

fn covers(grid: &crate::pixels::TileGrid, size: Size) -> bool {
    *grid == crate::pixels::TileGrid::new(size)
}

/// The picture a post-processing style filters: the camera's own when nothing is in view, else `canvas` with the
/// layer over it. Allocates only when the size changes.
pub fn augmented<'a>(input: &StyleInput<'a>, canvas: &'a mut Rgb) -> &'a Rgb {
    match input.layer {
        Some(layer) if !layer.touched.is_empty() => {
            canvas.copy_from(&input.frame.color);
            over(layer, canvas);
            canvas
        }
        _ => &input.frame.color,
    }
}
