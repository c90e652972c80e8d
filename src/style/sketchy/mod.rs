//! The sketchy style (Haller, Landerl & Billinghurst 2005, "A Loose and Sketchy Approach in a Mediated Reality
//! Environment"): a blurred picture on paper under pencil strokes along its silhouettes.
//!
//! 1. Edges and a force field along them are read off the camera's red channel and, separately, off the models'
//!    depth (`field`).
//! 2. Strokes begin at random pixels (`starts`) and follow the field while they are on an edge (`trace`).
//! 3. What paper, border and strokes let through of the light is multiplied into one plane (`ink`); in place of
//!    strokes there may be lone brush prints (`sprites`).
//! 4. The augmented picture is blurred and multiplied by that plane, row by row.
//!
//! Starts are the same in every frame, so strokes do not flicker where the picture keeps still; `lively` draws new
//! ones each time, as the paper does. Each part can be switched off, and then costs nothing.

mod border;
mod brush;
mod config;
mod field;
mod ink;
mod paper;
mod reference;
mod sprites;
mod starts;
mod trace;

pub use config::{Config, Renderer};
pub use reference::{reference, reference_over};

use super::{Style, StyleInput, composite};
use crate::frame::Needs;
use crate::geometry::Similarity;
use crate::kernel::band_rows;
use crate::kernel::gaussian::{Gaussian, Halves};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rgb, Size};
use crate::render::Look;
use brush::Brush;
use fearless_simd::{Bytes, Simd, SimdBase, f32x8, u16x16};
use field::{Field, Gradients};
use ink::{Rows, SLACK, Sheet};
use rayon::prelude::*;
use sprites::Sprites;
use starts::Starts;
use trace::Strokes;

/// The style with its buffers.
pub struct Sketchy {
    config: Config,
    level: Level,
    gaussian: Gaussian,
    canvas: Rgb,
    /// The frame size that the buffers are for.
    size: Size,
    frames: u64,
    /// The frame number that `starts` is for.
    started: Option<u64>,
    /// How the scene has moved, where the starts move with it.
    motion: Option<Similarity>,
    gradients: Gradients,
    starts: Starts,
    strokes: Strokes,
    sprites: Sprites,
    halves: [Halves; 3],
    /// Light that paper and border let through, rows [`stride`] samples apart.
    ground: Vec<f32>,
    /// The same with strokes.
    shade: Vec<f32>,
    bands: Vec<Band>,
}

/// What one band of rows works in.
#[derive(Debug, Default)]
struct Band {
    line: Vec<f32>,
    blurred: Vec<f32>,
    sheet: Sheet,
}

/// The intermediate results of one frame, for inspection.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stages {
    /// The blurred picture, R, G, B in 0..1.
    pub blur: [Plane<f32>; 3],
    /// 1 on an edge, else 0.
    pub edge: Plane<f32>,
    /// The force field's x; 0 where nothing changes.
    pub fx: Plane<f32>,
    /// The force field's y.
    pub fy: Plane<f32>,
    /// Points of every stroke, in drawing order.
    pub stroke_len: Vec<f32>,
    /// The points of all strokes, a row a point: x, y in px.
    pub stroke_pts: Plane<f32>,
}

/// Distance of rows of the shade plane, in samples.
const fn stride(size: Size) -> usize {
    size.width + SLACK
}

