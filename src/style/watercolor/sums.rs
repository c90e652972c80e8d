//! One pass over the rows: edges, and what each cell holds. Sums are whole numbers, so no result depends on how rows
//! divide into bands.

use crate::kernel::band_rows;
use crate::kernel::contrast::{self, BLOCK, Weights};
use crate::kernel::sobel::Lines;
use crate::kernel::voronoi::Voronoi;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rgb};
use fearless_simd::{Simd, SimdBase, f32x8, i16x16};
use rayon::prelude::*;

/// What a cell holds.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    /// Sums of R and, 32 bits up, G; of B and the number of pixels.
    sums: [u64; 2],
    edges: u32,
    /// Sums of the columns and rows of edge pixels.
    edge_at: [u64; 2],
}

impl Cell {
    /// Sums of R, G, B.
    fn color(&self) -> [u32; 3] {
        [self.sums[0] as u32, (self.sums[0] >> 32) as u32, self.sums[1] as u32]
    }

    fn pixels(&self) -> u32 {
        (self.sums[1] >> 32) as u32
    }

    #[inline(always)]
    fn add(&mut self, sums: [u64; 2]) {
        self.sums = [self.sums[0].wrapping_add(sums[0]), self.sums[1].wrapping_add(sums[1])];
    }
}

/// The sums of all cells, and scratch space of the bands they are made in.
#[derive(Debug, Default)]
pub struct Sums {
    cells: Vec<Cell>,
    bands: Vec<Band>,
}

/// What one band of rows works in.
#[derive(Debug, Default)]
struct Band {
    lines: [Lines; 3],
    cells: Vec<Cell>,
    /// The labels that occur, `from..to`.
    from: usize,
    to: usize,
}

impl Sums {
    /// Finds the edges of `picture` (255 on an edge, else 0) and sums up its `count` cells. Allocates only when a
    /// size, a count or the number of threads grows.
    #[allow(clippy::too_many_arguments)] // borrowed parts of one style
    pub fn run(
        &mut self,
        level: Level,
        picture: &Rgb,
        voronoi: &Voronoi,
        count: usize,
        weights: Weights,
        threshold: f32,
        edges: &mut Plane<u8>,
    ) {
        let size = picture.size();
        let rows = band_rows(size.height, 32);
        let bands = size.height.div_ceil(rows.max(1));
        if self.bands.len() < bands {
            self.bands.resize_with(bands, Band::default);
        }
        for band in &mut self.bands[..bands] {
            band.lines.iter_mut().for_each(|lines| lines.fit(size.width));
            band.cells.resize(count, Cell::default());
        }
        let work = edges.view_mut().par_bands(rows).zip(&mut self.bands[..bands]);
        work.for_each(|((first, edges), band)| {
            dispatch!(level, simd => sum_band(simd, picture, voronoi, weights, threshold, first, band, edges));
        });
        self.cells.clear();
        self.cells.resize(count, Cell::default());
        for band in &self.bands[..bands] {
            for (all, part) in self.cells[band.from..band.to].iter_mut().zip(&band.cells[band.from..band.to])
            {
                all.add(part.sums);
                all.edges += part.edges;
                all.edge_at[0] += part.edge_at[0];
                all.edge_at[1] += part.edge_at[1];
            }
        }
    }

    /// Mean of channel `c` of cell `index`, 0..1; 0 in a cell without pixels.
    pub fn mean(&self, index: usize, c: usize) -> f32 {
        let cell = &self.cells[index];
        (f64::from(cell.color()[c]) / (255.0 * f64::from(cell.pixels().max(1)))) as f32
    }

    /// The cells' mean colors as bytes R, G, B, 0 in memory order.
    pub fn colors(&self, colors: &mut Vec<u32>) {
        let mean = |cell: &Cell| {
            let n = u64::from(cell.pixels().max(1));
            // floor(sum / n + 1/2)
            let byte = |sum: u32| ((2 * u64::from(sum) + n) / (2 * n)) as u8;
            let [r, g, b] = cell.color().map(byte);
            u32::from_le_bytes([r, g, b, 0])
        };
        colors.clear();
        colors.extend(self.cells.iter().map(mean));
    }

