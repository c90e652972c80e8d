//! One tile: walk the records of all chunks in order, a run of pixels at a time. Small triangles are set up four at a
//! time; of those in little boxes the covered pixels are known, all others walk their rows.
//!
//! Coverage is exact: integer edge functions of the snapped corners, the fill rule folded into the constant.
//! 1/z and attributes over z of the unsnapped corners are evaluated in f64 at the start of every row and stepped in
//! f32 along it. Where they are so steep that the steps would round badly the triangle is drawn in strips of eight
//! pixels, so that the error is that of seven steps however large it is. Nearest and second-nearest surface are kept
//! in the same pass. Runs are as wide as the machine's vectors: no value depends on where they begin.

use super::View;
use super::bins::Chunk;
use super::record::{Bounds, Extent, Record};
use super::run::{Line, Pixels, Run};
use super::setup::{ANY, BOTH, PLAIN, STRIP, Setup, Triangle};
use super::slopes::{Slope, Slopes, Weights};
use super::sort::LITTLE;
use super::spans;
use super::tile::{Channels, MOST, STRIDE, Slot};
use super::vertex::{Vertex, narrow};
use crate::pixels::TILE;
use crate::pixels::simd::{Level, dispatch};
use fearless_simd::{Simd, SimdFrom, prelude::*};

/// Draws everything that touches a tile; whether any pixel inside the picture is covered.
pub(super) fn draw_tile(
    level: Level,
    view: &View<'_>,
    chunks: &[Chunk],
    tile: usize,
    slot: &mut Slot,
) -> bool {
    slot.clear(view.channels, view.nothing);
    let Channels { light, normals, uv, colors, surfaces, second, phantoms } = view.channels;
    let Some(pixels) = &mut Pixels::of(slot, view.channels) else { return false };
    match (second, normals || !light, uv || colors || surfaces || phantoms) {
        (false, false, false) => draw_records::<PLAIN>(level, view, chunks, tile, pixels),
        (true, _, false) => draw_records::<BOTH>(level, view, chunks, tile, pixels),
        _ => draw_records::<ANY>(level, view, chunks, tile, pixels),
    }
    let rect = view.shot.grid.rect(tile);
    let mut rows = slot.w.chunks_exact(STRIDE).take(rect.y1 - rect.y0);
    let most = |row: &[f32]| row.iter().fold(0, |most, w| w.to_bits().max(most));
    rows.any(|row| most(&row[..rect.x1 - rect.x0]) > view.nothing.to_bits())
}

/// The tile at hand.
struct Tile<'a> {
    view: &'a View<'a>,
    /// Its pixels: left, top, right, bottom, inclusive.
    bounds: [i32; 4],
}

fn draw_records<const MODE: u8>(
    level: Level,
    view: &View<'_>,
    chunks: &[Chunk],
    tile: usize,
    pixels: &mut Pixels<'_>,
) {
    let rect = view.shot.grid.rect(tile);
    let pen = Tile { view, bounds: [rect.x0, rect.y0, rect.x1 - 1, rect.y1 - 1].map(|v| v as i32) };
    let (nobody, nowhere) = (Chunk::default(), Vertex::default());
    let blank = Triangle { record: &Record::NONE, chunk: &nobody, places: [&nowhere; 3] };
    let (mut four, mut count) = ([blank; 4], 0);
    let mut setup = Setup::default();
    let mut draw = |four: &[Triangle<'_>; 4], count| {
        dispatch!(level, simd => draw_four::<_, MODE>(simd, &pen, four, count, &mut setup, pixels));
    };
    for chunk in chunks {
        if !chunk.holds(tile) {
            continue;
        }
        let places = &view.vertices.places[view.instances[chunk.instance].first_vertex..];
        for record in chunk.records_of(tile) {
            let alone = record.extent != Extent::Small;
            let places = if record.extent == Extent::Piece { &chunk.own.places } else { places };
            let Some(triangle) = Triangle::new(chunk, record, places) else { continue };
            if alone && count > 0 {
                draw(&four, count);
                count = 0;
            }
            let waiting = &mut four[count % 4];
            (waiting.record, waiting.chunk, waiting.places) = (triangle.record, chunk, triangle.places);
            count += 1;
            if alone || count == four.len() {
                draw(&four, count);
                count = 0;
            }
        }
    }
    if count > 0 {
        draw(&four, count);
    }
}

