//! The watercolor style (Chen, Turk & MacIntyre 2008, "Watercolor Inspired Non-Photorealistic Rendering for Augmented
//! Reality"): colors bleed over the edges of the picture in Voronoi cells that lean on those edges.
//!
//! 1. Every pixel is labeled with its nearest site, exactly (`voronoi`); sites start on a jittered grid (`sites`).
//! 2. Edges are found in YUV and RGB (`contrast`) and each cell's colors and edge pixels are summed (`sums`).
//! 3. A pixel gets its cell's mean color; an edge pixel is black.
//! 4. Re-tiling: a cell with enough edge pixels moves its site to their mean, for the next frame. Labels stay where
//!    no site near them moves.
//!
//! So a frame depends on the ones before it through the sites alone: the same sequence always gives the same bytes,
//! and [`Watercolor::restart`] begins a sequence anew. Objects are drawn by a
//! toon shader of three steps (section 3.2) and filtered with the picture.

mod anchored;
pub mod cells;
mod reference;
mod sites;
mod sums;

pub use reference::reference;
pub use sites::{Sites, SitesFile, initial};

use super::{ConfigError, Style, StyleInput, StyleName, composite};
use crate::frame::Needs;
use crate::geometry::Similarity;
use crate::kernel::band_rows;
use crate::kernel::contrast::Weights;
use crate::kernel::voronoi::Voronoi;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb, Size};
use crate::render::Look;
use crate::scene::Shading;
use anchored::Anchored;
use fearless_simd::Simd;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sums::Sums;

/// Settings of the watercolor style; the paper's where it gives them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Side of a cell before re-tiling, px, 2 to 512. Default 8 (80x60 cells at 640x480).
    pub cell: u32,
    /// Share of color contrast (against brightness contrast) in the YUV response, 0 to 1. Default 0.3.
    pub alpha: f32,
    /// Share of the YUV response (against the RGB response) in an edge, 0 to 1. Default 0.5.
    pub beta: f32,
    /// Response above which a pixel is an edge, 0 to 10. Default 0.15.
    pub threshold: f32,
    /// Edge pixels a cell holds at least when its site moves, 1 or more. Default 4.
    pub min_edge: u32,
    /// Frames from one re-tiling to the next, 1 or more. Default 1 (the paper's 10 was a concession to its GPU).
    pub retile_every: u32,
    /// Seed of the jittered grid, 0 to 2^63 - 1. Default 2008.
    pub seed: u64,
    /// A .npy file of sites (N x 2, x and y in px, the frame being `[0,W]x[0,H]`) to begin with in place of the
    /// jittered grid; relative to the working directory; rounded to 1/16 px. Default "" (the grid).
    pub sites: SitesFile,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            cell: 8,
            alpha: 0.3,
            beta: 0.5,
            threshold: 0.15,
            min_edge: 4,
            retile_every: 1,
            seed: 2008,
            sites: SitesFile::default(),
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f64, fine: bool, expected| match fine {
            true => Ok(()),
            false => Err(ConfigError::Range { style: StyleName::Watercolor, key, value, expected }),
        };
        check("cell", self.cell.into(), (2..=512).contains(&self.cell), "2 to 512 pixels")?;
        for (key, value) in [("alpha", self.alpha), ("beta", self.beta)] {
            check(key, value.into(), (0.0..=1.0).contains(&value), "a number from 0 to 1")?;
        }
        let threshold = self.threshold;
        check("threshold", threshold.into(), (0.0..=10.0).contains(&threshold), "0 to 10")?;
        check("min_edge", self.min_edge.into(), self.min_edge >= 1, "1 or more pixels")?;
        check("retile_every", self.retile_every.into(), self.retile_every >= 1, "1 or more frames")?;
        check("seed", self.seed as f64, self.seed <= i64::MAX as u64, "0 to 2^63 - 1")
    }

    fn weights(&self) -> Weights {
        let chroma = self.beta * self.alpha * 0.5;
        let yuv = [self.beta * (1.0 - self.alpha), chroma, chroma];
        Weights { yuv, rgb: (1.0 - self.beta) / 3.0 }
    }
}

/// The style with its sites and buffers.
pub struct Watercolor {
    config: Config,
    level: Level,
    canvas: Rgb,
    /// The frame size that `initial` and `sites` are for.
    size: Size,
    initial: Vec<[i32; 2]>,
    sites: Vec<[i32; 2]>,
    frames: u64,
    voronoi: Voronoi,
    /// How the scene has moved, where the pattern moves with it.
    motion: Option<Similarity>,
    anchored: Anchored,
    /// The sites before re-tiling.
    unmoved: Vec<[i32; 2]>,
    edges: Plane<u8>,
    sums: Sums,
    colors: Vec<u32>,
}

/// The intermediate planes of one frame, for inspection.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stages {
    /// Index of every pixel's nearest site.
    pub labels: Plane<f32>,
    /// Mean color of every cell, a row a cell: R, G, B in 0..1; 0 where a cell has no pixel.
    pub means: Plane<f32>,
    /// Edge response.
    pub response: Plane<f32>,
    /// 1 on an edge, else 0.
    pub edge: Plane<f32>,
    /// The sites for the next frame, a row a site: x, y in px.
    pub sites: Plane<f32>,
    /// This frame's cells as polygons (see [`cells::polygons`]).
    pub cells: Vec<Vec<[f64; 2]>>,
}

