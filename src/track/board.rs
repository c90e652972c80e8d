//! Prints fixed to one another: one pose for all of them.
//!
//! Each print's two minima are two guesses of the board's pose; the one that explains all prints best is refined by
//! Levenberg-Marquardt on every corner seen, prints that do not fit (a loose copy, a bent corner of the sheet) weighed
//! down after Geman & McClure. One print's ambiguity is so decided by the others.

use super::solve::{self, corners_mm};
use crate::frame::{Sighting, Solved, State};
use crate::geometry::{Lens, Pose, solve_spd};
use crate::marker::{Board, Print};
use glam::{DVec2, DVec3};

/// Most steps.
const STEPS: usize = 12;
/// A print this far off (root mean square over its corners, px) has a quarter of its weight.
const REACH_PX: f64 = 2.0;
/// A print farther off than this, px and of its side, is not on the board.
const LOOSE_PX: f64 = 3.0;
const LOOSE_PART: f64 = 0.08;
/// The other minima are meant only where they cost less than this part of the best of the first ones.
const OTHER: f64 = 0.6;
/// A step that gains less than this part of the cost is the last one.
const ENOUGH: f64 = 1e-9;

/// Gives the board's prints its one pose: those seen, and as [`State::Held`] those that are not but stand in the
/// picture. Nothing changes where no print of it is seen.
pub fn settle(board: &Board, lens: &Lens, sightings: &mut Vec<Sighting>) {
    let seen = |sighting: &Sighting| sighting.state != State::Held;
    let count = board.prints.iter().filter(|print| sightings.iter().any(|s| is(print, s) && seen(s))).count();
    // a lone print's pose is the board's, its other minimum stays
    let lone = |print: &Print| {
        let own = sightings.iter().find(|s| is(print, s) && seen(s))?.pose?.pose;
        Some(own.after(&print.to_board.inverse()))
    };
    let pose = match count {
        0 => None,
        1 => board.prints.iter().find_map(lone),
        _ => pose(board, lens, sightings),
    };
    let Some(pose) = pose else { return };
    for print in &board.prints {
        let own = pose.after(&print.to_board);
        let placed = |corners: &[DVec2; 4]| Solved {
            pose: own,
            error_px: mean_square(&own, print, corners, lens).sqrt(),
        };
        match sightings.iter_mut().find(|sighting| is(print, sighting)) {
            Some(sighting) if seen(sighting) && count == 1 => {}
            Some(sighting) if seen(sighting) => {
                let solved = placed(&sighting.corners);
                if solved.error_px <= loose(&sighting.corners) {
                    (sighting.pose, sighting.pose_alt) = (Some(solved), None);
                }
            }
            held => {
                let Some(corners) = corners(&own, print, lens) else { continue };
                let sighting = Sighting {
                    family: print.family,
                    id: print.id,
                    corners,
                    hamming: 0,
                    margin: 0.0,
                    pose: Some(Solved { pose: own, error_px: 0.0 }),
                    pose_alt: None,
                    state: State::Held,
                };
                match held {
                    Some(held) => *held = sighting,
                    None => sightings.push(sighting),
                }
            }
        }
    }
    sightings.sort_by_key(|sighting| (sighting.family, sighting.id));
}

fn is(print: &Print, sighting: &Sighting) -> bool {
    (sighting.family, sighting.id) == (print.family, print.id)
}

/// Where the print's corners are seen; `None` unless all are before the camera and in the picture.
fn corners(pose: &Pose, print: &Print, lens: &Lens) -> Option<[DVec2; 4]> {
    let size = DVec2::new(lens.size.width as f64, lens.size.height as f64);
    let mut out = [DVec2::ZERO; 4];
    for (px, mm) in out.iter_mut().zip(corners_mm(print.side_mm)) {
        *px = lens.project(pose.apply(mm))?;
        if !(px.min_element() >= -0.5 && px.x <= size.x - 0.5 && px.y <= size.y - 0.5) {
            return None;
        }
    }
    // its face, not its back
    (super::quad::area(&out) > 0.0).then_some(out)
}