/// Draws the first `count` of four small triangles, one after the other; or a single one that is not small.
#[inline(always)]
fn draw_four<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    four: &[Triangle<'_>; 4],
    count: usize,
    setup: &mut Setup,
    pixels: &mut Pixels<'_>,
) {
    let [p, q, r, s] = four;
    if p.record.extent != Extent::Small {
        return draw_large::<S, MODE>(simd, tile, p, setup, pixels);
    }
    let areas = [p.record.bounds, q.record.bounds, r.record.bounds, s.record.bounds];
    let known = |triangle: &Triangle<'_>| triangle.record.cover != 0;
    let spans = !(known(p) && known(q) && known(r) && known(s));
    let [left, top, ..] = tile.bounds;
    setup.fill::<S, MODE>(simd, [left, top], four, areas, spans);
    for (k, triangle) in four.iter().enumerate().take(count) {
        if setup.steep >> k & 1 == 1 {
            draw_large::<S, MODE>(simd, tile, triangle, &mut Setup::default(), pixels);
        } else if triangle.record.cover != 0 {
            draw_little::<S, MODE>(simd, tile, triangle, setup, k, pixels);
        } else {
            draw_rows::<S, MODE>(simd, tile, triangle, setup, k, pixels);
        }
    }
}

/// Large triangles, those made by cutting and steep ones.
#[inline(never)]
fn draw_large<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    triangle: &Triangle<'_>,
    setup: &mut Setup,
    pixels: &mut Pixels<'_>,
) {
    let ([x0, y0, x1, y1], [left, top, right, bottom]) = (triangle.record.bounds.sides(), tile.bounds);
    let (first, above, last, below) = (x0.max(left), y0.max(top), x1.min(right), y1.min(bottom));
    if first > last || above > below {
        return;
    }
    let spots = triangle.spots(tile.view);
    let mut draw = |first: i32, last: i32| {
        let at = (above - top) * STRIDE as i32 + first - left;
        let area = Bounds::new([first, above, last, below]);
        if !spans::fill_one(at, area, spots, &mut setup.rows) {
            return true;
        }
        simd.vectorize(
            #[inline(always)]
            || {
                setup.fill::<S, MODE>(simd, [left, top], &[*triangle; 4], [area; 4], false);
                if setup.steep == 0 {
                    draw_rows::<S, MODE>(simd, tile, triangle, setup, 0, pixels);
                }
                setup.steep == 0
            },
        )
    };
    if draw(first, last) {
        return;
    }
    for first in (first..=last).step_by(STRIP as usize) {
        draw(first, last.min(first + STRIP - 1));
    }
}

/// What a triangle's runs are drawn with.
struct Ink<S: Simd> {
    light_right: S::f32s,
    /// Normal and intensity.
    four: Slopes<S>,
    four_right: [S::f32s; 4],
    others: [Slope; MOST - 1],
    phantom: bool,
}

impl<S: Simd> Ink<S> {
    #[inline(always)]
    fn new<const MODE: u8>(
        simd: S,
        tile: &Tile<'_>,
        triangle: &Triangle<'_>,
        setup: &Setup,
        k: usize,
    ) -> Self {
        let zero = S::f32s::simd_from(simd, 0.0);
        let mut ink = Self {
            light_right: S::f32s::simd_from(simd, setup.light_right[k % 4]),
            four: Slopes::zero(simd),
            four_right: [zero, zero, zero, zero],
            others: [Slope::default(); MOST - 1],
            phantom: false,
        };
        if MODE == PLAIN {
            return ink;
        }
        let [l1, l2] = &setup.weights;
        let weights = Weights([l1.all(simd, k), l2.all(simd, k)]);
        if MODE == BOTH {
            ink.four = triangle.four(simd, tile.view, &weights);
            let right = narrow(simd, ink.four.right);
            for i in 0..4 {
                ink.four_right[i] = S::f32s::simd_from(simd, right[i]);
            }
        } else {
            ink.others = triangle.others(simd, tile.view, &weights);
            let placed = &tile.view.instances[triangle.chunk.instance].placed;
            ink.phantom = tile.view.shot.scene.models[placed.model].phantom;
        }
        ink
    }