    /// Moves the sites of cells with at least `min_edge` edge pixels to their mean, on the lattice (section 3.3).
    pub fn retile(&self, min_edge: u32, sites: &mut [[i32; 2]]) {
        for (cell, site) in self.cells.iter().zip(sites) {
            if cell.edges >= min_edge {
                let n = u64::from(cell.edges);
                // floor(16 (sum / n + 1/2) + 1/2)
                *site = cell.edge_at.map(|sum| ((32 * sum + 17 * n) / (2 * n)) as i32);
            }
        }
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)] // as above
fn sum_band<S: Simd>(
    simd: S,
    picture: &Rgb,
    voronoi: &Voronoi,
    weights: Weights,
    threshold: f32,
    first: usize,
    band: &mut Band,
    mut edges: PlaneMut<'_, u8>,
) {
    let size = picture.size();
    let height = edges.size().height;
    let (mut least, mut most) = (u32::MAX, 0);
    for y in first..first + height {
        for &label in voronoi.row(y) {
            least = least.min(label);
            most = most.max(label);
        }
    }
    (band.from, band.to) = (least as usize, most as usize + 1);
    band.cells[band.from..band.to].fill(Cell::default());
    let quiet = i16x16::splat(simd, weights.quiet(threshold));
    let limit = f32x8::splat(simd, threshold);
    for (lines, plane) in band.lines.iter_mut().zip(&picture.planes) {
        lines.push(0, plane.row(first.saturating_sub(1)));
        lines.push(1, plane.row(first));
    }
    for y in 0..height {
        for (lines, plane) in band.lines.iter_mut().zip(&picture.planes) {
            lines.push(y + 2, plane.row((first + y + 1).min(size.height - 1)));
        }
        let labels = voronoi.row(first + y);
        let rgb = [0, 1, 2].map(|c| picture.planes[c].row(first + y));
        sum_row(labels, rgb, &mut band.cells);
        let row = edges.row_mut(y);
        row.fill(0);
        for block in 0..size.width.div_ceil(BLOCK) {
            let [r, g, b] = &band.lines;
            let x = BLOCK * block;
            let gradients = [r.gradient(simd, y, x), g.gradient(simd, y, x), b.gradient(simd, y, x)];
            let largest = contrast::largest(simd, &gradients);
            if !simd.any_true_mask16x16(simd.simd_gt_i16x16(largest, quiet)) {
                continue;
            }
            let [low, high] = contrast::response(simd, &gradients, weights);
            let low = simd.to_bitmask_mask32x8(simd.simd_gt_f32x8(low, limit));
            let high = simd.to_bitmask_mask32x8(simd.simd_gt_f32x8(high, limit));
            let mut bits = low | high << 8;
            bits &= (1 << BLOCK.min(size.width - x)) - 1;
            while bits != 0 {
                let x = x + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                row[x] = 255;
                let cell = &mut band.cells[labels[x] as usize];
                cell.edges += 1;
                cell.edge_at[0] += x as u64;
                cell.edge_at[1] += (first + y) as u64;
            }
        }
    }
}

/// Adds a row's pixels to their cells. Neighbors mostly share a cell, and each addition waits for the one before it;
/// so the row's quarters go side by side.
#[inline(always)]
fn sum_row(labels: &[u32], [r, g, b]: [&[u8]; 3], cells: &mut [Cell]) {
    let quarter = labels.len() / 4;
    let part = |k: usize| {
        let range = k * quarter..(k + 1) * quarter;
        (&labels[range.clone()], &r[range.clone()], &g[range.clone()], &b[range])
    };
    let parts = [part(0), part(1), part(2), part(3)];
    for x in 0..quarter {
        for (labels, r, g, b) in parts {
            cells[labels[x] as usize].add(packed([r[x], g[x], b[x]]));
        }
    }
    for x in 4 * quarter..labels.len() {
        cells[labels[x] as usize].add(packed([r[x], g[x], b[x]]));
    }
}

/// What a pixel adds to [`Cell::sums`].
#[inline(always)]
fn packed([r, g, b]: [u8; 3]) -> [u64; 2] {
    [u64::from(r) | u64::from(g) << 32, u64::from(b) | 1 << 32]
}

/// The edge response of every pixel.
pub fn responses(level: Level, picture: &Rgb, weights: Weights) -> Plane<f32> {
    let mut out = Plane::new(picture.size(), 0.0);
    let mut lines: [Lines; 3] = Default::default();
    lines.iter_mut().for_each(|lines| lines.fit(picture.size().width));
    dispatch!(level, simd => response_rows(simd, picture, weights, &mut lines, &mut out));
    out
}

#[inline(always)]
fn response_rows<S: Simd>(
    simd: S,
    picture: &Rgb,
    weights: Weights,
    lines: &mut [Lines; 3],
    out: &mut Plane<f32>,
) {
    let height = picture.size().height;
    for (row, y) in (0..height + 1).map(|y| (y, y.saturating_sub(1))) {
        for (lines, plane) in lines.iter_mut().zip(&picture.planes) {
            if row == 0 {
                lines.push(0, plane.row(0));
                lines.push(1, plane.row(0));
            } else {
                lines.push(y + 2, plane.row((y + 1).min(height - 1)));
            }
        }
        if row == 0 {
            continue;
        }
        for (block, to) in out.row_mut(y).chunks_mut(BLOCK).enumerate() {
            let [r, g, b] = &*lines;
            let x = BLOCK * block;
            let gradients = [r.gradient(simd, y, x), g.gradient(simd, y, x), b.gradient(simd, y, x)];
            let [low, high] = contrast::response(simd, &gradients, weights);
            let mut values = [0.0; BLOCK];
            low.store_slice(&mut values[..8]);
            high.store_slice(&mut values[8..]);
            to.copy_from_slice(&values[..to.len()]);
        }
    }
}
