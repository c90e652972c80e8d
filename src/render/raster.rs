//! One tile: walk the records of all chunks in order. Small triangles are set up four at a time; of those in little
//! boxes the covered pixels are known, of all others what is covered in each row (`spans`). It is drawn a run of pixels
//! at a time.
//!
//! 1/z and attributes over z of the unsnapped corners are evaluated in f64 at the start of every row and stepped in
//! f32 along it. Where they are so steep that the steps would round badly the triangle is drawn in strips of eight
//! pixels, so that the error is that of seven steps however large it is. Nearest and second-nearest surface are kept
//! in the same pass. Runs are as wide as the machine's vectors: no value depends on where they begin.

use super::View;
use super::bins::{Chunk, Records};
use super::record::{Bounds, Extent, Record};
use super::run::{Line, Pixels, Run};
use super::setup::{ANY, BOTH, PLAIN, STRIP, Setup, Tile, Triangle};
use super::slopes::{Slope, Slopes, Weights};
use super::sort::LITTLE;
use super::spans;
use super::tile::{Channels, MOST, STRIDE, Slot};
use super::vertex::{Vertex, narrow};
use crate::pixels::TILE;
use crate::pixels::simd::{Level, dispatch};
use fearless_simd::{Simd, SimdFrom, prelude::*};

/// Draws everything that touches a tile; whether any pixel inside the picture is covered.
#[inline(never)]
pub(super) fn draw_tile(
    level: Level,
    view: &View<'_>,
    chunks: &[Chunk],
    tile: usize,
    slot: &mut Slot,
) -> bool {
    slot.clear(view.channels, view.nothing);
    let Channels { light, normals, uv, colors, surfaces, second, phantoms, flat: _ } = view.channels;
    let rect = view.shot.grid.rect(tile);
    let bounds = [rect.x0, rect.y0, rect.x1 - 1, rect.y1 - 1].map(|v| v as i32);
    let (pen, walk) = (Tile { view, bounds }, Walk::new(view, chunks, tile));
    match (second, normals || !light, uv || colors || surfaces || phantoms) {
        (false, false, false) => {
            dispatch!(level, simd => draw_records::<_, PLAIN>(simd, &pen, walk, slot))
        }
        (true, _, false) => dispatch!(level, simd => draw_records::<_, BOTH>(simd, &pen, walk, slot)),
        _ => dispatch!(level, simd => draw_records::<_, ANY>(simd, &pen, walk, slot)),
    }
    let mut rows = slot.w().chunks_exact(STRIDE).take(rect.y1 - rect.y0);
    let most = |row: &[f32]| row.iter().fold(0, |most, w| w.to_bits().max(most));
    rows.any(|row| most(&row[..rect.x1 - rect.x0]) > view.nothing.to_bits())
}

/// The triangles of a tile, those of all chunks in order.
struct Walk<'a> {
    view: &'a View<'a>,
    chunks: std::slice::Iter<'a, Chunk>,
    tile: usize,
    chunk: &'a Chunk,
    places: &'a [Vertex],
    records: Records<'a>,
}

impl<'a> Walk<'a> {
    fn new(view: &'a View<'a>, chunks: &'a [Chunk], tile: usize) -> Option<Self> {
        let mut chunks = chunks.iter();
        let chunk = chunks.find(|chunk| chunk.holds(tile))?;
        let mut walk = Self { view, chunks, tile, chunk, places: &[], records: chunk.records_of(tile) };
        walk.enter(chunk);
        Some(walk)
    }

    fn enter(&mut self, chunk: &'a Chunk) {
        self.chunk = chunk;
        self.places = &self.view.vertices.places[self.view.instances[chunk.instance].first_vertex..];
        self.records = chunk.records_of(self.tile);
    }

    #[inline(always)]
    fn next(&mut self) -> Option<&'a Record> {
        loop {
            if let Some(record) = self.records.next() {
                return Some(record);
            }
            let tile = self.tile;
            let chunk = self.chunks.find(|chunk| chunk.holds(tile))?;
            self.enter(chunk);
        }
    }
}

