//! One frame from camera picture to canvas, the plan that says what it needs, and the hand-over of frames.
//!
//! Comes in: a `Frame`; goes out: the canvas, the sightings and the times. The whole loop runs inside one
//! rayon pool; after the first frames of a size nothing is allocated.

mod latest;
mod plan;
mod timings;

pub use latest::{Reader, Writer, latest};
pub use plan::{Plan, Step, View};
pub use timings::{Record, Stage, Timings};

use crate::frame::{Frame, Sighting};
use crate::geometry::Lens;
use crate::pixels::Rgb;
use crate::pixels::simd::Level;
use crate::render::{Camera, Look, Placed, Renderer};
use crate::scene::Scene;
use crate::style::{self, StyleInput, Styler};
use crate::track::{self, Tracker, Wanted};
use glam::DAffine3;

/// Models nearer than this to the lens are cut open, mm.
const NEAR_MM: f64 = 10.0;
/// Models farther than this are not drawn, mm.
const FAR_MM: f64 = 100_000.0;

/// Everything that turns frames into canvases for one scene, lens and style.
pub struct Pipeline {
    scene: Scene,
    camera: Camera,
    wanted: Vec<Wanted>,
    tracker: Tracker,
    renderer: Renderer,
    styler: Styler,
    placed: Vec<Placed>,
    canvas: Rgb,
}

/// What came of one frame.
pub struct Drawn<'a> {
    /// The finished picture.
    pub canvas: &'a Rgb,
    /// Markers found.
    pub sightings: &'a [Sighting],
    /// How many models were drawn.
    pub models: usize,
    /// What ran.
    pub plan: Plan,
    /// What it cost; camera and show are the caller's.
    pub timings: Timings,
}

impl Pipeline {
    /// A pipeline for `scene` seen through `lens`, drawn in the style that `style` names.
    pub fn new(scene: Scene, lens: Lens, track: track::Config, style: &style::Config, level: Level) -> Self {
        let mut wanted: Vec<Wanted> = Vec::new();
        for model in &scene.models {
            let anchor = model.anchor;
            let known = |w: &Wanted| (w.family, w.id) == (anchor.family, anchor.id);
            if !wanted.iter().any(known) {
                wanted.push(Wanted { family: anchor.family, id: anchor.id, side_mm: anchor.side_mm });
            }
        }
        Self {
            placed: Vec::with_capacity(4 * scene.models.len()),
            scene,
            camera: Camera { lens, near: NEAR_MM, far: FAR_MM },
            wanted,
            tracker: Tracker::new(track, level),
            renderer: Renderer::new(level),
            styler: Styler::new(style, level),
            canvas: Rgb::default(),
        }
    }

    /// The lens frames are seen through.
    pub fn lens(&self) -> &Lens {
        &self.camera.lens
    }

    /// Frames of another size than before come through this lens from now on.
    pub fn set_lens(&mut self, lens: Lens) {
        self.camera.lens = lens;
    }

    /// The plan for a frame with this view.
    pub fn plan(&self, view: View) -> Plan {
        Plan::new(&self.scene, self.styler.look().needs, self.styler.filters(), view)
    }

    /// Draws one frame: the whole way through, top to bottom.
    pub fn draw_frame(&mut self, frame: &Frame) -> Drawn<'_> {
        let mut timings = Timings::default();
        let plan = self.plan(View::Unknown);
        let sightings = if plan.track.runs {
            let (tracker, luma) = (&mut self.tracker, frame.luma.view());
            timings.measure(Stage::Track, || tracker.find(luma, &self.camera.lens, &self.wanted))
        } else {
            &[]
        };
        place(&self.scene, sightings, &mut self.placed);
        let view = View::Models(self.placed.len());
        let plan = Plan::new(&self.scene, self.styler.look().needs, self.styler.filters(), view);
        let layer = plan.render.runs.then(|| {
            timings.measure(Stage::Render, || {
                let look = Look { needs: plan.needs, ..self.styler.look() };
                self.renderer.draw(&self.scene, &self.placed, &self.camera, look)
            })
        });
        self.canvas.resize(frame.size());
        timings.measure(Stage::Style, || self.styler.draw(StyleInput { frame, layer }, &mut self.canvas));
        Drawn { canvas: &self.canvas, sightings, models: self.placed.len(), plan, timings }
    }
}

/// Puts every model on its marker, where that has a pose.
fn place(scene: &Scene, sightings: &[Sighting], placed: &mut Vec<Placed>) {
    placed.clear();
    for sighting in sightings {
        let Some(solved) = sighting.pose else { continue };
        let to_camera = DAffine3 { matrix3: solved.pose.rotation, translation: solved.pose.translation };
        for (index, model) in scene.models.iter().enumerate() {
            let anchor = model.anchor;
            if anchor.family == sighting.family && anchor.id.is_none_or(|id| id == sighting.id) {
                placed.push(Placed { model: index, to_camera: to_camera * model.to_marker });
            }
        }
    }
}
