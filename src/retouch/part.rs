//! Which part of the picture is styled: a mask from the drawn models, the printed markers or an ellipse.

use super::patch::Patch;
use super::{Mark, RangeError, check};
use crate::frame::Layer;
use crate::geometry::Lens;
use crate::kernel::band_rows;
use crate::pixels::{Plane, Rect, Size};
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The `[style.part]` table: only part of the picture is styled, the rest shows conventional augmented reality.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What the part is: "object" (where models are drawn), "marker" (around the printed markers of the scene) or
    /// "vignette" (an ellipse in the middle).
    pub of: Of,
    /// Styles what is outside the part instead of what is inside. Default false.
    #[serde(default)]
    pub outside: bool,
    /// Width of the passage from one to the other, px, 0 to 64. Default 8.
    #[serde(default = "eight")]
    pub softness: f64,
    /// Marker: side of the part, times the black border's, 0.1 to 20. Vignette: axes of the ellipse, times the
    /// picture's sides, 0.05 to 2. Default: marker 1.5, vignette 0.8.
    #[serde(default)]
    pub scale: Option<f64>,
}

/// What a part is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Of {
    /// Where models are drawn.
    Object,
    /// Around the printed markers of the scene.
    Marker,
    /// An ellipse in the middle of the picture.
    Vignette,
}

fn eight() -> f64 {
    8.0
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        check("style.part.softness", self.softness, (0.0..=64.0).contains(&self.softness), "0 to 64 px")?;
        let scale = self.scale();
        let (fine, expected) = match self.of {
            Of::Vignette => ((0.05..=2.0).contains(&scale), "0.05 to 2 for a vignette"),
            Of::Marker | Of::Object => ((0.1..=20.0).contains(&scale), "0.1 to 20"),
        };
        check("style.part.scale", scale, fine, expected)
    }

    fn scale(&self) -> f64 {
        self.scale.unwrap_or(if self.of == Of::Vignette { 0.8 } else { 1.5 })
    }
}

/// Where the style shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Styled<'a> {
    /// Nowhere: it need not be drawn.
    Nothing,
    /// Everywhere.
    Everything,
    /// By this mask: 0 not at all, 255 alone.
    Mask(&'a Plane<u8>),
}

/// Makes the mask.
pub struct Part {
    config: Config,
    mask: Plane<u8>,
    hard: Plane<u8>,
    /// The size that a vignette was laid out for.
    laid: Option<Size>,
    sums: Vec<Vec<u32>>,
}

impl Part {
    /// With these settings (see [`Config::validate`]).
    pub fn new(config: Config) -> Self {
        Self { config, mask: Plane::default(), hard: Plane::default(), laid: None, sums: Vec::new() }
    }

    /// What this is the part of.
    pub fn of(&self) -> Of {
        self.config.of
    }

