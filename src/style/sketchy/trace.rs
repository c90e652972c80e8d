//! Strokes: polylines that begin at edge pixels and follow the force field (section 3.3). Ranges of starts are traced
//! in parallel, each into lists of its own.

use super::Config;
use super::field::{Edge, Field};
use super::starts::Start;
use rayon::prelude::*;
use std::ops::Range;

/// A point of a stroke.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// x, y in px, pixel centers at integers.
    pub at: [f64; 2],
    /// See [`Edge::nearness`].
    pub nearness: f64,
}

/// One stroke of a [`Strokes`] list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke<'a> {
    /// Its start's number in drawing order.
    pub number: u32,
    /// Its points, two at least.
    pub points: &'a [Point],
    /// Least and greatest y of its points.
    pub span: [f64; 2],
}

/// The strokes of a frame.
#[derive(Debug, Default)]
pub struct Strokes {
    parts: Vec<Part>,
}

/// The strokes of a range of starts.
#[derive(Debug, Default)]
struct Part {
    points: Vec<Point>,
    strokes: Vec<Piece>,
}

/// Where a stroke is in its part.
#[derive(Clone, Copy, Debug)]
struct Piece {
    number: u32,
    first: usize,
    last: usize,
    span: [f64; 2],
}

/// Ranges that the starts are divided into.
const PARTS: usize = 16;
/// Points that room is made for at once; more strokes than that make the lists grow as they come.
const ROOM: usize = 1 << 22;

impl Strokes {
    /// Traces the strokes of a frame. Allocates only when settings or the number of starts call for more room than
    /// ever before.
    pub fn trace(&mut self, config: &Config, field: &Field<'_>, starts: &[Start]) {
        self.parts.resize_with(PARTS, Part::default);
        let length = starts.len().div_ceil(PARTS).max(1);
        let points = (length * config.points as usize).min(ROOM / PARTS);
        for part in &mut self.parts {
            part.points.clear();
            part.strokes.clear();
            part.points.reserve(points);
            part.strokes.reserve(length);
        }
        self.parts.par_iter_mut().zip(starts.par_chunks(length)).for_each(|(part, starts)| {
            for start in starts {
                part.follow(config, field, start);
            }
        });
    }

    /// The strokes, upper starts first.
    pub fn iter(&self) -> impl Iterator<Item = Stroke<'_>> {
        self.starting(f64::NEG_INFINITY..f64::INFINITY)
    }

    /// Those whose starts lie in these rows, upper starts first; up to half a row more on either side.
    pub fn starting(&self, rows: Range<f64>) -> impl Iterator<Item = Stroke<'_>> {
        self.parts.iter().flat_map(move |part| {
            // starts are sorted by the row of the pixel that holds them
            let start = |piece: &Piece| part.points[piece.first].at[1];
            let from = part.strokes.partition_point(|piece| start(piece) < rows.start - 1.0);
            let to = part.strokes.partition_point(|piece| start(piece) < rows.end + 1.0);
            part.strokes[from..to].iter().map(|piece| Stroke {
                number: piece.number,
                points: &part.points[piece.first..piece.last],
                span: piece.span,
            })
        })
    }
}

impl Part {
    /// Adds the stroke that begins at `start`, if there is one.
    fn follow(&mut self, config: &Config, field: &Field<'_>, start: &Start) {
        let Some(mut edge) = look_up(field, start.at) else { return };
        let first = self.points.len();
        let mut at = start.at;
        let mut span = [at[1]; 2];
        let mut last = [0.0; 2];
        self.points.push(Point { at, nearness: edge.nearness });
        for _ in 1..config.points {
            let step = onward(edge.force, last);
            at = [at[0] + config.step * step[0], at[1] + config.step * step[1]];
            let Some(next) = look_up(field, at) else { break };
            self.points.push(Point { at, nearness: next.nearness });
            span = [
                if at[1] < span[0] { at[1] } else { span[0] },
                if at[1] > span[1] { at[1] } else { span[1] },
            ];
            (edge, last) = (next, step);
        }
        if self.points.len() - first < 2 {
            self.points.truncate(first);
        } else {
            self.strokes.push(Piece { number: start.number, first, last: self.points.len(), span });
        }
    }
}

/// The force, turned so that it does not lead back where `last` came from.
pub(super) fn onward(force: [f64; 2], last: [f64; 2]) -> [f64; 2] {
    let back = force[0] * last[0] + force[1] * last[1] < 0.0;
    if back { [-force[0], -force[1]] } else { force }
}

/// The edge at the pixel that holds a place; none outside the picture.
#[inline]
pub(super) fn look_up(field: &Field<'_>, [x, y]: [f64; 2]) -> Option<Edge> {
    let (x, y, size) = (x + 0.5, y + 0.5, field.size());
    let inside = x >= 0.0 && y >= 0.0 && x < size.width as f64 && y < size.height as f64;
    // conversion to integers cuts off, which above 0 is the floor
    if inside { field.edge(x as usize, y as usize) } else { None }
}
