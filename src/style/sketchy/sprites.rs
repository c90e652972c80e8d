//! Lone brush prints (section 3.3, third method): each start owns a particle that is born there when it is on an
//! edge, follows the field a step a frame, rests where there is no edge, and dies when its time is up.
//!
//! Births are spread over the frames of a lifetime by the starts' numbers; in a first frame all are born at once.

use super::Config;
use super::brush::Brush;
use super::field::Field;
use super::ink::Rows;
use super::starts::Starts;
use super::trace::{look_up, onward};
use rayon::prelude::*;

/// A brush print.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sprite {
    /// x, y of its middle in px, pixel centers at integers.
    pub at: [f64; 2],
    /// See `Edge::nearness`.
    pub nearness: f64,
    /// The last step's direction, 0 at first.
    heading: [f64; 2],
    alive: bool,
}

/// The particles of all starts.
#[derive(Debug, Default)]
pub struct Sprites {
    particles: Vec<Sprite>,
    alive: Vec<Sprite>,
}

impl Sprites {
    /// Goes on to frame number `frame`; frame 0 begins anew. Allocates only when there are more starts than ever.
    pub fn advance(&mut self, config: &Config, field: &Field<'_>, starts: &Starts, frame: u64) {
        let starts = starts.by_number();
        self.particles.resize(starts.len(), Sprite::default());
        let lifetime = u64::from(config.lifetime.max(1));
        self.particles.par_iter_mut().zip(starts).with_min_len(1024).for_each(|(sprite, start)| {
            let born = frame == 0 || (frame + u64::from(start.number)).is_multiple_of(lifetime);
            if born {
                let edge = look_up(field, start.at);
                let nearness = edge.map_or(0.0, |edge| edge.nearness);
                *sprite = Sprite { at: start.at, nearness, heading: [0.0; 2], alive: edge.is_some() };
            } else if sprite.alive
                && let Some(edge) = look_up(field, sprite.at)
            {
                let [x, y] = onward(edge.force, sprite.heading);
                sprite.at = [sprite.at[0] + config.step * x, sprite.at[1] + config.step * y];
                (sprite.heading, sprite.nearness) = ([x, y], edge.nearness);
            }
        });
        self.alive.clear();
        self.alive.reserve(starts.len());
        self.alive.extend(self.particles.iter().filter(|sprite| sprite.alive));
    }

    /// The living ones, in their starts' drawing order.
    pub fn alive(&self) -> &[Sprite] {
        &self.alive
    }
}

/// From its middle, how far the print of a sprite reaches, px.
pub fn reach(config: &Config, nearness: f64) -> f64 {
    2.0 * config.half_width_at(nearness) + 1.0
}

/// Draws the sprites as far as they lie in `rows`.
pub fn draw(config: &Config, sprites: &[Sprite], brush: Brush<'_>, rows: &mut Rows<'_>) {
    let end = (rows.first + rows.size.height) as f64 - 1.0;
    for sprite in sprites {
        let reach = reach(config, sprite.nearness);
        let ([left, top], [right, bottom]) = (
            [sprite.at[0] - reach, sprite.at[1] - reach].map(f64::ceil),
            [sprite.at[0] + reach, sprite.at[1] + reach].map(f64::floor),
        );
        let (left, top) = (left.max(0.0), top.max(rows.first as f64));
        let (right, bottom) = (right.min(rows.size.width as f64 - 1.0), bottom.min(end));
        if right < left || bottom < top {
            continue;
        }
        let (scale, reach, opacity) = (1.0 / reach as f32, reach as f32, config.opacity as f32);
        for y in top as usize..=bottom as usize {
            let shade = &mut rows.shade[(y - rows.first) * rows.stride..];
            let dy = (y as f64 - sprite.at[1]) as f32;
            for (x, shade) in shade.iter_mut().enumerate().take(right as usize + 1).skip(left as usize) {
                let dx = (x as f64 - sprite.at[0]) as f32;
                let coverage = (reach - (dx * dx + dy * dy).sqrt()).clamp(0.0, 1.0);
                if coverage > 0.0 {
                    let print = brush.at((dx * scale + 1.0) * 0.5, (dy * scale + 1.0) * 0.5);
                    *shade *= 1.0 - opacity * coverage * print;
                }
            }
        }
    }
}
