//! What a frame needs: a pure function of the scene, the style and what is seen.
//!
//! Nothing is computed that the scene does not need. The plan decides it in one place, is cheap enough to be
//! made anew every frame, and can say what it skipped and why.

use crate::frame::Needs;
use crate::retouch::{self, part::Of};
use crate::scene::Scene;
use std::fmt;

/// Whether a stage runs, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Whether it runs.
    pub runs: bool,
    /// The reason, for people.
    pub why: &'static str,
}

impl Step {
    const fn run(why: &'static str) -> Self {
        Self { runs: true, why }
    }

    const fn skip(why: &'static str) -> Self {
        Self { runs: false, why }
    }
}

/// What one frame computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Search the frame for markers.
    pub track: Step,
    /// Calm the camera's noise.
    pub steady: Step,
    /// Measure the room's light.
    pub light: Step,
    /// Paint the markers over.
    pub hide: Step,
    /// Let the models throw shadows.
    pub shadow: Step,
    /// Draw the models.
    pub render: Step,
    /// What the renderer must deliver.
    pub needs: Needs,
    /// Normals per pixel.
    pub normal: Step,
    /// The second-nearest surface.
    pub second_layer: Step,
    /// Thick outlines.
    pub silhouettes: Step,
    /// Secondary models apart from the others.
    pub secondary: Step,
    /// Which model each pixel shows.
    pub objects: Step,
    /// The models as points.
    pub particles: Step,
    /// Filter the picture.
    pub style: Step,
    /// Let the style's pattern move with the scene.
    pub anchor: Step,
    /// Show the style in part of the picture only.
    pub part: Step,
    /// Mix the style with the one it follows.
    pub fade: Step,
    /// Draw the style in a simpler way.
    pub simplify: Step,
    /// What it was made from.
    pub wants: Wants,
}

/// What style and settings ask of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wants {
    /// What the style wants of the renderer; of both styles during a fade.
    pub needs: Needs,
    /// Whether the style changes the picture itself.
    pub filters: bool,
    /// Whether one style is fading into another.
    pub fades: bool,
    /// How far the style is simplified to keep to the budget.
    pub quality: usize,
    /// What the style is the part of, where it is not the whole picture.
    pub part: Option<Of>,
    /// Whether the style's pattern moves with the scene.
    pub anchored: bool,
    /// What is done to the camera picture.
    pub retouch: Retouches,
}

/// Which retouches the settings ask for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retouches {
    /// Calm the camera's noise.
    pub steady: bool,
    /// Paint the markers over.
    pub hide: bool,
    /// Measure the room's light.
    pub light: bool,
    /// Let the models throw shadows.
    pub shadow: bool,
}

impl From<&retouch::Config> for Retouches {
    fn from(config: &retouch::Config) -> Self {
        Self {
            steady: config.steady.is_some(),
            hide: config.hide.is_some(),
            light: config.light.is_some(),
            shadow: config.shadow.is_some(),
        }
    }
}

/// What is known to be in view when a plan is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// Tracking has not run yet.
    Unknown,
    /// This many models have a pose.
    Models(usize),
}