impl Sketchy {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            gaussian: Gaussian::new(config.sigma),
            config,
            level,
            canvas: Rgb::default(),
            size: Size::new(0, 0),
            frames: 0,
            started: None,
            motion: None,
            gradients: Gradients::default(),
            starts: Starts::default(),
            strokes: Strokes::default(),
            sprites: Sprites::default(),
            halves: Default::default(),
            ground: Vec::new(),
            shade: Vec::new(),
            bands: Vec::new(),
        }
    }

    /// Carries the places where strokes begin along (see [`super::Styler::anchor`]); they then come from an endless
    /// lattice. Starts of a file and of `lively` strokes stay as they are.
    pub fn anchor(&mut self, motion: Option<Similarity>) {
        let free = self.config.lively || self.config.starts.starts().is_some();
        let motion = motion.filter(|_| !free);
        if self.motion.is_some() || motion.is_some() {
            self.started = None;
        }
        self.motion = motion;
    }

    /// Draws the next frame as a first one.
    pub fn restart(&mut self) {
        self.frames = 0;
    }

    /// The intermediate results of one frame, which counts as drawn; the picture goes to `out`. Slower than drawing,
    /// and it allocates.
    pub fn stages(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Stages {
        self.draw(input, out);
        let mut canvas = Rgb::default();
        let picture = composite::augmented(&input, &mut canvas);
        let size = picture.size();
        self.gradients.run(self.level, &input.frame.color.planes[0]);
        let field = Field::new(&self.config, &self.gradients, input.layer);
        let mut stages = Stages {
            edge: Plane::from_fn(size, |x, y| f32::from(u8::from(field.edge(x, y).is_some()))),
            fx: Plane::from_fn(size, |x, y| field.force(x, y)[0] as f32),
            fy: Plane::from_fn(size, |x, y| field.force(x, y)[1] as f32),
            ..Stages::default()
        };
        for (to, from) in stages.blur.iter_mut().zip(&picture.planes) {
            self.gaussian.run(self.level, from.view(), to);
        }
        let mut strokes: Vec<_> = self.strokes.iter().collect();
        strokes.sort_by_key(|stroke| stroke.number);
        stages.stroke_len = strokes.iter().map(|stroke| stroke.points.len() as f32).collect();
        let points: Vec<_> = strokes.iter().flat_map(|stroke| stroke.points).collect();
        stages.stroke_pts = Plane::from_fn(Size::new(2, points.len()), |c, i| points[i].at[c] as f32);
        stages
    }

    /// Takes the frame size: paper and border are laid out anew when it is another than before.
    fn fit(&mut self, size: Size, rows: usize) {
        if self.size != size {
            self.size = size;
            self.frames = 0;
            self.started = None;
            self.ground.clear();
            self.ground.resize(stride(size) * size.height, 1.0);
            self.shade.resize(self.ground.len(), 1.0);
            if let Some(texture) = self.config.paper.texture() {
                let tile = texture.size();
                for (y, row) in self.ground.chunks_exact_mut(stride(size)).enumerate() {
                    let texture = texture.row(y % tile.height);
                    for (x, to) in row[..size.width].iter_mut().enumerate() {
                        *to = f32::from(texture[x % tile.width]) / 255.0;
                    }
                }
            }
            if self.config.border {
                border::draw(size, self.config.seed, &mut self.ground, stride(size));
            }
        }
        let bands = size.height.div_ceil(rows.max(1));
        if self.bands.len() < bands {
            self.bands.resize_with(bands, Band::default);
        }
        for band in &mut self.bands[..bands] {
            band.line.resize(Gaussian::length(size.width), 0.0);
            band.blurred.resize(Gaussian::length(size.width), 255.0);
            band.sheet.fit(&self.config, Size::new(size.width, rows.min(size.height)));
        }
    }

    /// Finds this frame's strokes, or moves the sprites.
    fn trace(&mut self, input: &StyleInput<'_>) {
        let Self { config, starts, size, .. } = self;
        let frame = if config.lively { self.frames } else { 0 };
        if self.started != Some(frame) {
            self.started = Some(frame);
            match (config.starts.starts(), self.motion) {
                (Some(places), _) => starts.fill(size.height, places.iter().copied()),
                (None, Some(motion)) => {
                    starts.reserve((4.5 * config.density * size.area() as f64) as usize);
                    starts.fill(size.height, starts::anchored(*size, config.density, config.seed, motion));
                }
                (None, None) => {
                    let seed = starts::seed_of(config.seed, frame);
                    starts.fill(size.height, starts::random(*size, config.density, seed));
                }
            }
        }
        self.gradients.run(self.level, &input.frame.color.planes[0]);
        let field = Field::new(config, &self.gradients, input.layer);
        match config.renderer {
            Renderer::Sprites => self.sprites.advance(config, &field, starts, self.frames),
            Renderer::Lines | Renderer::Polygons => self.strokes.trace(config, &field, starts.ordered()),
        }
    }
}

