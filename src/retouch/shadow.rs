//! A soft contact shadow: models darken the plane of the print they stand on.
//!
//! Of every model the outermost vertices in 64 directions are kept. A frame throws them along the light onto the
//! plane, takes the convex hull, and darkens the picture by the distance from the hull's edge, softly. The distances
//! are laid out on a small map of the plane that the pixels look up, bilinear.

use super::patch::Patch;
use super::{Mark, RangeError, check};
use crate::geometry::Lens;
use crate::kernel::band_rows;
use crate::pixels::Rgb;
use crate::scene::{Model, Scene};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::Deserialize;

/// The `[retouch.shadow]` table.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How much of the light the shadow takes at its darkest, 0 to 1. Default 0.45.
    pub strength: f64,
    /// Width of its edge, share of the shadow's larger side, 0.02 to 1. Default 0.3.
    pub softness: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { strength: 0.45, softness: 0.3 }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        let Self { strength, softness } = *self;
        check("retouch.shadow.strength", strength, (0.0..=1.0).contains(&strength), "0 to 1")?;
        check("retouch.shadow.softness", softness, (0.02..=1.0).contains(&softness), "0.02 to 1")
    }
}

/// Directions in which a model's outermost vertices are kept.
const DIRECTIONS: usize = 64;
/// Places of the map along a side.
const MAP: usize = 48;
/// Shadows are thrown no farther than this, mm a mm of height.
const SLOPE: f64 = 0.7;

/// The shadows of a scene's models.
pub struct Shadow {
    config: Config,
    /// Outermost vertices of each model, marker space in mm.
    outer: Vec<Vec<DVec3>>,
    points: Vec<DVec2>,
    hull: Vec<DVec2>,
    map: Vec<f32>,
}

impl Shadow {
    /// With these settings (see [`Config::validate`]) for the models of `scene`.
    pub fn new(config: Config, scene: &Scene) -> Self {
        Self {
            config,
            outer: scene.models.iter().map(outermost).collect(),
            points: Vec::with_capacity(DIRECTIONS),
            hull: Vec::with_capacity(2 * DIRECTIONS),
            map: vec![0.0; MAP * MAP],
        }
    }

    /// Darkens the plane of one print under the models that stand on it. Allocates nothing.
    pub fn paint(&mut self, mark: &Mark, scene: &Scene, lens: &Lens, picture: &mut Rgb) {
        if lens.size != picture.size() {
            return;
        }
        for (index, model) in scene.models.iter().enumerate() {
            if model.anchor.takes(mark.family, mark.id) {
                let light = mark.pose.rotation.transpose() * scene.light.direction.as_dvec3();
                if let Some((center, half)) = self.throw(index, light)
                    && let Some(patch) = Patch::new(&mark.pose, lens, center, half)
                {
                    darken(&patch, &self.map, picture);
                }
            }
        }
    }

    /// Makes the map of one model's shadow in this light (marker space); its middle and half its side, mm.
    fn throw(&mut self, model: usize, light: DVec3) -> Option<(DVec2, f64)> {
        let across = if light.z > 1e-6 { light.truncate() / light.z } else { DVec2::ZERO };
        let across = across.clamp_length_max(SLOPE);
        self.points.clear();
        self.points.extend(self.outer.get(model)?.iter().map(|p| p.truncate() - across * p.z.max(0.0)));
        hull(&mut self.points, &mut self.hull);
        if self.hull.len() < 3 {
            return None;
        }
        let low = self.hull.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = self.hull.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        let side = (high - low).max_element();
        let soft = self.config.softness * side;
        let (center, half) = ((low + high) / 2.0, (side + soft) / 2.0 * 1.02);
        for (i, value) in self.map.iter_mut().enumerate() {
            let at = DVec2::new((i % MAP) as f64, (i / MAP) as f64) / (MAP - 1) as f64 * 2.0 - 1.0;
            let at = center + DVec2::new(at.x, -at.y) * half;
            // half way at the hull's edge, none beyond half the softness
            let t = (0.5 - beyond(&self.hull, at) / soft).clamp(0.0, 1.0);
            *value = (self.config.strength * (t * t * (3.0 - 2.0 * t))) as f32;
        }
        Some((center, half))
    }
}

