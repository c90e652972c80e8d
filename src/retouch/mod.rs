//! Retouching: what is done to the camera picture before it is styled, and to which part of it the style belongs.
//!
//! Comes in: the camera's frame and the posed prints in it; goes out: the frame that the styles draw from, the color
//! of the room's light, a mask. Each retouch is a table of its own, off unless the settings have it, and free when
//! off. Nothing here looks for markers, draws models or knows a style.

pub mod hide;
pub mod light;
pub mod part;
mod patch;
pub mod shadow;
pub mod steady;

use crate::frame::Frame;
use crate::geometry::{Lens, Pose};
use crate::marker::Family;
use crate::pixels::simd::Level;
use crate::pixels::{Rgb, Size};
use crate::scene::Scene;
use glam::Vec3;
use serde::Deserialize;

/// The `[retouch]` table. A retouch is done where its table is given, if only empty.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Calms the sensor's noise where nothing moves.
    pub steady: Option<steady::Config>,
    /// Paints the printed markers over.
    pub hide: Option<hide::Config>,
    /// Gives the models the color of the room's light.
    pub light: Option<light::Config>,
    /// Lets the models throw a soft shadow on the marker's plane.
    pub shadow: Option<shadow::Config>,
}

/// A setting outside its range.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("{key} = {value} is out of range: {expected}")]
pub struct RangeError {
    /// The setting with its tables.
    pub key: &'static str,
    /// What was given.
    pub value: f64,
    /// The allowed range.
    pub expected: &'static str,
}

/// Refuses a value that is not `fine`.
fn check(key: &'static str, value: f64, fine: bool, expected: &'static str) -> Result<(), RangeError> {
    if fine { Ok(()) } else { Err(RangeError { key, value, expected }) }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        self.steady.map_or(Ok(()), |c| c.validate())?;
        self.hide.map_or(Ok(()), |c| c.validate())?;
        self.light.map_or(Ok(()), |c| c.validate())?;
        self.shadow.map_or(Ok(()), |c| c.validate())
    }
}

/// A printed marker in view, its pose solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Its family.
    pub family: Family,
    /// Its number.
    pub id: u32,
    /// Printed side of the black border's outer edge, mm.
    pub side_mm: f64,
    /// Marker → camera.
    pub pose: Pose,
}

impl Mark {
    /// Half the side of the print with `margin` cells of paper around it, mm.
    fn half_mm(&self, margin: f64) -> f64 {
        let cells = self.family.cells() as f64;
        self.side_mm / 2.0 * (cells + 2.0 * margin) / cells
    }
}

/// The retouches that the settings ask for, and the picture they are made on.
pub struct Retouch {
    steady: Option<steady::Steady>,
    hide: Option<hide::Hide>,
    light: Option<light::RoomLight>,
    shadow: Option<shadow::Shadow>,
    frame: Frame,
}

impl Retouch {
    /// The retouches of these settings (see [`Config::validate`]) for the models of `scene`.
    pub fn new(config: &Config, scene: &Scene, level: Level) -> Self {
        Self {
            steady: config.steady.map(|config| steady::Steady::new(config, level)),
            hide: config.hide.map(hide::Hide::new),
            light: config.light.map(light::RoomLight::new),
            shadow: config.shadow.map(|config| shadow::Shadow::new(config, scene)),
            frame: Frame::default(),
        }
    }

    /// The frame that the styles draw from, `frame` itself where nothing is retouched, and the color of the room's
    /// light: 1 = the light that models are made for, also where it is not measured. Allocates only when the picture
    /// size changes.
    pub fn frame<'a>(
        &'a mut self,
        frame: &'a Frame,
        scene: &Scene,
        marks: &[Mark],
        lens: &Lens,
    ) -> (&'a Frame, Vec3) {
        let steadies = self.steady.is_some();
        let paints = (self.hide.is_some() || self.shadow.is_some()) && !marks.is_empty();
        let picture = match &mut self.steady {
            Some(steady) => steady.run(&frame.color),
            None => &frame.color,
        };
        if let Some(light) = &mut self.light {
            light.look(picture, marks, lens);
        }
        let tint = self.light.as_ref().map_or(Vec3::ONE, light::RoomLight::tint);
        if !paints && !steadies {
            return (frame, tint);
        }
        let Self { hide, shadow, frame: own, .. } = self;
        own.resize(frame.size());
        (own.sequence, own.captured_at) = (frame.sequence, frame.captured_at);
        own.luma.samples_mut().copy_from_slice(frame.luma.samples());
        own.color.copy_from(picture);
        if let Some(hide) = hide {
            marks.iter().for_each(|mark| hide.paint(mark, lens, &mut own.color));
        }
        if let Some(shadow) = shadow {
            marks.iter().for_each(|mark| shadow.paint(mark, scene, lens, &mut own.color));
        }
        (own, tint)
    }
}

/// The color of the picture at a place in px, bilinear, clamped to the picture.
fn sample(picture: &Rgb, at: glam::DVec2) -> [f64; 3] {
    let Size { width, height } = picture.size();
    let place = |v: f64, n: usize| {
        let v = v.clamp(0.0, n as f64 - 1.0);
        let first = (v as usize).min(n - 1);
        (first, (first + 1).min(n - 1), v - first as f64)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (place(at.x, width), place(at.y, height));
    picture.planes.each_ref().map(|plane| {
        let across = |y: usize| {
            let (a, b) = (f64::from(plane.at(x0, y)), f64::from(plane.at(x1, y)));
            a + (b - a) * fx
        };
        let (above, below) = (across(y0), across(y1));
        above + (below - above) * fy
    })
}
