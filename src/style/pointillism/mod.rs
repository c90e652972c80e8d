//! The pointillism style (Fischer & Bartz 2005, "A Pointillism Style for the Non-Photorealistic Display of Augmented
//! Reality Scenes"; Fischer 2006, section 3.4): the picture in thousands of small brush strokes.
//!
//! 1. A grid of sampling points, each with a radius and a color offset, is made once a frame size (`grid`).
//! 2. The camera picture is drawn as one stroke a sampling point, in the grid's shuffled order (`paint`), each the
//!    brush (`sprite`) in the color of the pixel it lies on.
//! 3. Models come as particles, far to near. Each is one more stroke, in its own color, of the sampling point nearest
//!    to its pixel; nearer ones paint over those behind (the painter's algorithm).
//!
//! The grid stays where it is, unless it is anchored (`anchored`), and every frame is drawn from scratch.

mod anchored;
mod grid;
mod paint;
mod reference;
mod sprite;

pub use grid::{GridFile, Site};
pub use reference::{reference, reference_with_models};

use super::brush::BrushFile;
use super::{ConfigError, Style, StyleInput, StyleName};
use crate::frame::{Needs, Particle};
use crate::geometry::Similarity;
use crate::kernel::voronoi::{LATTICE, Voronoi};
use crate::pixels::simd::Level;
use crate::pixels::{Plane, Rgb, Size};
use crate::render::{Look, Scatter};
use anchored::Anchored;
use grid::{MAX_RADIUS, Spread};
use paint::{Blocks, Easel, Painting, Stroke};
use serde::{Deserialize, Serialize};
use sprite::Stamps;

/// Settings of the pointillism style; the papers' where they give them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Columns from one stroke to the next before they are moved, px, 1 to 256. Default 5.
    pub col_skip: u32,
    /// Rows from one stroke to the next before they are moved, px, 1 to 256. Default 5.
    pub row_skip: u32,
    /// Farthest a stroke is moved along each axis, px, 0 to 256. Default 3.
    pub range: u32,
    /// Smallest radius of a stroke, px, 0 to 64. Default 4.
    pub radius_min: u32,
    /// Largest radius of a stroke, px, `radius_min` to 64. Default 7.
    pub radius_max: u32,
    /// Largest change of a stroke's red, green and blue, 0 to 1. Default 0.06.
    pub color_offset: f64,
    /// Opacity of a stroke where the brush is white, 0 to 1. Default 0.85.
    pub opacity: f64,
    /// Points that each model is drawn with, 0 to 1,000,000. Default 20000.
    pub num_particles: u32,
    /// Seed of the grid and of the models' points, 0 to 2^63 - 1. Default 2005.
    pub seed: u64,
    /// A gray picture to use as the brush, white = opaque; relative to the working directory. Default "" (built in).
    pub sprite: BrushFile,
    /// A .npy file (N x 6: x, y, radius, dr, dg, db, in drawing order; px and shares of full brightness) to use as the
    /// grid for every frame size; relative to the working directory. Default "" (made anew).
    pub grid: GridFile,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            col_skip: 5,
            row_skip: 5,
            range: 3,
            radius_min: 4,
            radius_max: 7,
            color_offset: 0.06,
            opacity: 0.85,
            num_particles: 20_000,
            seed: 2005,
            sprite: BrushFile::default(),
            grid: GridFile::default(),
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f64, fine: bool, expected| match fine {
            true => Ok(()),
            false => Err(ConfigError::Range { style: StyleName::Pointillism, key, value, expected }),
        };
        for (key, value) in [("col_skip", self.col_skip), ("row_skip", self.row_skip)] {
            check(key, value.into(), (1..=256).contains(&value), "1 to 256 pixels")?;
        }
        check("range", self.range.into(), self.range <= 256, "0 to 256 pixels")?;
        let (least, most) = (self.radius_min, self.radius_max);
        check("radius_min", least.into(), least <= MAX_RADIUS, "0 to 64 pixels")?;
        let fits = (least..=MAX_RADIUS).contains(&most);
        check("radius_max", most.into(), fits, "radius_min to 64 pixels")?;
        for (key, value) in [("color_offset", self.color_offset), ("opacity", self.opacity)] {
            check(key, value, (0.0..=1.0).contains(&value), "a number from 0 to 1")?;
        }
        let count = self.num_particles;
        check("num_particles", count.into(), count <= 1_000_000, "0 to 1000000")?;
        check("seed", self.seed as f64, self.seed <= i64::MAX as u64, "0 to 2^63 - 1")
    }

    /// The grid for a frame of `size`, in drawing order.
    pub fn sites(&self, size: Size) -> Vec<Site> {
        if let Some(sites) = self.grid.sites() {
            return sites.to_vec();
        }
        self.spread().sites(size)
    }

    fn spread(&self) -> Spread {
        Spread {
            skip: [self.col_skip, self.row_skip],
            range: self.range,
            radius: [self.radius_min, self.radius_max],
            color_offset: self.color_offset,
            seed: self.seed,
        }
    }
}