impl Watercolor {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            config,
            level,
            canvas: Rgb::default(),
            size: Size::new(0, 0),
            initial: Vec::new(),
            sites: Vec::new(),
            frames: 0,
            voronoi: Voronoi::default(),
            motion: None,
            anchored: Anchored::default(),
            unmoved: Vec::new(),
            edges: Plane::default(),
            sums: Sums::default(),
            colors: Vec::new(),
        }
    }

    /// Forgets where earlier frames moved the sites.
    pub fn restart(&mut self) {
        self.sites.clone_from(&self.initial);
        self.frames = 0;
        self.voronoi.forget();
        self.anchored.restart();
    }

    /// Carries the cells along (see [`super::Styler::anchor`]); they then come from an endless lattice.
    pub fn anchor(&mut self, motion: Option<Similarity>) {
        if self.motion.is_some() != motion.is_some() {
            self.restart();
        }
        self.motion = motion;
    }

    /// The intermediate planes of one frame, which counts as drawn; the picture goes to `out`. Slower than drawing,
    /// and it allocates.
    pub fn stages(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Stages {
        let mut canvas = Rgb::default();
        let picture = composite::augmented(&input, &mut canvas);
        let size = picture.size();
        self.fit(size);
        let cells = cells::polygons(&self.sites, size);
        self.draw(input, out);
        let count = self.sites.len();
        Stages {
            labels: Plane::from_fn(size, |x, y| self.voronoi.row(y)[x] as f32),
            means: Plane::from_fn(Size::new(3, count), |c, i| self.sums.mean(i, c)),
            response: sums::responses(self.level, picture, self.config.weights()),
            edge: Plane::from_fn(size, |x, y| f32::from(self.edges.at(x, y) & 1)),
            sites: Plane::from_fn(Size::new(2, count), |c, i| self.sites[i][c] as f32 / 16.0),
            cells,
        }
    }

    /// Takes the frame size; new sites when it is another than before.
    fn fit(&mut self, size: Size) {
        if self.size != size {
            self.size = size;
            self.initial = match self.config.sites.sites() {
                Some(sites) => sites.to_vec(),
                None => initial(size, self.config.cell, self.config.seed),
            };
            self.restart();
        }
    }
}

impl Style for Watercolor {
    fn look(&self) -> Look {
        Look { shading: Some(Shading::ThreeSteps), ..Needs::COLOR.into() }
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let mut canvas = std::mem::take(&mut self.canvas);
        let picture = composite::augmented(&input, &mut canvas);
        let size = picture.size();
        out.resize(size);
        if size.area() > 0 {
            self.fit(size);
            if let Some(motion) = &self.motion {
                let side = f64::from(self.config.cell);
                self.anchored.place(motion, size, side, self.config.seed, &mut self.sites);
            }
            self.voronoi.run(self.level, size, &self.sites);
            let (weights, threshold) = (self.config.weights(), self.config.threshold);
            self.edges.resize(size, 0);
            let count = self.sites.len();
            self.sums.run(self.level, picture, &self.voronoi, count, weights, threshold, &mut self.edges);
            self.sums.colors(&mut self.colors);
            paint(self.level, &self.voronoi, &self.edges, &self.colors, out);
            self.frames += 1;
            if self.frames.is_multiple_of(u64::from(self.config.retile_every.max(1))) {
                if self.motion.is_some() {
                    self.unmoved.clone_from(&self.sites);
                }
                self.sums.retile(self.config.min_edge, &mut self.sites);
                if let Some(motion) = &self.motion {
                    self.anchored.keep(motion, &self.unmoved, &self.sites);
                }
            }
        }
        self.canvas = canvas;
    }
}

/// Every pixel its cell's color, black on edges.
fn paint(level: Level, voronoi: &Voronoi, edges: &Plane<u8>, colors: &[u32], out: &mut Rgb) {
    let rows = band_rows(edges.size().height, 8);
    let [r, g, b] = &mut out.planes;
    let bands = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
    bands.zip(b.view_mut().par_bands(rows)).for_each(|(((first, mut r), (_, mut g)), (_, mut b))| {
        for y in 0..r.size().height {
            let (labels, edges) = (voronoi.row(first + y), edges.row(first + y));
            let rgb = [r.row_mut(y), g.row_mut(y), b.row_mut(y)];
            dispatch!(level, simd => paint_row(simd, labels, edges, colors, rgb));
        }
    });
}

#[inline(always)]
fn paint_row<S: Simd>(simd: S, labels: &[u32], edges: &[u8], colors: &[u32], [r, g, b]: [&mut [u8]; 3]) {
    let _ = simd;
    let n = labels.len();
    let (edges, r, g, b) = (&edges[..n], &mut r[..n], &mut g[..n], &mut b[..n]);
    for x in 0..n {
        let [red, green, blue, _] = colors[labels[x] as usize].to_le_bytes();
        let keep = !edges[x];
        (r[x], g[x], b[x]) = (red & keep, green & keep, blue & keep);
    }
}
