//! A run of pixels in a row of a tile: the depth test, and what is kept of the nearest and second-nearest surface.

use super::setup::Setup;
use super::slopes::{Slope, Slopes};
use super::tile::{Channels, ROOM, Slot};
use fearless_simd::{Simd, prelude::*};

/// The pixels of a slot, plane by plane; those that the frame does not keep are empty.
pub(super) struct Pixels<'a> {
    w: &'a mut [f32; ROOM],
    light: Option<&'a mut [f32; ROOM]>,
    normal: [&'a mut [f32]; 3],
    /// Texture coordinates and vertex color.
    others: &'a mut [Vec<f32>],
    surface: &'a mut [i32],
    w2: &'a mut [f32],
    normal2: [&'a mut [f32]; 3],
    shield: &'a mut [f32],
}

impl<'a> Pixels<'a> {
    /// And where triangles are set up; `None` when the slot has no room.
    pub fn of(slot: &'a mut Slot, channels: Channels) -> Option<(Self, &'a mut [Setup; 2])> {
        let (light, more) = slot.attributes.split_at_mut(channels.normal_at());
        let (normal, others) = more.split_at_mut(channels.uv_at() - channels.normal_at());
        let mut normal = normal.iter_mut();
        let mut next = || normal.next().map(Vec::as_mut_slice).unwrap_or_default();
        let pixels = Self {
            w: slot.w.first_chunk_mut()?,
            light: light.first_mut().and_then(|plane| plane.first_chunk_mut()),
            normal: [next(), next(), next()],
            others,
            surface: &mut slot.surface,
            w2: &mut slot.w2,
            normal2: slot.normal2.each_mut().map(Vec::as_mut_slice),
            shield: &mut slot.shield,
        };
        Some((pixels, &mut slot.setups))
    }
}

impl Pixels<'_> {
    /// Whether light is kept.
    #[inline(always)]
    pub fn has_light(&self) -> bool {
        self.light.is_some()
    }

    /// The same for a while: in a place of its own, of which a loop keeps in registers what it needs.
    #[inline(always)]
    pub fn again(&mut self) -> Pixels<'_> {
        let ([a, b, c], [d, e, f]) = (&mut self.normal, &mut self.normal2);
        Pixels {
            w: self.w,
            light: self.light.as_deref_mut(),
            normal: [a, b, c],
            others: self.others,
            surface: self.surface,
            w2: self.w2,
            normal2: [d, e, f],
            shield: self.shield,
        }
    }
}

/// A value along a row.
#[derive(Clone, Copy)]
pub(super) struct Line<F> {
    pub start: F,
    pub right: F,
}

/// Neighboring pixels of a row.
pub(super) struct Run<S: Simd> {
    /// The first one in the slot.
    pub at: usize,
    pub inside: S::mask32s,
    /// The triangle's 1/z.
    pub here: S::f32s,
    /// Pixels right of the area's first, and below it.
    pub xs: S::f32s,
    pub y: i32,
}

impl<S: Simd> Run<S> {
    #[inline(always)]
    fn load(&self, simd: S, plane: &[f32]) -> S::f32s {
        S::f32s::from_slice(simd, &plane[self.at..self.at + S::f32s::LEN])
    }

    #[inline(always)]
    fn store(&self, value: S::f32s, plane: &mut [f32]) {
        value.store_slice(&mut plane[self.at..self.at + S::f32s::LEN]);
    }

    /// Stores the value where it wins.
    #[inline(always)]
    fn keep(&self, simd: S, wins: S::mask32s, value: S::f32s, plane: &mut [f32]) {
        self.store(wins.select(value, self.load(simd, plane)), plane);
    }

    /// Where there is light and nothing else.
    #[inline(always)]
    pub fn draw_plain(&self, simd: S, light: Line<S::f32s>, pixels: &mut Pixels<'_>) {
        let Some(lights) = pixels.light.as_mut() else { return };
        let (before, old) = (self.load(simd, &*pixels.w), self.load(simd, &**lights));
        // 1/z is never below 0. Compilers make masked stores of a plane that is read, selected from and written: slow
        // where the next triangle reads it
        let here = self.inside.select(self.here, S::f32s::simd_from(simd, 0.0));
        let wins = here.simd_gt(before);
        let new = light.start + self.xs * light.right;
        self.store(before.max(here), pixels.w);
        self.store(wins.select(new, old), &mut **lights);
    }