    /// Where a frame of `size` with these models and prints is styled. Allocates only when the size changes.
    pub fn of_frame(&mut self, size: Size, layer: Option<&Layer>, marks: &[Mark], lens: &Lens) -> Styled<'_> {
        let anything = match self.config.of {
            Of::Object => layer.is_some_and(|layer| !layer.touched.is_empty() && layer.depth.size() == size),
            Of::Marker => !marks.is_empty() && lens.size == size,
            Of::Vignette => true,
        };
        if !anything || size.area() == 0 {
            return if self.config.outside { Styled::Everything } else { Styled::Nothing };
        }
        self.mask.resize(size, 0);
        match (self.config.of, layer) {
            (Of::Object, Some(layer)) => self.objects(layer),
            (Of::Vignette, _) if self.laid != Some(size) => self.vignette(size),
            (Of::Marker, _) => self.markers(marks, lens),
            _ => {}
        }
        Styled::Mask(&self.mask)
    }

    /// A byte of the mask from how far inside the part a pixel is, px.
    fn byte(&self, inside: f64) -> u8 {
        let share = (inside / self.config.softness.max(1.0) + 0.5).clamp(0.0, 1.0);
        let byte = (share * 255.0 + 0.5) as u8;
        if self.config.outside { 255 - byte } else { byte }
    }

    fn vignette(&mut self, size: Size) {
        self.laid = Some(size);
        let center = DVec2::new(size.width as f64 - 1.0, size.height as f64 - 1.0) / 2.0;
        let axes = DVec2::new(size.width as f64, size.height as f64) / 2.0 * self.config.scale();
        let mut mask = std::mem::take(&mut self.mask);
        for y in 0..size.height {
            for (x, value) in mask.row_mut(y).iter_mut().enumerate() {
                let from = (DVec2::new(x as f64, y as f64) - center) / axes;
                // along the line to the middle, as if the ellipse were a circle of its short axis
                *value = self.byte((1.0 - from.length()) * axes.min_element());
            }
        }
        self.mask = mask;
    }

    fn markers(&mut self, marks: &[Mark], lens: &Lens) {
        let (size, reach) = (lens.size, self.config.softness.max(1.0));
        let mut mask = std::mem::take(&mut self.mask);
        mask.fill(self.byte(f64::NEG_INFINITY));
        for mark in marks {
            let half = mark.side_mm / 2.0 * self.config.scale();
            let Some(patch) = Patch::new(&mark.pose, lens, DVec2::ZERO, half) else { continue };
            let Rect { x0, y0, x1, y1 } = patch.rect;
            let pad = reach as usize + 1;
            let (x0, x1) = (x0.saturating_sub(pad), (x1 + pad).min(size.width));
            let (y0, y1) = (y0.saturating_sub(pad), (y1 + pad).min(size.height));
            let edges = inward(patch.corners);
            let part = &*self;
            let rows = band_rows(size.height, 8);
            mask.view_mut().par_bands(rows).for_each(|(first, mut band)| {
                for y in first.max(y0)..(first + band.size().height).min(y1) {
                    for (x, value) in band.row_mut(y - first)[x0..x1].iter_mut().enumerate() {
                        let at = DVec2::new((x0 + x) as f64, y as f64);
                        let inside =
                            edges.iter().map(|&(on, normal)| (at - on).dot(normal)).fold(f64::MAX, f64::min);
                        let byte = part.byte(inside);
                        *value = if part.config.outside { byte.min(*value) } else { byte.max(*value) };
                    }
                }
            });
        }
        self.mask = mask;
    }

    fn objects(&mut self, layer: &Layer) {
        let size = layer.depth.size();
        let (inside, outside) = if self.config.outside { (0, 255) } else { (255, 0) };
        let radius = (self.config.softness / 2.0) as usize;
        let rows = band_rows(size.height, 16);
        self.hard.resize(size, 0);
        let to = if radius == 0 { &mut self.mask } else { &mut self.hard };
        to.view_mut().par_bands(rows).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                let to = band.row_mut(y);
                for (to, &z) in to.iter_mut().zip(layer.depth.row(first + y)) {
                    *to = if z < f32::INFINITY { inside } else { outside };
                }
                // outlines reach over the models, and secondary models may
                if layer.silhouette.size() == size {
                    for (to, &line) in to.iter_mut().zip(layer.silhouette.row(first + y)) {
                        *to = if line > 0 { inside } else { *to };
                    }
                }
                if let Some(secondary) = layer.secondary.as_deref().filter(|s| s.depth.size() == size) {
                    for (to, &z) in to.iter_mut().zip(secondary.depth.row(first + y)) {
                        *to = if z < f32::INFINITY { inside } else { *to };
                    }
                }
            }
        });
        if radius > 0 {
            self.soften(radius, rows);
        }
    }

    /// The mean of `2 · radius + 1` squared pixels of the hard mask, clamped to its edges.
    fn soften(&mut self, radius: usize, rows: usize) {
        let size = self.hard.size();
        let bands = size.height.div_ceil(rows);
        if self.sums.len() < bands {
            self.sums.resize_with(bands, Vec::new);
        }
        self.sums.iter_mut().for_each(|sums| sums.resize(size.width, 0));
        let hard = &self.hard;
        let count = ((2 * radius + 1) * (2 * radius + 1)) as u32;
        let clamp = |i: isize, n: usize| i.clamp(0, n as isize - 1) as usize;
        self.mask.view_mut().par_bands(rows).zip(&mut self.sums).for_each(|((first, mut band), sums)| {
            let r = radius as isize;
            sums.fill(0);
            for dy in -r..=r {
                let row = hard.row(clamp(first as isize + dy, size.height));
                sums.iter_mut().zip(row).for_each(|(sum, &v)| *sum += u32::from(v));
            }
            for y in 0..band.size().height {
                let at = (first + y) as isize;
                if y > 0 {
                    let gone = hard.row(clamp(at - r - 1, size.height));
                    let come = hard.row(clamp(at + r, size.height));
                    for ((sum, &gone), &come) in sums.iter_mut().zip(gone).zip(come) {
                        *sum = *sum + u32::from(come) - u32::from(gone);
                    }
                }
                let mut sum: u32 = (-r..=r).map(|dx| sums[clamp(dx, size.width)]).sum();
                for (x, to) in band.row_mut(y).iter_mut().enumerate() {
                    let x = x as isize;
                    if x > 0 {
                        sum = sum + sums[clamp(x + r, size.width)] - sums[clamp(x - r - 1, size.width)];
                    }
                    *to = ((sum + count / 2) / count) as u8;
                }
            }
        });
    }
}