/// The vertices of a model that lie outermost in directions spread over the sphere, marker space.
fn outermost(model: &Model) -> Vec<DVec3> {
    let mut found: Vec<DVec3> = Vec::with_capacity(DIRECTIONS);
    for i in 0..DIRECTIONS {
        // a spiral of the golden angle
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = libm::sincos(i as f64 * 2.399_963_229_728_653);
        let direction = (DVec2::new(cos, sin) * (1.0 - z * z).sqrt()).extend(z);
        let points = model.mesh.positions.iter().map(|p| model.to_marker.transform_point3(p.as_dvec3()));
        let farthest =
            points.filter(|p| p.is_finite()).max_by(|a, b| direction.dot(*a).total_cmp(&direction.dot(*b)));
        found.extend(farthest.filter(|p| !found.contains(p)));
    }
    found
}

/// The convex hull of `points`, counter-clockwise (Andrew 1979); sorts the points.
fn hull(points: &mut [DVec2], hull: &mut Vec<DVec2>) {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    hull.clear();
    let mut add = |point: DVec2, least: usize| {
        while hull.len() >= least + 2 {
            let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
            if (b - a).perp_dot(point - a) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
        hull.len()
    };
    let mut lower = 0;
    for &point in points.iter() {
        lower = add(point, 0);
    }
    for &point in points.iter().rev().skip(1) {
        add(point, lower.saturating_sub(1));
    }
    hull.pop();
}

/// How far a place is outside the farthest of the hull's edges; below 0 inside.
fn beyond(hull: &[DVec2], at: DVec2) -> f64 {
    let mut most = f64::NEG_INFINITY;
    for (i, &from) in hull.iter().enumerate() {
        let along = hull[(i + 1) % hull.len()] - from;
        let length = along.length();
        if length > 0.0 {
            most = most.max((at - from).perp_dot(along) / length);
        }
    }
    most
}

/// Takes the map's share from every pixel of the patch.
fn darken(patch: &Patch, map: &[f32], picture: &mut Rgb) {
    let rect = patch.rect;
    let rows = band_rows(picture.size().height, 8);
    let [r, g, b] = &mut picture.planes;
    let bands = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
    bands.zip(b.view_mut().par_bands(rows)).for_each(|(((first, r), (_, g)), (_, b))| {
        let mut bands = [r, g, b];
        let last = (first + bands[0].size().height).min(rect.y1);
        for y in first.max(rect.y0)..last {
            for x in rect.x0..rect.x1 {
                let at = patch.under(x, y);
                // written so that what is not finite is left alone
                if at.abs().max_element() < 1.0 {
                    let keep = 1.0 - lookup(map, at);
                    for band in &mut bands {
                        let value = &mut band.row_mut(y - first)[x];
                        *value = (f32::from(*value) * keep + 0.5) as u8;
                    }
                }
            }
        }
    });
}

#[inline(always)]
fn lookup(map: &[f32], at: DVec2) -> f32 {
    let cell = |v: f64| {
        let v = v * ((MAP - 1) as f64 / 2.0);
        let first = (v as usize).min(MAP - 2);
        (first, (v - first as f64) as f32)
    };
    let ((column, fx), (row, fy)) = (cell(at.x + 1.0), cell(1.0 - at.y));
    let above = &map[row * MAP + column..][..2];
    let below = &map[(row + 1) * MAP + column..][..2];
    let (above, below) = (above[0] + (above[1] - above[0]) * fx, below[0] + (below[1] - below[0]) * fx);
    above + (below - above) * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hull_holds_its_points_and_knows_how_far_outside_one_is() {
        let mut points: Vec<DVec2> = (0..25).map(|i| DVec2::new((i % 5) as f64, (i / 5) as f64)).collect();
        let mut found = Vec::new();
        hull(&mut points, &mut found);
        assert_eq!(found, [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(DVec2::from));
        assert_eq!(beyond(&found, DVec2::new(2.0, 1.0)), -1.0);
        assert_eq!(beyond(&found, DVec2::new(6.5, 1.0)), 2.5);
        hull(&mut [DVec2::ONE, DVec2::ONE], &mut found);
        assert!(found.len() < 3, "no area");
    }
}
