//! One frame from camera picture to canvas, the plan that says what it needs, and the hand-over of frames.
//!
//! Comes in: a `Frame`; goes out: the canvas, the sightings and the times. The whole loop runs inside one
//! rayon pool; after the first frames of a size nothing is allocated.

mod anchor;
pub mod governor;
mod latest;
mod plan;
mod stylers;
mod timings;

pub use latest::{Reader, Writer, latest};
pub use plan::{Plan, Retouches, Step, View, Wants};
pub use timings::{Record, Stage, Timings};

use crate::frame::{Frame, Layer, Needs, Sighting};
use crate::geometry::{Lens, Similarity};
use crate::kernel::mix;
use crate::pixels::simd::Level;
use crate::pixels::{Plane, Rgb, Size, TileGrid, TileSet};
use crate::render::{Camera, Look, Placed, Renderer};
use crate::retouch::part::{Part, Styled};
use crate::retouch::{self, Mark, Retouch};
use crate::scene::Scene;
use crate::style::{self, StyleInput, StyleName, composite};
use crate::track::{self, Tracker, Wanted};
use anchor::Anchor;
use glam::{DAffine3, DMat3, DVec3};
use stylers::Stylers;

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
    stylers: Stylers,
    style: style::Config,
    retouch: Retouch,
    retouches: Retouches,
    part: Option<Part>,
    anchor: Option<Anchor>,
    marks: Vec<Mark>,
    placed: Vec<Placed>,
    canvas: Rgb,
    /// What is mixed into the canvas: the picture in the style that a fade comes from, or in none.
    other: Rgb,
    level: Level,
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
        for print in scene.boards.iter().flat_map(|board| &board.prints) {
            if !wanted.iter().any(|w| (w.family, w.id) == (print.family, Some(print.id))) {
                wanted.push(Wanted { family: print.family, id: Some(print.id), side_mm: print.side_mm });
            }
        }
        let tracker =
            Tracker::new(track, level).knowing(scene.patterns.clone()).with_boards(scene.boards.clone());
        Self {
            retouch: Retouch::new(&retouch::Config::default(), &scene, level),
            retouches: Retouches::default(),
            part: style.part.map(Part::new),
            anchor: style.anchored.then(Anchor::default),
            marks: Vec::with_capacity(4 * scene.models.len()),
            placed: Vec::with_capacity(4 * scene.models.len()),
            scene,
            camera: Camera { lens, near: NEAR_MM, far: FAR_MM },
            wanted,
            tracker,
            renderer: Renderer::new(level),
            stylers: Stylers::new(style, level, false),
            style: style.clone(),
            canvas: Rgb::default(),
            other: Rgb::default(),
            level,
        }
    }

    /// The same pipeline, the camera picture retouched first.
    pub fn retouched(mut self, config: &retouch::Config) -> Self {
        self.retouch = Retouch::new(config, &self.scene, self.level);
        self.retouches = config.into();
        self
    }

    /// The same pipeline, with simpler forms of every style built ahead: see [`Pipeline::set_quality`].
    pub fn governed(mut self) -> Self {
        self.stylers = Stylers::new(&self.style, self.level, true);
        self
    }

    /// How many forms the style in front has, the full one included; 1 unless governed.
    pub fn forms(&self) -> usize {
        self.stylers.forms()
    }

    /// Draws so much simpler from the next frame on, each style as far as it goes; 0 = in full. Allocates nothing.
    pub fn set_quality(&mut self, quality: usize) {
        self.stylers.set_quality(quality);
    }

    /// The style in front, or the one that a fade will bring there.
    pub fn style(&self) -> StyleName {
        self.stylers.name()
    }

    /// Asks for another style from the next frame on: `style.fade_ms` long both are drawn and mixed. A switch during
    /// a fade waits until that is over; of several the last counts. May allocate, so that the frames after it need
    /// not; call it inside the pool that draws.
    pub fn switch(&mut self, style: &style::Config) {
        if let Some(built) = self.stylers.switch(style) {
            self.warm(built, self.canvas.size());
        }
    }

    /// Asks for the style `steps` further in the settings' `cycle`, back where negative, round and round. As
    /// [`Pipeline::switch`], but allocates nothing.
    pub fn step_style(&mut self, steps: isize) {
        self.stylers.step(steps);
    }

    /// The style that the first frame is drawn in, of those built ahead; without a fade.
    pub fn begin_with(&mut self, style: StyleName) {
        self.stylers.begin_with(style);
    }

    /// Gives every style its buffers for pictures of `size`, before the first one comes. Allocates; call it inside a
    /// pool.
    pub fn prepare(&mut self, size: Size) {
        self.canvas.resize(size);
        for slot in 0..self.stylers.len() {
            self.warm(slot, size);
        }
    }

    /// The picture last drawn.
    pub fn canvas(&self) -> &Rgb {
        &self.canvas
    }

    /// Draws one picture nobody sees, so that the style in `slot` has its buffers before it is wanted.
    fn warm(&mut self, slot: usize, size: Size) {
        if size.area() == 0 {
            return;
        }
        // every model once, half a meter before the lens, its marker facing it
        let before = DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            translation: DVec3::new(0.0, 0.0, 500.0),
        };
        let models = self.scene.models.iter().enumerate();
        self.placed.clear();
        self.placed.extend(models.map(|(model, m)| Placed { model, to_camera: before * m.to_marker }));
        self.renderer.draw(&self.scene, &self.placed, &self.camera, self.stylers.look(slot));
        let color = Rgb::new(size, [128; 3]);
        let frame = Frame { luma: Plane::new(size, 128), color, ..Frame::default() };
        let mut layer = empty_layer(size);
        layer.particles.reserve(self.renderer.layer().particles.capacity());
        self.other.resize(size);
        for styler in self.stylers.all(slot) {
            styler.anchor(self.anchor.is_some().then_some(Similarity::IDENTITY));
            styler.draw(StyleInput { frame: &frame, layer: Some(&layer) }, &mut self.other);
            styler.restart();
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
        Plan::new(&self.scene, self.wants(), view)
    }

    fn wants(&self) -> Wants {
        let stylers = &self.stylers;
        Wants {
            needs: stylers.needs(),
            filters: stylers.filters(),
            fades: stylers.is_fading(),
            quality: stylers.quality(),
            part: self.part.as_ref().map(Part::of),
            anchored: self.anchor.is_some(),
            retouch: self.retouches,
        }
    }

    /// Draws one frame: the whole way through, top to bottom.
    pub fn draw_frame(&mut self, frame: &Frame) -> Drawn<'_> {
        if self.canvas.size() != frame.size() {
            self.resize(frame.size());
        }
        let mut timings = Timings::default();
        let turn = self.stylers.turn(frame.captured_at);
        let plan = self.plan(View::Unknown);
        let sightings = if plan.track.runs {
            let (tracker, luma) = (&mut self.tracker, frame.luma.view());
            let at = frame.captured_at;
            timings.measure(Stage::Track, || tracker.follow(luma, &self.camera.lens, &self.wanted, at))
        } else {
            &[]
        };
        mark(&self.wanted, sightings, &mut self.marks);
        place(&self.scene, &self.marks, &mut self.placed);
        let plan = Plan::new(&self.scene, plan.wants, View::Models(self.placed.len()));
        let (marks, camera, scene) = (&self.marks, &self.camera, &mut self.scene);
        let retouch = &mut self.retouch;
        let (frame, tint) =
            timings.measure(Stage::Style, || retouch.frame(frame, scene, marks, &camera.lens));
        scene.light.tint = tint;

        let motion = self.anchor.as_mut().map(|anchor| anchor.follow(marks, &camera.lens));

        // the style that leaves first: what it drew is mixed into the other's picture
        let slots = [turn.leaving.unwrap_or(turn.front), turn.front];
        let beside = if self.part.is_some() { Needs::COLOR } else { Needs::NOTHING };
        let look_of = |look: Look| Look { needs: look.needs.and(beside).within(plan.needs), ..look };
        let mut look = look_of(self.stylers.look(slots[0]));
        let (renderer, placed) = (&mut self.renderer, &self.placed);
        if plan.render.runs {
            timings.measure(Stage::Render, || renderer.draw(scene, placed, camera, look));
        }
        let layer = plan.render.runs.then_some(renderer.layer());
        let styled = match &mut self.part {
            Some(part) => {
                timings.measure(Stage::Style, || part.of_frame(frame.size(), layer, marks, &camera.lens))
            }
            None => Styled::Everything,
        };
        let drawn = if styled == Styled::Nothing { &[] } else { &slots[usize::from(slots[0] == slots[1])..] };
        for &slot in drawn {
            let wanted = look_of(self.stylers.look(slot));
            if plan.render.runs && wanted != look {
                look = wanted;
                timings.measure(Stage::Render, || renderer.draw(scene, placed, camera, look));
            }
            let layer = plan.render.runs.then_some(renderer.layer());
            let out = if slot == turn.front { &mut self.canvas } else { &mut self.other };
            let styler = self.stylers.get(slot);
            styler.anchor(motion);
            timings.measure(Stage::Style, || styler.draw(StyleInput { frame, layer }, out));
        }
        let (level, canvas, other) = (self.level, &mut self.canvas, &mut self.other);
        timings.measure(Stage::Style, || {
            let layer = plan.render.runs.then_some(renderer.layer());
            if turn.leaving.is_some() && styled != Styled::Nothing {
                mix::fade(level, other, turn.share, canvas);
            }
            match styled {
                Styled::Everything => {}
                Styled::Nothing => plain(frame, layer, canvas),
                Styled::Mask(mask) => {
                    plain(frame, layer, other);
                    mix::mask(level, other, mask, canvas);
                }
            }
        });
        Drawn { canvas: &self.canvas, sightings, models: self.placed.len(), plan, timings }
    }

    /// Takes another picture size: every style that may be asked for gets its buffers.
    fn resize(&mut self, size: Size) {
        self.canvas.resize(size);
        if self.stylers.len() > 1 || self.stylers.forms() > 1 {
            for slot in 0..self.stylers.len() {
                self.warm(slot, size);
            }
        }
    }
}

