//! Where a style's pattern is held: by the surface that carries a marker.
//!
//! Patterns have a plane of their own, at first the picture's. When a marker is seen, the pattern is pinned to its
//! plane as it lies; from then on turn, scale and shift of the picture around the marker carry it along. While no
//! marker is in view it rests, and is pinned again, as it then lies, to the next: it never jumps.

use crate::geometry::{Lens, Similarity};
use crate::marker::Family;
use crate::retouch::Mark;
use glam::{DVec2, DVec3};

/// Pattern pixels a picture pixel, at least and at most: patterns neither dissolve nor coarsen beyond this.
const SCALES: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// What holds the pattern.
#[derive(Debug)]
pub struct Anchor {
    held_by: Option<(Family, u32)>,
    /// Marker's plane (mm, y down) → pattern.
    pin: Similarity,
    /// Picture → pattern.
    now: Similarity,
}

impl Default for Anchor {
    fn default() -> Self {
        Self { held_by: None, pin: Similarity::IDENTITY, now: Similarity::IDENTITY }
    }
}

impl Anchor {
    /// The pattern's place in a frame with these prints: picture px → pattern px.
    pub fn follow(&mut self, marks: &[Mark], lens: &Lens) -> Similarity {
        let same = |mark: &&Mark| self.held_by == Some((mark.family, mark.id));
        let mark = marks.iter().find(same).or(marks.first());
        let seen = mark.and_then(|mark| Some((mark, around(mark, lens)?)));
        let Some((mark, view)) = seen else {
            self.held_by = None;
            return self.now;
        };
        let name = Some((mark.family, mark.id));
        if self.held_by != name {
            self.held_by = name;
            self.pin = self.now.after(&view);
        }
        self.now = self.pin.after(&view.inverse());
        let scale = self.now.scale();
        if !SCALES.contains(&scale) {
            // the marker's middle stays where it is in the pattern
            let turn = self.now.turn * (scale.clamp(*SCALES.start(), *SCALES.end()) / scale);
            let free = Similarity { turn, shift: DVec2::ZERO };
            self.now.shift = self.pin.shift - free.apply(view.shift);
            self.now.turn = turn;
        }
        self.now
    }
}

/// How the picture shows the marker's plane (mm, y down) around its middle: the similarity nearest to it. `None`
/// when it is behind the lens or seen edge on.
fn around(mark: &Mark, lens: &Lens) -> Option<Similarity> {
    let h = mark.side_mm / 4.0;
    let at = |x: f64, y: f64| lens.project(mark.pose.apply(DVec3::new(x, -y, 0.0)));
    let across = (at(h, 0.0)? - at(-h, 0.0)?) / (2.0 * h);
    let down = (at(0.0, h)? - at(0.0, -h)?) / (2.0 * h);
    let turn = DVec2::new(across.x + down.y, across.y - down.x) / 2.0;
    let shift = at(0.0, 0.0)?;
    (turn.length_squared() > 1e-12 && turn.is_finite()).then_some(Similarity { turn, shift })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Synthetic, SyntheticConfig};
    use crate::pixels::{Size, simd};

    fn mark(camera: &Synthetic, number: u64) -> Mark {
        Mark { family: Family::Tag36h11, id: 7, side_mm: 80.0, pose: camera.truth(number) }
    }

    #[test]
    fn the_pattern_moves_as_the_scene_does() {
        let settings = SyntheticConfig { pace: 4.0, ..SyntheticConfig::default() };
        let camera = Synthetic::new(&settings, Size::new(640, 480), 30.0, simd::best());
        let lens = camera.lens();
        let mut anchor = Anchor::default();
        let mut last = anchor.follow(&[mark(&camera, 0)], &lens);
        assert!((last.scale() - 1.0).abs() < 1e-12 && last.shift.length() < 1e-9, "as it lies: {last:?}");
        // displacements of the print and of the pattern that lay under it
        let (mut dot, mut scene_square, mut pattern_square) = (0.0, 0.0, 0.0);
        for number in 1..200 {
            let now = anchor.follow(&[mark(&camera, number)], &lens);
            for (x, y) in [(0.0, 0.0), (40.0, 40.0), (-40.0, 40.0), (40.0, -40.0), (-40.0, -40.0)] {
                let at = |n: u64| lens.project(camera.truth(n).apply(DVec3::new(x, y, 0.0))).expect("seen");
                let scene = at(number) - at(number - 1);
                let pattern = now.inverse().apply(last.apply(at(number - 1))) - at(number - 1);
                dot += scene.dot(pattern);
                scene_square += scene.length_squared();
                pattern_square += pattern.length_squared();
            }
            last = now;
        }
        let correlation = dot / (scene_square * pattern_square).sqrt();
        assert!(correlation > 0.95, "correlation {correlation}");
    }

    #[test]
    fn it_rests_without_a_marker_and_never_jumps() {
        let camera = Synthetic::new(&SyntheticConfig::default(), Size::new(640, 480), 30.0, simd::best());
        let lens = camera.lens();
        let mut anchor = Anchor::default();
        anchor.follow(&[mark(&camera, 0)], &lens);
        let held = anchor.follow(&[mark(&camera, 30)], &lens);
        assert_eq!(anchor.follow(&[], &lens), held);
        let again = anchor.follow(&[mark(&camera, 300)], &lens);
        assert!((again.turn - held.turn).length() < 1e-9 && (again.shift - held.shift).length() < 1e-6);
        let other = Mark { id: 8, ..mark(&camera, 60) };
        let passed = anchor.follow(&[other], &lens);
        assert!((passed.shift - again.shift).length() < 1e-6, "another marker takes over");
        let near = Mark {
            pose: crate::geometry::Pose { translation: other.pose.translation / 8.0, ..other.pose },
            ..other
        };
        assert!(SCALES.contains(&(anchor.follow(&[near], &lens).scale())));
    }
}
