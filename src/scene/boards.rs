//! The `[[board]]` tables: prints that are fixed to one another.

use super::Scene;
use crate::geometry::Pose;
use crate::marker::{Board, Family, Print};
use glam::{DMat3, DVec3};
use serde::Deserialize;

/// A `[[board]]` table: one pose for all its prints, and models stay on those that are covered.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardConfig {
    /// Family of its prints; `tag36h11` if left out.
    #[serde(default)]
    pub family: Option<Family>,
    /// Printed side of their black borders' outer edges, mm; 80 if left out.
    #[serde(default = "eighty")]
    pub side_mm: f64,
    /// The prints, at least 2.
    pub prints: Vec<PrintConfig>,
}

/// Where a print is fixed.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrintConfig {
    /// Its number in the family.
    pub id: u32,
    /// Where its center is on the board, mm: x right, y up, z out of the board.
    pub at_mm: [f64; 3],
    /// How it is turned about the board's x, then y, then z axis, degrees.
    #[serde(default)]
    pub rotate_deg: [f64; 3],
}

/// Why a board cannot be used; names its table.
#[derive(Debug, thiserror::Error)]
#[error("[[board]] number {number}: {reason}")]
pub struct BoardError {
    /// Which `[[board]]` table, counted from 1.
    pub number: usize,
    /// What is wrong and what to do.
    pub reason: String,
}

fn eighty() -> f64 {
    80.0
}

impl BoardConfig {
    fn build(&self) -> Result<Board, String> {
        let family = self.family.unwrap_or(Family::Tag36h11);
        if !(self.side_mm.is_finite() && self.side_mm > 0.0) {
            return Err(format!("side_mm = {}: give a number above 0", self.side_mm));
        }
        if self.prints.len() < 2 {
            return Err("a board has at least 2 prints; a lone one is a model's `marker`".into());
        }
        let print = |config: &PrintConfig| {
            let codes = family.codes().len();
            if config.id as usize >= codes {
                return Err(format!(
                    "id = {}: {} has ids 0 to {}",
                    config.id,
                    family.name(),
                    codes.max(1) - 1
                ));
            }
            if !config.at_mm.iter().chain(&config.rotate_deg).all(|v| v.is_finite()) {
                return Err(format!("print {}: at_mm and rotate_deg must be finite numbers", config.id));
            }
            let [x, y, z] = config.rotate_deg.map(f64::to_radians);
            let rotation = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
            let to_board = Pose { rotation, translation: DVec3::from(config.at_mm) };
            Ok(Print { family, id: config.id, side_mm: self.side_mm, to_board })
        };
        Ok(Board { prints: self.prints.iter().map(print).collect::<Result<_, _>>()? })
    }
}

impl Scene {
    /// The same scene with these boards. Fails where a print is on two boards or twice on one, or a model says
    /// another size of it.
    pub fn on_boards(mut self, boards: &[BoardConfig]) -> Result<Scene, BoardError> {
        for (index, config) in boards.iter().enumerate() {
            let fail = |reason| BoardError { number: index + 1, reason };
            let board = config.build().map_err(fail)?;
            for (i, print) in board.prints.iter().enumerate() {
                let (family, id) = (print.family, print.id);
                let same = |other: &Print| (other.family, other.id) == (family, id);
                let earlier = self.boards.iter().flat_map(|board| &board.prints);
                if board.prints[..i].iter().chain(earlier).any(same) {
                    return Err(fail(format!("print {id} is fixed twice: name each print once")));
                }
                let differs =
                    |m: &&super::Model| m.anchor.takes(family, id) && m.anchor.side_mm != print.side_mm;
                if let Some(model) = self.models.iter().find(differs) {
                    let (here, there) = (print.side_mm, model.anchor.side_mm);
                    return Err(fail(format!(
                        "print {id} is {here} mm wide here and {there} mm for {}: a print has one side_mm",
                        model.name
                    )));
                }
            }
            self.boards.push(board);
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boards(text: &str) -> Result<Scene, String> {
        let board = toml::from_str(text).map_err(|e| e.to_string())?;
        Scene::default().on_boards(&[board]).map_err(|e| e.to_string())
    }

    #[test]
    fn boards_are_read_or_refused() {
        let scene = boards("side_mm = 30\nprints = [{ id = 1, at_mm = [0, 0, 0] }, { id = 2, at_mm = [50, 0, 9], rotate_deg = [0, 90, 0] }]")
            .expect("a board");
        let [first, second] = scene.boards[0].prints[..] else { panic!("two prints") };
        assert_eq!((first.family, first.id, first.side_mm), (Family::Tag36h11, 1, 30.0));
        assert_eq!(second.to_board.translation, DVec3::new(50.0, 0.0, 9.0));
        // it faces along the board's x
        assert!((second.to_board.rotation * DVec3::Z - DVec3::X).length() < 1e-12);
        for (text, says) in [
            ("prints = [{ id = 1, at_mm = [0, 0, 0] }]", "at least 2"),
            ("prints = [{ id = 1, at_mm = [0, 0, 0] }, { id = 1, at_mm = [9, 0, 0] }]", "fixed twice"),
            ("prints = [{ id = 1, at_mm = [0, 0, 0] }, { id = 600, at_mm = [9, 0, 0] }]", "ids 0 to 586"),
            ("prints = [{ id = 1, at_mm = [0, 0, inf] }, { id = 2, at_mm = [9, 0, 0] }]", "finite"),
            ("side_mm = 0\nprints = []", "above 0"),
            ("size_mm = 3\nprints = []", "unknown field"),
        ] {
            let error = boards(text).expect_err(text);
            assert!(error.contains(says), "{text}: {error}");
        }
    }
}