/// Conventional augmented reality.
fn plain(frame: &Frame, layer: Option<&Layer>, out: &mut Rgb) {
    out.copy_from(&frame.color);
    if let Some(layer) = layer {
        composite::over(layer, out);
    }
}

/// A layer that shows nothing but is not skipped either.
fn empty_layer(size: Size) -> Layer {
    let grid = TileGrid::new(size);
    let mut touched = TileSet::new(grid);
    touched.insert(0);
    let far = Plane::new(size, f32::INFINITY);
    let flat = [0; 3].map(|_| Plane::new(size, 0.0));
    Layer {
        color: Rgb::new(size, [0; 3]),
        depth: far.clone(),
        normal: flat.clone(),
        depth2: far,
        normal2: flat,
        extent: [1.0, 2.0],
        touched,
        grid: Some(grid),
        ..Layer::default()
    }
}

/// The prints that have a pose, with the size that the scene says they have.
fn mark(wanted: &[Wanted], sightings: &[Sighting], marks: &mut Vec<Mark>) {
    marks.clear();
    for &Sighting { family, id, pose, .. } in sightings {
        if let (Some(solved), Some(want)) = (pose, track::wish(wanted, family, id)) {
            marks.push(Mark { family, id, side_mm: want.side_mm, pose: solved.pose });
        }
    }
}

/// Puts every model on its marker.
fn place(scene: &Scene, marks: &[Mark], placed: &mut Vec<Placed>) {
    placed.clear();
    for mark in marks {
        let to_camera = DAffine3 { matrix3: mark.pose.rotation, translation: mark.pose.translation };
        for (index, model) in scene.models.iter().enumerate() {
            if model.anchor.takes(mark.family, mark.id) {
                placed.push(Placed { model: index, to_camera: to_camera * model.to_marker });
            }
        }
    }
}