    /// Draws a run of the triangle; `light` is that of the row's first pixel.
    #[inline(always)]
    fn draw<const MODE: u8>(
        &self,
        simd: S,
        run: &Run<S>,
        light: f32,
        record: &Record,
        channels: Channels,
        pixels: &mut Pixels<'_>,
    ) {
        let light = Line { start: light, right: self.light_right };
        if MODE == PLAIN {
            run.draw_plain(simd, light, pixels);
        } else if MODE == BOTH {
            run.draw_both(simd, &self.four, &self.four_right, record.face, pixels);
        } else if self.phantom {
            run.hide(simd, pixels);
        } else {
            let others = &self.others[..channels.count() - usize::from(channels.light)];
            run.draw(simd, record.surface, channels, light, others, pixels);
        }
    }
}

/// Lane numbers; no vector has more.
const LANES: [i32; STRIDE - TILE] = [0, 1, 2, 3, 4, 5, 6, 7];

/// The bits of a little box's first row, a lane each; lanes outside have bits that never are.
const COVER: [i32; STRIDE - TILE] = [1, 2, 4, 8, 1 << 30, 1 << 30, 1 << 30, 1 << 30];

/// Draws a triangle whose covered pixels are known.
#[inline(always)]
fn draw_little<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    triangle: &Triangle<'_>,
    setup: &Setup,
    k: usize,
    pixels: &mut Pixels<'_>,
) {
    let (k, pixels) = (k % 4, &mut pixels.again());
    let mut cover = i32::from(triangle.record.cover);
    let bits = S::i32s::from_slice(simd, &COVER[..S::i32s::LEN]);
    let xs: S::f32s = S::i32s::from_slice(simd, &LANES[..S::i32s::LEN]).to_float();
    let w_across = xs * S::f32s::simd_from(simd, setup.w_right[k]);
    let sliver = setup.slivers >> k & 1 == 1;
    let ink = Ink::new::<MODE>(simd, tile, triangle, setup, k);
    let mut at = setup.at[k] as usize;
    for (y, row) in setup.rows.iter().enumerate() {
        let inside = (S::i32s::simd_from(simd, cover) & bits).simd_eq(bits);
        let mut here = S::f32s::simd_from(simd, row.w[k]) + w_across;
        if sliver {
            here = triangle.kept_near(simd, here);
        }
        let run = Run { at, inside, here, xs, y: y as i32 };
        ink.draw::<MODE>(simd, &run, row.light[k], triangle.record, tile.view.channels, pixels);
        (cover, at) = (cover >> LITTLE, at + STRIDE);
        if cover == 0 {
            break;
        }
    }
}

/// Draws what its rows know of a triangle.
#[inline(always)]
fn draw_rows<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    triangle: &Triangle<'_>,
    setup: &Setup,
    k: usize,
    pixels: &mut Pixels<'_>,
) {
    let (k, pixels) = (k % 4, &mut pixels.again());
    let length = S::f32s::LEN as i32;
    let lanes = S::i32s::from_slice(simd, &LANES[..S::i32s::LEN]);
    let first_xs: S::f32s = lanes.to_float();
    let w_right = S::f32s::simd_from(simd, setup.w_right[k]);
    let sliver = setup.slivers >> k & 1 == 1;
    let ink = Ink::new::<MODE>(simd, tile, triangle, setup, k);
    for (y, row) in setup.rows[..(setup.heights[k] as usize).min(TILE)].iter().enumerate() {
        let mut left = row.count[k];
        if left == 0 {
            continue;
        }
        let mut at = row.at[k] as usize;
        let mut xs = first_xs + S::f32s::simd_from(simd, row.first[k]);
        let w = S::f32s::simd_from(simd, row.w[k]);
        loop {
            let inside = S::i32s::simd_from(simd, left).simd_gt(lanes);
            let mut here = w + xs * w_right;
            if sliver {
                here = triangle.kept_near(simd, here);
            }
            let run = Run { at, inside, here, xs, y: y as i32 };
            ink.draw::<MODE>(simd, &run, row.light[k], triangle.record, tile.view.channels, pixels);
            left -= length;
            if left <= 0 {
                break;
            }
            at += length as usize;
            xs += S::f32s::simd_from(simd, length as f32);
        }
    }
}
