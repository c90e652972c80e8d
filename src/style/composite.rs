//! Camera picture and model layer as one picture: what conventional AR shows, and what post-processing styles
//! filter.

use super::StyleInput;
use crate::frame::Layer;
use crate::pixels::{Rect, Rgb, Size, TileGrid};

/// The touched tiles of a layer; none of a layer of another size than the picture.
pub fn touched(layer: &Layer, size: Size) -> impl Iterator<Item = Rect> {
    let grid = layer.grid.filter(|grid| layer.depth.size() == size && *grid == TileGrid::new(size));
    let count = grid.map_or(0, |grid| grid.count());
    let tiles = layer.touched.iter().take_while(move |&tile| tile < count);
    tiles.filter_map(move |tile| Some(grid?.rect(tile)))
}

/// Puts the layer over `picture`: its color wherever its depth is finite. Looks only at touched tiles; a layer of
/// another size is left out.
pub fn over(layer: &Layer, picture: &mut Rgb) {
    let size = picture.size();
    if layer.color.size() != size {
        return;
    }
    for area in touched(layer, size) {
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

/// Whitens `picture` wherever the layer covers it.
pub fn whiten(layer: &Layer, picture: &mut Rgb) {
    for area in touched(layer, picture.size()) {
        for y in area.y0..area.y1 {
            let depth = &layer.depth.row(y)[area.x0..area.x1];
            for plane in &mut picture.planes {
                for (to, &z) in plane.row_mut(y)[area.x0..area.x1].iter_mut().zip(depth) {
                    *to = if z < f32::INFINITY { 255 } else { *to };
                }
            }
        }
    }
}

/// Blackens `picture` wherever the layer has a silhouette line.
pub fn outline(layer: &Layer, picture: &mut Rgb) {
    let size = picture.size();
    if layer.silhouette.size() != size {
        return;
    }
    for area in touched(layer, size) {
        for y in area.y0..area.y1 {
            let lines = &layer.silhouette.row(y)[area.x0..area.x1];
            for plane in &mut picture.planes {
                for (to, &line) in plane.row_mut(y)[area.x0..area.x1].iter_mut().zip(lines) {
                    *to &= !line;
                }
            }
        }
    }
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