impl Style for Sketchy {
    fn look(&self) -> Look {
        let needs = Needs::COLOR;
        if self.config.strokes { needs.and(Needs::DEPTH).into() } else { needs.into() }
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let mut canvas = std::mem::take(&mut self.canvas);
        let picture = composite::augmented(&input, &mut canvas);
        let size = picture.size();
        out.resize(size);
        if size.area() > 0 {
            let rows = band_rows(size.height, 16);
            self.fit(size, rows);
            if self.config.strokes {
                self.trace(&input);
            }
            if self.config.color && self.config.blur {
                let (gaussian, level) = (&self.gaussian, self.level);
                let planes = self.halves.par_iter_mut().zip(&picture.planes);
                planes.for_each(|(halves, plane)| gaussian.prepare(level, plane.view(), halves));
            }
            let work = Work {
                config: &self.config,
                picture,
                gaussian: &self.gaussian,
                ground: &self.ground,
                halves: &self.halves,
                strokes: &self.strokes,
                sprites: &self.sprites,
                brush: Brush::new(self.config.brush.mask(&brush::BUILT_IN)),
            };
            let level = self.level;
            let [r, g, b] = &mut out.planes;
            let planes = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
            let planes = planes.zip(b.view_mut().par_bands(rows));
            let shade = self.shade.par_chunks_mut(rows * stride(size)).zip(&mut self.bands);
            planes.zip(shade).for_each(|((((first, r), (_, g)), (_, b)), (shade, band))| {
                dispatch!(level, simd => draw_band(simd, work, first, shade, band, [r, g, b]));
            });
            self.frames += 1;
        }
        self.canvas = canvas;
    }
}

/// Borrowed inputs of a band.
#[derive(Clone, Copy)]
struct Work<'a> {
    config: &'a Config,
    picture: &'a Rgb,
    gaussian: &'a Gaussian,
    ground: &'a [f32],
    halves: &'a [Halves; 3],
    strokes: &'a Strokes,
    sprites: &'a Sprites,
    brush: Brush<'a>,
}

/// Draws the rows of one band.
#[inline(always)]
fn draw_band<S: Simd>(
    simd: S,
    work: Work<'_>,
    first: usize,
    shade: &mut [f32],
    band: &mut Band,
    mut out: [PlaneMut<'_, u8>; 3],
) {
    let Work { config, picture, gaussian, ground, halves, strokes, sprites, brush } = work;
    let (size, stride) = (out[0].size(), stride(picture.size()));
    shade.copy_from_slice(&ground[first * stride..][..shade.len()]);
    if config.strokes {
        let mut rows = Rows { shade, stride, size, first };
        // no stroke gets farther from its start, ink included
        let far = f64::from(config.points) * config.step + 2.0 * config.half_width + 1.0;
        let near = first as f64 - far..(first + size.height) as f64 + far;
        match config.renderer {
            Renderer::Lines => {
                for stroke in strokes.starting(near) {
                    band.sheet.draw::<_, false>(simd, config, stroke, brush, &mut rows);
                }
            }
            Renderer::Polygons => {
                for stroke in strokes.starting(near) {
                    band.sheet.draw::<_, true>(simd, config, stroke, brush, &mut rows);
                }
            }
            Renderer::Sprites => sprites::draw(config, sprites.alive(), brush, &mut rows),
        }
    }
    for y in 0..size.height {
        let shade = &shade[y * stride..][..stride];
        for ((from, to), halves) in picture.planes.iter().zip(&mut out).zip(halves) {
            match (config.color, config.blur) {
                (false, _) => {} // stays white
                (true, true) => {
                    let (line, blurred) = (&mut band.line, &mut band.blurred);
                    gaussian.row(simd, from.view(), halves, first + y, line, blurred);
                }
                (true, false) => {
                    for (to, &from) in band.blurred.iter_mut().zip(from.row(first + y)) {
                        *to = f32::from(from);
                    }
                }
            }
            multiply(simd, &band.blurred, shade, to.row_mut(y));
        }
    }
}

/// floor(color · shade + .5), color in 0..255.
#[inline(always)]
fn multiply<S: Simd>(simd: S, color: &[f32], shade: &[f32], out: &mut [u8]) {
    for (block, out) in out.chunks_mut(16).enumerate() {
        let (color, shade) = (&color[16 * block..][..16], &shade[16 * block..][..16]);
        let low = f32x8::from_slice(simd, &color[..8]) * f32x8::from_slice(simd, &shade[..8]);
        let high = f32x8::from_slice(simd, &color[8..]) * f32x8::from_slice(simd, &shade[8..]);
        let (low, high) = (simd.cvt_i32_f32x8(low + 0.5), simd.cvt_i32_f32x8(high + 0.5));
        let words: u16x16<S> = simd.saturating_narrow_i32x8(low, high).bitcast();
        let (low, high) = simd.split_u16x16(words);
        let bytes = simd.saturating_narrow_u16x8(low, high);
        out.copy_from_slice(&bytes.as_slice()[..out.len()]);
    }
}