/// The style with its grid and buffers.
pub struct Pointillism {
    config: Config,
    level: Level,
    /// Picture → pattern, when anchored.
    motion: Option<Similarity>,
    anchored: Anchored,
    /// The frame size and motion that the sites are for.
    laid: Option<(Size, Option<Similarity>)>,
    sites: Vec<Site>,
    stamps: Stamps,
    /// The camera picture's strokes.
    strokes: Blocks,
    /// Which site is nearest to each pixel, where `mapped`: once a model has been seen.
    map: Voronoi,
    mapped: bool,
    /// The sites' places for it.
    places: Vec<[i32; 2]>,
    /// The models' strokes.
    models: Blocks,
    /// Strokes in order, before they are listed by block.
    ordered: Vec<Stroke>,
    easel: Easel,
}

impl Pointillism {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        // anchored strokes may be twice as large
        let radius = match config.grid.sites() {
            Some(sites) => sites.iter().map(|site| site.radius).max(),
            None => Some(config.radius_max.saturating_mul(2)),
        };
        Self {
            stamps: Stamps::new(config.sprite.mask(&sprite::BUILT_IN), config.opacity, radius.into_iter()),
            config,
            level,
            motion: None,
            anchored: Anchored::default(),
            laid: None,
            sites: Vec::new(),
            strokes: Blocks::default(),
            map: Voronoi::default(),
            mapped: false,
            places: Vec::new(),
            models: Blocks::default(),
            ordered: Vec::new(),
            easel: Easel::default(),
        }
    }

    /// The grid for frames of `size`, a row a site in drawing order: x, y, radius, dr, dg, db.
    pub fn grid(&self, size: Size) -> Plane<f32> {
        let sites = self.config.sites(size);
        Plane::from_fn(Size::new(6, sites.len()), |c, i| sites[i].to_row()[c] as f32)
    }

    /// Carries the strokes along (see [`super::Styler::anchor`]); they then come from an endless lattice. The grid of a
    /// file stays where it is.
    pub fn anchor(&mut self, motion: Option<Similarity>) {
        self.motion = motion.filter(|_| self.config.grid.sites().is_none());
    }

    /// Takes the frame size; new sites when it or the motion is another than before.
    fn fit(&mut self, size: Size) {
        if self.laid == Some((size, self.motion)) {
            return;
        }
        self.laid = Some((size, self.motion));
        self.mapped = false;
        let most = match &self.motion {
            Some(motion) => self.anchored.place(&self.config.spread(), motion, size, &mut self.sites),
            None => {
                self.sites = self.config.sites(size);
                self.sites.len()
            }
        };
        self.ordered.clear();
        self.ordered.reserve(most);
        self.ordered.extend(self.sites.iter().map(|site| Stroke {
            x: site.x,
            y: site.y,
            radius: site.radius as u16,
            color: site.offset.map(|v| paint::steps(v) as i16),
        }));
        let most = if self.motion.is_some() { most } else { 0 };
        self.strokes.sort(size, &self.stamps, &self.ordered, most);
    }

    /// Turns the models' particles, of which there are at `most` so many, into strokes.
    fn snap(&mut self, size: Size, particles: &[Particle], most: usize) {
        if !self.mapped {
            self.mapped = true;
            self.places.clear();
            self.places.reserve(self.sites.capacity());
            let place = |site: &Site| [site.x, site.y].map(|v| LATTICE * v + LATTICE / 2);
            self.places.extend(self.sites.iter().map(place));
            self.map.run(self.level, size, &self.places);
        }
        self.ordered.clear();
        self.ordered.reserve(most);
        self.ordered.extend(particles.iter().filter_map(|particle| {
            let pixel = |v: f32, length: usize| ((v + 0.5) as usize).min(length - 1);
            let (x, y) = (pixel(particle.x, size.width), pixel(particle.y, size.height));
            let site = self.sites.get(self.map.row(y)[x] as usize)?;
            let color = |c: usize| (f64::from(particle.color[c]) + site.offset[c]).clamp(0.0, 1.0);
            let color = [0, 1, 2].map(|c| paint::steps(color(c)) as i16);
            Some(Stroke { x: site.x, y: site.y, radius: site.radius as u16, color })
        }));
        self.models.sort(size, &self.stamps, &self.ordered, most);
    }
}

impl Style for Pointillism {
    fn look(&self) -> Look {
        let scatter = Scatter { count: self.config.num_particles, seed: self.config.seed };
        Look { scatter, ..Needs::PARTICLES.into() }
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let picture = &input.frame.color;
        let size = picture.size();
        out.resize(size);
        if size.area() == 0 {
            return;
        }
        self.fit(size);
        if let Some(layer) = input.layer {
            self.snap(size, &layer.particles, layer.particles.capacity());
        }
        let painting = Painting {
            picture,
            stamps: &self.stamps,
            sampled: &self.strokes,
            colored: input.layer.map(|_| &self.models),
        };
        self.easel.paint(self.level, painting, out);
    }
}