/// Mean square distance of the corners from where the pose puts them, px².
fn mean_square(pose: &Pose, print: &Print, corners: &[DVec2; 4], lens: &Lens) -> f64 {
    solve::cost(pose, corners, None, &corners_mm(print.side_mm), lens) * 0.25
}

fn loose(corners: &[DVec2; 4]) -> f64 {
    LOOSE_PX.max(LOOSE_PART * super::mean_side(corners))
}

/// The pose that explains the prints seen, board → camera.
fn pose(board: &Board, lens: &Lens, sightings: &[Sighting]) -> Option<Pose> {
    let seen = || {
        board.prints.iter().filter_map(|print| {
            let sighting = sightings.iter().find(|s| is(print, s) && s.state != State::Held)?;
            Some((print, sighting))
        })
    };
    let cost = |pose: &Pose| -> f64 {
        let robust = |(print, sighting): (&Print, &Sighting)| {
            let square = mean_square(&pose.after(&print.to_board), print, &sighting.corners, lens);
            // Geman-McClure's ρ; infinity counts as its limit
            if square.is_finite() {
                square / (1.0 + square / (REACH_PX * REACH_PX))
            } else {
                REACH_PX * REACH_PX
            }
        };
        seen().map(robust).sum()
    };
    let mut best: Option<(Pose, f64)> = None;
    for pick in [|s: &Sighting| s.pose, |s: &Sighting| s.pose_alt] {
        // time preferred the first ones
        let mut least = best.map_or(f64::INFINITY, |(_, cost)| OTHER * cost);
        for (print, sighting) in seen() {
            let Some(solved) = pick(sighting) else { continue };
            let guess = solved.pose.after(&print.to_board.inverse());
            let cost = cost(&guess);
            if cost < least {
                (best, least) = (Some((guess, cost)), cost);
            }
        }
    }
    let (mut pose, mut now) = best?;
    let mut damping = 1e-4;
    for _ in 0..STEPS {
        let (mut a, mut b) = ([[0.0; 6]; 6], [0.0; 6]);
        for (print, sighting) in seen() {
            let place = pose.after(&print.to_board);
            let square = mean_square(&place, print, &sighting.corners, lens);
            let near = 1.0 / (1.0 + square / (REACH_PX * REACH_PX));
            let points = corners_mm(print.side_mm).map(|p| print.to_board.apply(p));
            let equations = solve::equations(&pose, &sighting.corners, None, &points, print.side_mm, lens);
            let Some((part, right)) = equations else { continue };
            // shifts in the first print's side, whatever this one's is
            let unit = board.prints[0].side_mm / print.side_mm;
            let scale = |i: usize| if i < 3 { 1.0 } else { unit };
            for i in 0..6 {
                for j in 0..=i {
                    a[i][j] += near * near * part[i][j] * scale(i) * scale(j);
                }
                b[i] += near * near * right[i] * scale(i);
            }
        }
        for (i, row) in a.iter_mut().enumerate() {
            row[i] += damping * row[i] + 1e-300;
        }
        let Some(step) = solve_spd(a, b) else { break };
        let next = Pose {
            rotation: solve::cayley(DVec3::new(step[0], step[1], step[2])) * pose.rotation,
            translation: pose.translation + DVec3::new(step[3], step[4], step[5]) * board.prints[0].side_mm,
        };
        let then = cost(&next);
        if then < now {
            let gain = now - then;
            (pose, now) = (next, then);
            damping = (damping * 0.1).max(1e-12);
            if gain <= ENOUGH * now {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    let pose = Pose { rotation: solve::orthonormal(pose.rotation)?, translation: pose.translation };
    pose.translation.is_finite().then_some(pose)
}
