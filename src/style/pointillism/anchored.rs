//! Sites that move with the scene: one a cell of an endless lattice, as many a pixel as the grid has. All of a site
//! comes from the numbers of its cell, its turn to be drawn included, so that strokes stay what they are.

use super::grid::{MAX_RADIUS, Site, Spread};
use crate::geometry::Similarity;
use crate::pixels::{Size, hash_noise};
use crate::style::lattice::Window;
use glam::DVec2;

/// The cells around the picture.
#[derive(Debug, Default)]
pub(super) struct Anchored {
    /// Where each comes in the drawing order, and which it is.
    cells: Vec<(u64, [i32; 2])>,
}

impl Anchored {
    /// Puts the sites of all strokes that may touch the picture into `sites`, in drawing order; `motion`: picture px →
    /// pattern. Returns how many there may be while the pattern's scale is 2 at most; allocates only when that grows.
    pub fn place(
        &mut self,
        spread: &Spread,
        motion: &Similarity,
        size: Size,
        sites: &mut Vec<Site>,
    ) -> usize {
        let side = spread.skip.map(f64::from).iter().product::<f64>().max(1.0).sqrt();
        let (back, range, [least, most]) = (motion.inverse(), f64::from(spread.range), spread.radius);
        let zoom = back.scale();
        let radius = |radius: u32| (f64::from(radius) * zoom + 0.5).min(f64::from(MAX_RADIUS.min(2 * most)));
        // sites up to a radius outside the picture, which may come from cells up to a range farther
        let margin = radius(most).ceil();
        let corner = DVec2::splat(margin + (range * zoom).ceil());
        let around = grown(size, corner.x);
        let from = motion.after(&Similarity { shift: -corner, ..Similarity::IDENTITY });
        let outer = grown(size, f64::from(MAX_RADIUS.min(2 * most)));
        let bound = (4.5 * outer.area() as f64 / (side * side)) as usize + 4096;

        self.cells.clear();
        sites.clear();
        self.cells.reserve(bound);
        sites.reserve(bound);
        let hash = |[column, row]: [i32; 2], which| hash_noise(column as u32, row as u32, spread.seed, which);
        let at = |cell: [i32; 2]| {
            let bits = hash(cell, 0);
            let moved = |bits: u64| (2.0 * share(bits, 32) - 1.0) * range;
            let [column, row] = cell.map(|v| (f64::from(v) + 0.5) * side);
            (back.apply(DVec2::new(column + moved(bits), row + moved(bits >> 32))) + 0.5).floor()
        };
        let far = DVec2::new(size.width as f64 + margin, size.height as f64 + margin);
        for cell in Window::over(&from, around, side).cells() {
            let at = at(cell);
            if at.cmpge(DVec2::splat(-margin)).all() && at.cmplt(far).all() {
                self.cells.push((hash(cell, 1), cell));
            }
        }
        self.cells.sort_unstable();
        sites.extend(self.cells.iter().map(|&(_, cell)| {
            let (at, size, color) = (at(cell), hash(cell, 2), hash(cell, 3));
            let chosen = least + (size % (u64::from(most.saturating_sub(least)) + 1)) as u32;
            let offset = [0, 21, 42].map(|bit| (2.0 * share(color >> bit, 21) - 1.0) * spread.color_offset);
            Site { x: at.x as i32, y: at.y as i32, radius: radius(chosen) as u32, offset }
        }));
        bound.max(sites.len())
    }
}

/// The low `count` bits as a number from 0 to below 1.
fn share(bits: u64, count: u32) -> f64 {
    (bits & ((1 << count) - 1)) as f64 / (1u64 << count) as f64
}

/// A size with a margin on all sides.
fn grown(size: Size, margin: f64) -> Size {
    Size::new(size.width + 2 * margin as usize, size.height + 2 * margin as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_stay_what_they_are() {
        let size = Size::new(160, 120);
        let spread = Spread { skip: [5, 4], range: 3, radius: [4, 7], color_offset: 0.06, seed: 2005 };
        let (mut anchored, mut here, mut there) = (Anchored::default(), Vec::new(), Vec::new());
        let most = anchored.place(&spread, &Similarity::IDENTITY, size, &mut here);
        assert!((32 * 30..most).contains(&here.len()));
        // the pattern lies 9 px further left and 4 px further down in the picture
        let shift = Similarity { shift: DVec2::new(9.0, -4.0), ..Similarity::IDENTITY };
        anchored.place(&spread, &shift, size, &mut there);
        let carried = here.iter().map(|site| Site { x: site.x - 9, y: site.y + 4, ..*site });
        let inside = |site: &Site| (0..150).contains(&site.x) && (5..120).contains(&site.y);
        let carried: Vec<Site> = carried.filter(inside).collect();
        there.retain(inside);
        assert!(carried.len() > 800 && carried == there, "the same strokes in the same order");
        // twice as near: strokes are larger, fewer
        let near = Similarity { turn: DVec2::new(0.5, 0.0), ..Similarity::IDENTITY };
        anchored.place(&spread, &near, size, &mut there);
        assert!(there.iter().all(|site| (8..=14).contains(&site.radius)) && 3 * there.len() < 2 * here.len());
    }
}