    /// Where there are both layers and no more than light beside.
    #[inline(always)]
    pub fn draw_both(
        &self,
        simd: S,
        slopes: &Slopes<S>,
        right: &[S::f32s; 4],
        face: f32,
        pixels: &mut Pixels<'_>,
    ) {
        let (here, inside) = (self.here, self.inside);
        let (before, before2) = (self.load(simd, &*pixels.w), self.load(simd, pixels.w2));
        let wins = inside & here.simd_gt(before);
        // a fragment behind the first may be the second; a new first makes the old one second
        let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
        if (wins | behind).all_false() {
            return;
        }
        let start = slopes.at(simd, f64::from(self.y));
        let light = pixels.light.as_mut();
        let old_light = light.as_ref().map_or(here, |light| self.load(simd, &***light));
        self.store(wins.select(before, behind.select(here, before2)), pixels.w2);
        self.store(wins.select(here, before), pixels.w);
        for k in 0..3 {
            let (first, second) = (&mut *pixels.normal[k], &mut *pixels.normal2[k]);
            let new = S::f32s::simd_from(simd, start[k]) + self.xs * right[k];
            let (old, old2) = (self.load(simd, first), self.load(simd, second));
            self.store(wins.select(old, behind.select(new, old2)), second);
            self.store(wins.select(new, old), first);
        }
        if let Some(light) = light {
            let new = if face >= 0.0 {
                S::f32s::simd_from(simd, face)
            } else {
                S::f32s::simd_from(simd, start[3]) + self.xs * right[3]
            };
            self.store(wins.select(new, old_light), &mut **light);
        }
    }

    #[inline(always)]
    fn value(&self, simd: S, slope: &Slope) -> S::f32s {
        let right = S::f32s::simd_from(simd, slope.right as f32);
        S::f32s::simd_from(simd, slope.at(f64::from(self.y))) + self.xs * right
    }

    /// Keeps what a phantom hides.
    #[inline(always)]
    pub fn hide(&self, simd: S, pixels: &mut Pixels<'_>) {
        let before = self.load(simd, pixels.shield);
        let nearer = self.inside & self.here.simd_gt(before);
        self.store(nearer.select(self.here, before), pixels.shield);
    }

    #[inline(always)]
    pub fn draw(
        &self,
        simd: S,
        surface: u32,
        channels: Channels,
        light: Line<S::f32s>,
        others: &[Slope],
        pixels: &mut Pixels<'_>,
    ) {
        let (here, mut inside) = (self.here, self.inside);
        if channels.phantoms {
            inside &= here.simd_gt(self.load(simd, pixels.shield));
        }
        let before = self.load(simd, &*pixels.w);
        let wins = inside & here.simd_gt(before);
        let any = wins.any_true();
        if channels.second {
            // a fragment behind the first may be the second; a new first makes the old one second
            let before2 = self.load(simd, pixels.w2);
            let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
            if !any && behind.all_false() {
                return;
            }
            self.store(wins.select(before, behind.select(here, before2)), pixels.w2);
            for ((slope, first), second) in others.iter().zip(&pixels.normal).zip(&mut pixels.normal2) {
                let (old, old2) = (self.load(simd, first), self.load(simd, second));
                let new = self.value(simd, slope);
                self.store(wins.select(old, behind.select(new, old2)), second);
            }
        }
        if !any {
            return;
        }
        self.store(wins.select(here, before), pixels.w);
        if let Some(plane) = pixels.light.as_mut() {
            let new = light.start + self.xs * light.right;
            self.keep(simd, wins, new, &mut **plane);
        }
        let (normals, others) = others.split_at(if channels.normals { 3 } else { 0 });
        for (slope, plane) in normals.iter().zip(&mut pixels.normal) {
            self.keep(simd, wins, self.value(simd, slope), plane);
        }
        for (slope, plane) in others.iter().zip(&mut *pixels.others) {
            self.keep(simd, wins, self.value(simd, slope), plane);
        }
        if channels.surfaces {
            let ids = &mut pixels.surface[self.at..self.at + S::i32s::LEN];
            let own = S::i32s::simd_from(simd, surface as i32);
            wins.select(own, S::i32s::from_slice(simd, ids)).store_slice(ids);
        }
    }
}