/// The edges of a quad: a point on each and its unit normal towards the inside.
fn inward(corners: [DVec2; 4]) -> [(DVec2, DVec2); 4] {
    let middle = corners.iter().copied().sum::<DVec2>() / 4.0;
    std::array::from_fn(|i| {
        let (from, to) = (corners[i], corners[(i + 1) % 4]);
        let normal = (to - from).perp().normalize_or_zero();
        (from, if normal.dot(middle - from) < 0.0 { -normal } else { normal })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;
    use crate::pixels::{TileGrid, TileSet};

    fn part(text: &str) -> Part {
        let config: Config = toml::from_str(text).expect("a table");
        config.validate().expect("in range");
        Part::new(config)
    }

    #[test]
    fn a_vignette_is_an_ellipse_with_a_soft_edge() {
        let size = Size::new(81, 41);
        let lens = Lens::guess(size);
        for outside in [false, true] {
            let mut part = part(&format!("of = 'vignette'\nscale = 0.5\nsoftness = 4\noutside = {outside}"));
            let Styled::Mask(mask) = part.of_frame(size, None, &[], &lens) else { panic!("some of both") };
            let at = |x, y| if outside { 255 - mask.at(x, y) } else { mask.at(x, y) };
            assert_eq!([at(40, 20), at(0, 0), at(40, 0), at(0, 20)], [255, 0, 0, 0]);
            let rim = at(40, 10); // the short axis ends a quarter pixel further
            assert!((128..160).contains(&rim), "{rim}");
        }
    }

    #[test]
    fn objects_are_softened_exactly_and_nothing_is_nothing() {
        let size = Size::new(77, 53);
        let grid = TileGrid::new(size);
        let mut touched = TileSet::new(grid);
        touched.insert(0);
        let covered = |x: usize, y: usize| (20..50).contains(&x) && y > 30;
        // a surface on the left, an outline on the right
        let depth = Plane::from_fn(size, |x, y| if covered(x, y) && x < 40 { 9.0 } else { f32::INFINITY });
        let silhouette = Plane::from_fn(size, |x, y| if covered(x, y) && x > 37 { 255 } else { 0 });
        let layer = Layer { depth, silhouette, touched, grid: Some(grid), ..Layer::default() };
        let lens = Lens::guess(size);
        for softness in [0, 1, 2, 9, 64] {
            let mask = sweep::everywhere("objects", |_| {
                let mut part = part(&format!("of = 'object'\nsoftness = {softness}"));
                let Styled::Mask(mask) = part.of_frame(size, Some(&layer), &[], &lens) else { panic!() };
                mask.clone()
            });
            let r = softness as isize / 2;
            for (x, y) in (0..53usize).step_by(5).flat_map(|y| (0..77usize).map(move |x| (x, y))) {
                let mut sum = 0.0;
                for (dx, dy) in (-r..=r).flat_map(|dy| (-r..=r).map(move |dx| (dx, dy))) {
                    let x = x.saturating_add_signed(dx).min(76);
                    let y = y.saturating_add_signed(dy).min(52);
                    sum += if covered(x, y) { 255.0 } else { 0.0 };
                }
                let mean = sum / ((2 * r + 1) * (2 * r + 1)) as f64;
                assert_eq!(f64::from(mask.at(x, y)), (mean + 0.5).floor(), "({x}, {y}), softness {softness}");
            }
        }
        assert_eq!(part("of = 'object'").of_frame(size, None, &[], &lens), Styled::Nothing);
        assert_eq!(
            part("of = 'marker'\noutside = true").of_frame(size, None, &[], &lens),
            Styled::Everything
        );
    }

    #[test]
    fn settings_beyond_their_ranges_are_refused() {
        for text in ["of = 'object'\nsoftness = 65", "of = 'vignette'\nscale = 3", "of = 'marker'\nscale = 0"]
        {
            let config: Config = toml::from_str(text).expect("a table");
            let error = config.validate().expect_err(text).to_string();
            assert!(error.starts_with("style.part.s"), "{error}");
        }
        assert!(toml::from_str::<Config>("of = 'sky'").is_err());
    }
}