/// Draws small triangles four at a time, one after the other, and all others singly.
#[inline(always)]
fn draw_records<S: Simd, const MODE: u8>(simd: S, tile: &Tile<'_>, walk: Option<Walk<'_>>, slot: &mut Slot) {
    let Some(mut walk) = walk else { return };
    let (mut pixels, [setup, spare]) = Pixels::of::<MODE>(slot);
    let pixels = &mut pixels;
    let none = Triangle { record: &Record::NONE, chunk: walk.chunk, places: [&Vertex::NONE; 3] };
    let (mut four, mut count) = ([none; 4], 0);
    while let Some(record) = walk.next() {
        if record.extent == Extent::Small {
            let Some(triangle) = Triangle::new(walk.chunk, record, walk.places) else { continue };
            four[count % 4] = triangle;
            count += 1;
            if count < 4 {
                continue;
            }
        }
        draw_four::<S, MODE>(simd, tile, &four, count, [setup, spare], pixels);
        count = 0;
        if record.extent != Extent::Small {
            let own = record.extent == Extent::Piece;
            let places = if own { &walk.chunk.own.places } else { walk.places };
            let Some(triangle) = Triangle::new(walk.chunk, record, places) else { continue };
            draw_large::<S, MODE>(simd, tile, &triangle, setup, pixels);
        }
    }
    draw_four::<S, MODE>(simd, tile, &four, count, [setup, spare], pixels);
}

/// Draws the first `count` of four small triangles, one after the other.
#[inline(always)]
fn draw_four<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    four: &[Triangle<'_>; 4],
    count: usize,
    [setup, spare]: [&mut Setup; 2],
    pixels: &mut Pixels<'_>,
) {
    if count == 0 {
        return;
    }
    let [p, q, r, s] = four;
    let areas = [p.record.bounds, q.record.bounds, r.record.bounds, s.record.bounds];
    let known = |triangle: &Triangle<'_>| triangle.record.cover != 0;
    let spans = !(known(p) && known(q) && known(r) && known(s));
    setup.fill::<S, MODE>(simd, tile, four, &areas, spans);
    if setup.steep | setup.slivers != 0 {
        return draw_odd::<S, MODE>(simd, tile, &four[..count], setup, spare, pixels);
    }
    for (k, triangle) in four.iter().enumerate().take(count) {
        if triangle.record.cover != 0 {
            draw_little::<S, MODE>(simd, tile, triangle, setup, k, pixels);
        } else {
            draw_rows::<S, MODE, false>(simd, tile, triangle, setup, k, pixels);
        }
    }
}

/// Small triangles with steep ones or slivers among them.
#[inline(never)]
fn draw_odd<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    four: &[Triangle<'_>],
    setup: &Setup,
    spare: &mut Setup,
    pixels: &mut Pixels<'_>,
) {
    for (k, triangle) in four.iter().enumerate() {
        if setup.steep >> k & 1 == 1 {
            draw_steep::<S, MODE>(simd, tile, triangle, spare, pixels);
        } else {
            simd.vectorize(
                #[inline(always)]
                || match triangle.record.cover {
                    0 => draw_rows::<S, MODE, true>(simd, tile, triangle, setup, k, pixels),
                    _ if setup.slivers >> k & 1 == 1 => {
                        draw_sliver::<S, MODE>(simd, tile, triangle, spare, pixels)
                    }
                    _ => draw_little::<S, MODE>(simd, tile, triangle, setup, k, pixels),
                },
            );
        }
    }
}

/// Steep small triangles: four strips at a time.
#[inline(never)]
fn draw_steep<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    triangle: &Triangle<'_>,
    setup: &mut Setup,
    pixels: &mut Pixels<'_>,
) {
    let [left, top, right, bottom] = triangle.record.bounds.sides();
    for first in (left..=right).step_by(4 * STRIP as usize) {
        let mut areas = [Bounds::default(); 4];
        for (area, first) in areas.iter_mut().zip((first..).step_by(STRIP as usize)) {
            // one after the last is narrow and not drawn
            let first = first.min(right);
            *area = Bounds::new([first, top, right.min(first + STRIP - 1), bottom]);
        }
        let count = ((right - first) / STRIP + 1).min(4) as usize;
        simd.vectorize(
            #[inline(always)]
            || {
                setup.fill::<S, MODE>(simd, tile, &[*triangle; 4], &areas, true);
                for k in 0..count {
                    draw_rows::<S, MODE, true>(simd, tile, triangle, setup, k, pixels);
                }
            },
        );
    }
}

