//! One light on models and room: the white paper around a marker shows the color and strength of the room's light,
//! and models are drawn in it.

use super::{Mark, RangeError, check, sample};
use crate::geometry::Lens;
use crate::pixels::Rgb;
use glam::{DVec3, Vec3};
use serde::Deserialize;

/// The `[retouch.light]` table.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the marker's paper looks in the light that models keep their own color in: sRGB, each over 0 up to 1.
    /// Default [0.9, 0.9, 0.9].
    pub white: [f64; 3],
    /// Share of a new measurement in the light, a frame: over 0 (slow) up to 1 (at once). Default 0.1.
    pub pace: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { white: [0.9; 3], pace: 0.1 }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        let share = |v: f64| v > 0.0 && v <= 1.0;
        for white in self.white {
            check("retouch.light.white", white, share(white), "over 0 up to 1")?;
        }
        check("retouch.light.pace", self.pace, share(self.pace), "over 0 up to 1")
    }
}

/// Places looked at along a side of the print.
const PLACES: usize = 16;
/// The light is not taken for stronger than this.
const MOST: f64 = 2.0;

/// The light of the room as the paper shows it.
pub struct RoomLight {
    config: Config,
    gain: Option<DVec3>,
}

impl RoomLight {
    /// With these settings (see [`Config::validate`]).
    pub fn new(config: Config) -> Self {
        Self { config, gain: None }
    }

    /// Looks at the paper half a cell outside the border of every print in view; none changes nothing.
    pub fn look(&mut self, picture: &Rgb, marks: &[Mark], lens: &Lens) {
        if lens.size != picture.size() || picture.size().area() == 0 {
            return;
        }
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for color in marks.iter().filter_map(|mark| paper(picture, mark, lens)) {
            sum += color;
            count += 1.0;
        }
        if count > 0.0 {
            let seen = sum / (255.0 * count) / DVec3::from(self.config.white);
            let seen = seen.min(DVec3::splat(MOST));
            let gain = self.gain.unwrap_or(seen);
            self.gain = Some(gain + (seen - gain) * self.config.pace);
        }
    }

    /// What models' colors are multiplied by; 1 until a print was seen.
    pub fn tint(&self) -> Vec3 {
        self.gain.map_or(Vec3::ONE, |gain| gain.as_vec3())
    }
}

/// The median color of the paper around a print, 0..255; `None` when part of it is out of view.
fn paper(picture: &Rgb, mark: &Mark, lens: &Lens) -> Option<DVec3> {
    let half = mark.half_mm(0.5);
    let mut seen = [[0.0; 4 * PLACES]; 3];
    for i in 0..4 * PLACES {
        let along = ((i % PLACES) as f64 + 0.5) / PLACES as f64 * 2.0 - 1.0;
        let (x, y) = [(along, 1.0), (1.0, along), (along, -1.0), (-1.0, along)][i / PLACES];
        let at = lens.project(mark.pose.apply(DVec3::new(x * half, y * half, 0.0)))?;
        let inside = at.x >= 0.0
            && at.y >= 0.0
            && at.x <= (lens.size.width - 1) as f64
            && at.y <= (lens.size.height - 1) as f64;
        if !inside {
            return None;
        }
        for (values, value) in seen.iter_mut().zip(sample(picture, at)) {
            values[i] = value;
        }
    }
    let median = |mut values: [f64; 4 * PLACES]| {
        values.sort_unstable_by(f64::total_cmp);
        (values[2 * PLACES - 1] + values[2 * PLACES]) / 2.0
    };
    Some(DVec3::from(seen.map(median)))
}
