//! Black and white around a quad: the border's ring and the quiet zone's, and the planes through them.

use super::decode::View;
use crate::geometry::Homography;
use crate::marker::Polarity;
use glam::DVec2;

/// A gray level that varies linearly over the marker: `mean + slope · p`, p in ±1.
#[derive(Clone, Copy, Debug, Default)]
pub struct Level {
    /// At the center.
    pub mean: f64,
    /// Per half side to the right and up.
    pub slope: DVec2,
}

impl Level {
    /// The level at a point of the marker square.
    #[inline]
    pub fn at(&self, p: DVec2) -> f64 {
        self.mean + self.slope.dot(p)
    }

    /// The level in the frame whose top-left corner is `turns` corners further clockwise.
    pub fn turned(self, turns: usize) -> Self {
        let slope = match turns {
            0 => self.slope,
            // the new x axis runs down the old right side, the new y axis to the old right
            1 => DVec2::new(-self.slope.y, self.slope.x),
            2 => -self.slope,
            _ => DVec2::new(self.slope.y, -self.slope.x),
        };
        Self { mean: self.mean, slope }
    }

    /// The level in the picture itself, from the one in the picture seen by `polarity`.
    pub fn raw(self, polarity: Polarity) -> Self {
        match polarity {
            Polarity::BlackOnWhite => self,
            Polarity::WhiteOnBlack => Self { mean: 255.0 - self.mean, slope: -self.slope },
        }
    }
}

/// Least gray step from black to white.
const LEAST_CONTRAST: f64 = 8.0;
/// Most samples of a ring: 4 a cell's width of the side, 7x7 bits and their border.
const MOST_SAMPLES: usize = 4 * 9;

/// A dark square in a lighter one, by the gray levels (seen by the polarity) of its two rings.
#[derive(Clone, Copy, Debug)]
pub struct Ring {
    /// Of the border.
    pub black: Level,
    /// Of the quiet zone.
    pub white: Level,
    /// Share of the border's samples that are darker than the middle.
    pub dark: f64,
    /// Share of the quiet zone's samples that are lighter than the middle.
    pub light: f64,
}

impl Ring {
    /// Reads both rings, half a cell inside and outside the quad; `cells` (3..=9) cells of the code fit along
    /// a side. `None` when the inner one is not darker by far.
    pub fn read(view: &View<'_>, map: &Homography, cells: usize, polarity: Polarity) -> Option<Self> {
        let half = 1.0 / cells as f64;
        let (black, inside) = sample(view, map, cells, 1.0 - half, polarity);
        let (white, outside) = sample(view, map, cells, 1.0 + half, polarity);
        if white.mean - black.mean < LEAST_CONTRAST {
            return None;
        }
        let count = 4 * cells;
        let middle = |p: DVec2| 0.5 * (black.at(p) + white.at(p));
        let below = inside[..count].iter().filter(|(p, gray)| *gray < middle(*p)).count();
        let above = outside[..count].iter().filter(|(p, gray)| *gray > middle(*p)).count();
        let share = |n: usize| n as f64 / count as f64;
        Some(Self { black, white, dark: share(below), light: share(above) })
    }

    /// The step from black to white at the center.
    pub fn contrast(&self) -> f64 {
        self.white.mean - self.black.mean
    }

    /// Where a gray value lies: -1 = black, 1 = white, each as at that point of the marker.
    #[inline]
    pub fn place(&self, p: DVec2, gray: f64) -> f64 {
        let (black, white) = (self.black.at(p), self.white.at(p));
        (gray - 0.5 * (black + white)) / (0.5 * (white - black)).max(1.0)
    }
}

/// What a quick look at a quad shows: gray at eight places on either ring.
#[derive(Clone, Copy, Debug)]
pub struct Glance {
    /// Mean gray of the border.
    black: f64,
    /// Mean step from there to the quiet zone.
    step: f64,
}

impl Glance {
    /// `None` where the outer ring is not lighter; arguments as those of [`Ring::read`].
    pub fn at(view: &View<'_>, map: &Homography, cells: usize, polarity: Polarity) -> Option<Self> {
        let gray = |x: f64, y: f64| polarity.gray(view.gray(map.apply(DVec2::new(x, y))));
        let half = 1.0 / cells as f64;
        let (mut glance, mut lighter) = (Self { black: 0.0, step: 0.0 }, 0);
        for (x, y) in [
            (-0.3, 1.0),
            (0.6, 1.0),
            (1.0, -0.3),
            (1.0, 0.6),
            (0.3, -1.0),
            (-0.6, -1.0),
            (-1.0, 0.3),
            (-1.0, -0.6),
        ] {
            // the larger coordinate is the ring's
            let on = |v: f64, radius: f64| if v.abs() == 1.0 { v * radius } else { v };
            let (inner, outer) = (1.0 - half, 1.0 + half);
            let black = gray(on(x, inner), on(y, inner));
            let rise = gray(on(x, outer), on(y, outer)) - black;
            glance.black += black / 8.0;
            glance.step += rise / 8.0;
            lighter += u32::from(rise > 0.0);
        }
        (glance.step >= 0.5 * LEAST_CONTRAST && lighter >= 5).then_some(glance)
    }

    /// Whether a gray within the border is anything but the border's: a bit's, perhaps.
    pub fn is_lit(&self, gray: f64) -> bool {
        gray > self.black + LIT * self.step
    }
}

/// Share of the step from black to white that the lightest bit of a code shows at least, whatever blur and shadow.
const LIT: f64 = 0.25;

/// Gray at the middles of the cells along the four sides of the square ±radius, and the plane through them.
fn sample(
    view: &View<'_>,
    map: &Homography,
    cells: usize,
    radius: f64,
    polarity: Polarity,
) -> (Level, [(DVec2, f64); MOST_SAMPLES]) {
    let mut samples = [(DVec2::ZERO, 0.0); MOST_SAMPLES];
    let mut level = Level::default();
    let mut squares = 0.0;
    for (i, sample) in samples[..4 * cells].iter_mut().enumerate() {
        let along = (-1.0 + (2 * (i / 4) + 1) as f64 / cells as f64).clamp(-radius, radius);
        let p = match i % 4 {
            0 => DVec2::new(along, radius),
            1 => DVec2::new(radius, along),
            2 => DVec2::new(along, -radius),
            _ => DVec2::new(-radius, along),
        };
        *sample = (p, polarity.gray(view.gray(map.apply(p))));
        level.mean += sample.1;
        level.slope += p * sample.1;
        squares += p.x * p.x;
    }
    // the ring is symmetric: the normal equations are diagonal
    level.mean /= (4 * cells) as f64;
    level.slope /= squares;
    (level, samples)
}
