//! The pointillism style in plain f64, read straight from the dissertation: one stroke after another over the whole
//! picture.

use super::Config;
use super::grid::Site;
use super::sprite::scaled;
use crate::frame::Particle;
use crate::pixels::{Plane, Rgb, Size};

/// A picture in f64, 0..1 a channel.
type Canvas = Plane<[f64; 3]>;

/// Draws `augmented` in brush strokes; 8-bit result.
pub fn reference(config: &Config, augmented: &Rgb) -> Rgb {
    reference_with_models(config, augmented, &[])
}

/// Draws `picture` in brush strokes, and over it the particles of models, far to near; 8-bit result.
pub fn reference_with_models(config: &Config, picture: &Rgb, particles: &[Particle]) -> Rgb {
    let sites = config.sites(picture.size());
    let mut canvas = camera(config, &sites, picture);
    let brush = Brush::new(config);
    for particle in particles {
        let (x, y) = ((particle.x + 0.5).floor() as i64, (particle.y + 0.5).floor() as i64);
        let distance = |site: &Site| {
            let (dx, dy) = (i64::from(site.x) - x, i64::from(site.y) - y);
            dx * dx + dy * dy
        };
        if let Some(site) = sites.iter().min_by_key(|site| distance(site)) {
            brush.stroke(&mut canvas, site, particle.color.map(f64::from));
        }
    }
    finished(&canvas)
}

/// The camera image filter (section 3.4.2).
fn camera(config: &Config, sites: &[Site], picture: &Rgb) -> Canvas {
    let size = picture.size();
    let mut canvas = Plane::from_fn(size, |x, y| picture.at(x, y).map(|v| f64::from(v) / 255.0));
    let brush = Brush::new(config);
    for site in sites {
        let x = site.x.clamp(0, size.width as i32 - 1) as usize;
        let y = site.y.clamp(0, size.height as i32 - 1) as usize;
        brush.stroke(&mut canvas, site, picture.at(x, y).map(|v| f64::from(v) / 255.0));
    }
    canvas
}

/// The brush at every size.
struct Brush {
    masks: Vec<Plane<f64>>,
    opacity: f64,
}

impl Brush {
    fn new(config: &Config) -> Self {
        let masks = (0..=super::grid::MAX_RADIUS)
            .map(|radius| scaled(config.sprite.mask(&super::sprite::BUILT_IN), radius));
        Self { masks: masks.collect(), opacity: config.opacity }
    }

    /// One stroke of `color` with the site's radius and color offset.
    fn stroke(&self, canvas: &mut Canvas, site: &Site, color: [f64; 3]) {
        let Size { width, height } = canvas.size();
        let mask = &self.masks[site.radius as usize];
        let color = [0, 1, 2].map(|c| (color[c] + site.offset[c]).clamp(0.0, 1.0));
        for j in 0..mask.size().height {
            for i in 0..mask.size().width {
                let x = i64::from(site.x) - i64::from(site.radius) + i as i64;
                let y = i64::from(site.y) - i64::from(site.radius) + j as i64;
                if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
                    continue;
                }
                let a = self.opacity * mask.at(i, j);
                let at = &mut canvas.row_mut(y as usize)[x as usize];
                *at = [0, 1, 2].map(|c| at[c] * (1.0 - a) + color[c] * a);
            }
        }
    }
}

fn finished(canvas: &Canvas) -> Rgb {
    let mut out = Rgb::new(canvas.size(), [0; 3]);
    for (y, row) in canvas.rows().enumerate() {
        for (x, color) in row.iter().enumerate() {
            out.set(x, y, color.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8));
        }
    }
    out
}
