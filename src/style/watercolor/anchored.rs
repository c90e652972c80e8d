//! Sites that move with the scene: one in every cell of an endless lattice, carried along, and how far re-tiling has
//! moved each from its place.

use crate::geometry::Similarity;
use crate::pixels::Size;
use crate::style::lattice::{Window, place};
use glam::DVec2;

/// Sites farther than this outside the picture are left out, cells.
const MARGIN: f64 = 2.0;

/// The cells around the picture and where their sites are.
#[derive(Debug, Default)]
pub struct Anchored {
    window: Window,
    /// Where each cell's site is, pattern px.
    at: Vec<DVec2>,
    before: Vec<DVec2>,
    /// The cells whose sites are in use, in the order of the sites.
    used: Vec<u32>,
}

impl Anchored {
    /// Puts the sites of all cells in or near the picture into `sites`, in steps of 1/16 px of the continuous frame;
    /// `motion`: picture px → pattern. Cells that come into view have their site where the lattice has it.
    pub fn place(
        &mut self,
        motion: &Similarity,
        size: Size,
        side: f64,
        seed: u64,
        sites: &mut Vec<[i32; 2]>,
    ) {
        let window = Window::over(motion, size, side);
        std::mem::swap(&mut self.at, &mut self.before);
        self.at.clear();
        self.used.clear();
        sites.clear();
        // as many as the finest pattern can have, so that moving on allocates nothing
        let most = 8 * (size.area() as f64 / (side * side)) as usize + 4096;
        let most = most.max(window.len());
        self.at.reserve(most);
        self.before.reserve(most - self.before.len().min(most));
        self.used.reserve(most);
        sites.reserve(most);
        let back = motion.inverse();
        let margin = MARGIN * side * back.scale();
        let fits = |v: f64, length: usize| v > -margin && v < length as f64 + margin;
        for (index, cell) in window.cells().enumerate() {
            let known = self.window.index(cell).and_then(|old| self.before.get(old));
            let at = known.copied().unwrap_or_else(|| place(cell, side, seed));
            self.at.push(at);
            let site = back.apply(at) + 0.5;
            if fits(site.x, size.width) && fits(site.y, size.height) {
                self.used.push(index as u32);
                sites.push([site.x, site.y].map(|v| (16.0 * v + 0.5).floor() as i32));
            }
        }
        self.window = window;
    }

    /// Takes over where re-tiling has moved the sites to.
    pub fn keep(&mut self, motion: &Similarity, before: &[[i32; 2]], sites: &[[i32; 2]]) {
        for ((&index, before), site) in self.used.iter().zip(before).zip(sites) {
            // a site that stays keeps what the lattice of 1/16 px has rounded away
            if before != site {
                let [x, y] = site.map(|v| f64::from(v) / 16.0 - 0.5);
                self.at[index as usize] = motion.apply(DVec2::new(x, y));
            }
        }
    }

    /// Forgets what re-tiling did.
    pub fn restart(&mut self) {
        self.window = Window::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sites_move_with_the_scene_and_come_back() {
        let size = Size::new(160, 120);
        let shifted = |x: f64, y: f64| Similarity { shift: DVec2::new(x, y), ..Similarity::IDENTITY };
        let (mut anchored, mut here, mut there) = (Anchored::default(), Vec::new(), Vec::new());
        anchored.place(&Similarity::IDENTITY, size, 8.0, 1, &mut here);
        assert!(here.len() >= 20 * 15);
        // the pattern lies 5 px further right in the picture
        anchored.place(&shifted(-5.0, 2.0), size, 8.0, 1, &mut there);
        let inside = |site: &&[i32; 2]| (0..16 * 150).contains(&site[0]) && (48..16 * 120).contains(&site[1]);
        for site in here.iter().filter(inside) {
            assert!(there.contains(&[site[0] + 80, site[1] - 32]), "{site:?}");
        }
        // a site that re-tiling moved is still moved when it was carried there and back
        anchored.place(&Similarity::IDENTITY, size, 8.0, 1, &mut here);
        let mut retiled = here.clone();
        retiled[200] = [777, 888];
        anchored.keep(&Similarity::IDENTITY, &here, &retiled);
        anchored.place(&shifted(-5.0, 2.0), size, 8.0, 1, &mut there);
        assert!(there.contains(&[777 + 80, 888 - 32]));
        anchored.restart();
        anchored.place(&Similarity::IDENTITY, size, 8.0, 1, &mut there);
        assert_eq!(there, here);
    }
}