impl Plan {
    /// The plan for a frame of `scene` that is drawn as `wants` says, with `view` in sight.
    pub fn new(scene: &Scene, wants: Wants, view: View) -> Self {
        let Wants { needs, filters, fades, quality, part: of, anchored, retouch } = wants;
        let apart = scene.models.iter().any(|model| model.secondary);
        let needs = if apart { needs } else { needs.without(Needs::SECONDARY) };
        // beside a styled part stands conventional augmented reality
        let needs = if of.is_some() { needs.and(Needs::COLOR) } else { needs };
        let wants_layer = needs != Needs::NOTHING || retouch.hide || anchored || of == Some(Of::Marker);
        let track = match (scene.models.is_empty(), wants_layer) {
            (true, _) => Step::skip("the scene has no model on any marker"),
            (false, false) => Step::skip("the style draws no models"),
            (false, true) => Step::run("models stand on markers"),
        };
        let render = match (track.runs, view) {
            (false, _) => Step::skip(track.why),
            (true, View::Models(0)) => Step::skip("no marker of the scene is in view"),
            (true, View::Models(_)) => Step::run("a marker with a model is in view"),
            (true, View::Unknown) => Step::run("where a marker with a model is in view"),
        };
        let marked = |on: bool, why: &'static str| match (on, track.runs, view) {
            (false, ..) => Step::skip("the settings do not ask for it"),
            (true, false, _) => Step::skip(track.why),
            (true, true, View::Models(0)) => Step::skip("no marker of the scene is in view"),
            (true, true, _) => Step::run(why),
        };
        let part =
            |wanted: Needs, why: &'static str, not: &'static str| match (render.runs, needs.includes(wanted))
            {
                (true, true) => Step::run(why),
                (true, false) => Step::skip(not),
                (false, _) => Step::skip(render.why),
            };
        Plan {
            track,
            steady: match retouch.steady {
                true => Step::run("the settings want the camera's noise calmed"),
                false => Step::skip("the settings do not ask for it"),
            },
            light: marked(retouch.light, "models are drawn in the light that the paper shows"),
            hide: marked(retouch.hide, "the prints are painted over"),
            shadow: marked(retouch.shadow, "models darken the plane they stand on"),
            render,
            needs: if render.runs { needs } else { Needs::NOTHING },
            normal: part(Needs::NORMAL, "the style reads normals", "the style reads no normals"),
            second_layer: part(
                Needs::SECOND_LAYER,
                "the style looks through the first surface",
                "the style draws the nearest surface only",
            ),
            silhouettes: part(
                Needs::SILHOUETTE,
                "the style outlines the models",
                "the style outlines no models itself",
            ),
            secondary: part(
                Needs::SECONDARY,
                "the style shows what is inside",
                match apart {
                    true => "the style draws secondary models as any other",
                    false => "the scene has no secondary model",
                },
            ),
            objects: part(
                Needs::OBJECT,
                "the style tells models apart",
                "the style does not tell models apart",
            ),
            particles: part(
                Needs::PARTICLES,
                "the style draws particles",
                "the style draws surfaces, not particles",
            ),
            style: if filters {
                Step::run("the style filters the whole picture")
            } else {
                Step::skip("the style shows the camera picture as it is, models over it")
            },
            anchor: marked(anchored, "the style's pattern moves with the marker's surface"),
            part: match (of, render.runs) {
                (None, _) => Step::skip("the style has the whole picture"),
                (Some(Of::Object), true) => Step::run("the style is bounded by the models"),
                (Some(Of::Object), false) => Step::run("no model is drawn to bound the style"),
                (Some(Of::Marker), _) => Step::run("the style is bounded by the markers"),
                (Some(Of::Vignette), _) => Step::run("the style is bounded by an ellipse"),
            },
            fade: if fades {
                Step::run("one style gives way to the next: both are drawn")
            } else {
                Step::skip("the style stays")
            },
            simplify: match quality {
                0 => Step::skip("frames keep to their budget, or have none"),
                1 => Step::run("frames cost more than their budget: one level simpler"),
                _ => Step::run("frames cost more than their budget: two levels simpler"),
            },
            wants,
        }
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let steps = [
            ("track markers", self.track),
            ("steady picture", self.steady),
            ("measure light", self.light),
            ("hide markers", self.hide),
            ("cast shadows", self.shadow),
            ("draw models", self.render),
            ("  normals", self.normal),
            ("  second layer", self.second_layer),
            ("  silhouettes", self.silhouettes),
            ("  secondary", self.secondary),
            ("  which model", self.objects),
            ("  particles", self.particles),
            ("filter picture", self.style),
            ("anchor pattern", self.anchor),
            ("style a part", self.part),
            ("fade styles", self.fade),
            ("simplify", self.simplify),
        ];
        for (name, step) in steps {
            let does = if step.runs { "runs" } else { "skipped" };
            writeln!(f, "{name:<16} {does:<8} {}", step.why)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::Family;
    use crate::scene::{Anchor, Mesh, Model, Shading};
    use glam::DAffine3;

    fn scene(models: usize, secondary: bool) -> Scene {
        let model = Model {
            name: "cube".into(),
            mesh: Mesh::default().into(),
            anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 80.0 },
            to_marker: DAffine3::IDENTITY,
            shading: Shading::Smooth,
            cull_back: false,
            secondary,
            phantom: false,
        };
        Scene { models: vec![model; models], ..Scene::default() }
    }

    #[test]
    fn what_runs_for_every_kind_of_frame() {
        let color = Needs::COLOR;
        let both = Needs::COLOR.and(Needs::NORMAL).and(Needs::SECOND_LAYER);
        let lines = Needs::COLOR.and(Needs::SILHOUETTE);
        let inside = both.and(Needs::SECONDARY);
        let (apart, same) = (true, false);
        // models in scene, secondary or not, needs, view → track, render, normal, second layer, silhouettes, secondary,
        // particles
        let table = [
            (0, same, color, View::Unknown, "-------"),
            (1, same, Needs::NOTHING, View::Unknown, "-------"),
            (1, same, color, View::Unknown, "tr-----"),
            (1, same, color, View::Models(0), "t------"),
            (2, same, color, View::Models(1), "tr-----"),
            (1, same, both, View::Models(1), "trns---"),
            (1, same, both, View::Models(0), "t------"),
            (1, same, lines, View::Models(1), "tr--l--"),
            (1, same, lines, View::Models(0), "t------"),
            (2, apart, inside, View::Models(2), "trns-i-"),
            (2, apart, inside, View::Models(0), "t------"),
            (2, same, inside, View::Models(2), "trns---"),
            (2, apart, both, View::Models(2), "trns---"),
            (1, same, Needs::PARTICLES, View::Models(1), "tr----p"),
            (1, same, Needs::PARTICLES, View::Models(0), "t------"),
        ];
        for (models, secondary, needs, view, expected) in table {
            let plan = Plan::new(
                &scene(models, secondary),
                Wants { needs, filters: true, ..Wants::default() },
                view,
            );
            let steps = [
                plan.track,
                plan.render,
                plan.normal,
                plan.second_layer,
                plan.silhouettes,
                plan.secondary,
                plan.particles,
            ];
            let got: String =
                steps.iter().zip("trnslip".chars()).map(|(s, c)| if s.runs { c } else { '-' }).collect();
            assert_eq!(got, expected, "{models} models, {needs:?}, {view:?}");
            assert_eq!(
                plan.needs == Needs::NOTHING,
                !plan.render.runs,
                "nothing is asked of an idle renderer"
            );
            assert_eq!(plan.needs.includes(Needs::SECONDARY), plan.secondary.runs);
        }
    }
}
