//! The gated mean in plain f64, pixel by pixel.

use super::{Config, REACH};
use crate::pixels::{Plane, Rgb};

/// The means of the frames so far, as the module's head says.
pub struct Reference {
    config: Config,
    mean: [Plane<f64>; 3],
    weight: Plane<f64>,
}

impl Reference {
    /// With these settings.
    pub fn new(config: Config) -> Self {
        Self { config, mean: Default::default(), weight: Plane::default() }
    }

    /// Takes the next picture in, whose noise is `sigma` levels, and returns the means in levels.
    pub fn run(&mut self, picture: &Rgb, sigma: f64) -> &[Plane<f64>; 3] {
        let size = picture.size();
        let level = |c: usize, x: usize, y: usize| f64::from(picture.planes[c].at(x, y));
        if self.weight.size() != size {
            self.mean = [0, 1, 2].map(|c| Plane::from_fn(size, |x, y| level(c, x, y)));
            self.weight = Plane::new(size, 0.5);
            return &self.mean;
        }
        let difference = Plane::from_fn(size, |x, y| {
            let of = |c: usize| (level(c, x, y) - self.mean[c].at(x, y)).abs();
            of(0).max(of(1)).max(of(2))
        });
        // differences are compared in whole levels
        let gate = (self.config.gate * sigma).round() + 0.5;
        for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
            let mut most = 0.0f64;
            for v in y.saturating_sub(REACH)..(y + REACH + 1).min(size.height) {
                for u in x.saturating_sub(REACH)..(x + REACH + 1).min(size.width) {
                    most = most.max(difference.at(u, v));
                }
            }
            let weight = &mut self.weight.row_mut(y)[x];
            for (c, mean) in self.mean.iter_mut().enumerate() {
                let mean = &mut mean.row_mut(y)[x];
                *mean = if most > gate { level(c, x, y) } else { *mean + *weight * (level(c, x, y) - *mean) };
            }
            let next = (*weight - *weight * *weight).max(1.0 / f64::from(self.config.frames));
            *weight = if most > gate { 0.5 } else { next };
        }
        &self.mean
    }
}