/// Large triangles and those made by cutting; steep ones in strips.
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
                setup.fill::<S, MODE>(simd, tile, &[*triangle; 4], &[area; 4], false);
                if setup.steep == 0 {
                    draw_rows::<S, MODE, true>(simd, tile, triangle, setup, 0, pixels);
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
        light: S::f32s,
        record: &Record,
        channels: Channels,
        pixels: &mut Pixels<'_>,
    ) {
        let light = Line { start: light, right: self.light_right };
        if MODE == PLAIN {
            run.draw_plain(simd, light, pixels);
        } else if MODE == BOTH {
            run.draw_both(simd, &self.four, &self.four_right, record.face, channels.light, pixels);
        } else if self.phantom {
            run.hide(simd, channels, pixels);
        } else {
            let others = &self.others[..channels.others()];
            run.draw(simd, record.surface, channels, light, others, pixels);
        }
    }
}

/// Lane numbers; no vector has more.
const LANES: [i32; STRIDE - TILE] = [0, 1, 2, 3, 4, 5, 6, 7];

/// The bits of a little box's first row, a lane each; lanes outside have bits that never are.
const COVER: [i32; STRIDE - TILE] = [1, 2, 4, 8, 1 << 30, 1 << 30, 1 << 30, 1 << 30];

/// A little sliver: by its rows, as any other.
#[inline(always)]
fn draw_sliver<S: Simd, const MODE: u8>(
    simd: S,
    tile: &Tile<'_>,
    triangle: &Triangle<'_>,
    setup: &mut Setup,
    pixels: &mut Pixels<'_>,
) {
    setup.fill::<S, MODE>(simd, tile, &[*triangle; 4], &[triangle.record.bounds; 4], true);
    draw_rows::<S, MODE, true>(simd, tile, triangle, setup, 0, pixels);
}

/// Draws a triangle whose covered pixels are known; no sliver.
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
    let ink = Ink::new::<MODE>(simd, tile, triangle, setup, k);
    let mut at = setup.at[k] as usize;
    for (y, row) in setup.rows.iter().enumerate() {
        let inside = (S::i32s::simd_from(simd, cover) & bits).simd_eq(bits);
        let here = S::f32s::simd_from(simd, row.w[k]) + w_across;
        let run = Run { at, inside, here, xs, y: y as i32 };
        let light = S::f32s::simd_from(simd, row.light[k]);
        ink.draw::<MODE>(simd, &run, light, triangle.record, tile.view.channels, pixels);
        (cover, at) = (cover >> LITTLE, at + STRIDE);
        if cover == 0 {
            break;
        }
    }
}

/// Draws what its rows know of a triangle; only one that may be `ODD` is a sliver.
#[inline(always)]
fn draw_rows<S: Simd, const MODE: u8, const ODD: bool>(
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
    let sliver = ODD && setup.slivers >> k & 1 == 1;
    let ink = Ink::new::<MODE>(simd, tile, triangle, setup, k);
    for (y, row) in setup.rows[..(setup.heights[k] as usize).min(TILE)].iter().enumerate() {
        let mut left = row.count[k];
        if left == 0 {
            continue;
        }
        let mut at = row.at[k] as usize;
        let mut xs = first_xs + S::f32s::simd_from(simd, row.first[k]);
        let w = S::f32s::simd_from(simd, row.w[k]);
        let light = S::f32s::simd_from(simd, row.light[k]);
        loop {
            let inside = S::i32s::simd_from(simd, left).simd_gt(lanes);
            let mut here = w + xs * w_right;
            if sliver {
                here = triangle.kept_near(simd, here);
            }
            let run = Run { at, inside, here, xs, y: y as i32 };
            ink.draw::<MODE>(simd, &run, light, triangle.record, tile.view.channels, pixels);
            if left <= length {
                break;
            }
            left -= length;
            at += length as usize;
            xs += S::f32s::simd_from(simd, length as f32);
        }
    }
}
