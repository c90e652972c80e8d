//! A run of pixels in a row of a tile: the depth test, and what is kept of the nearest and second-nearest surface.

use super::edges::Slope;
use super::tile::{Channels, Slot};
use super::vertex::narrow;
use fearless_simd::{Simd, f64x4, prelude::*};

/// A value along a row.
#[derive(Clone, Copy)]
pub(super) struct Line<F> {
    pub start: f32,
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

    /// Where there is light and nothing else.
    #[inline(always)]
    pub fn draw_plain(&self, simd: S, light: Line<S::f32s>, slot: &mut Slot) {
        let before = self.load(simd, &slot.w);
        let wins = self.inside & self.here.simd_gt(before);
        if wins.any_true()
            && let Some(plane) = slot.attributes.first_mut()
        {
            self.store(wins.select(self.here, before), &mut slot.w);
            let new = S::f32s::simd_from(simd, light.start) + self.xs * light.right;
            self.store(wins.select(new, self.load(simd, plane)), plane);
        }
    }

    /// Where there are both layers and no more than light beside.
    #[inline(always)]
    pub fn draw_both(
        &self,
        simd: S,
        [origin, _, down]: &[f64x4<S>; 3],
        right: &[S::f32s; 4],
        face: f32,
        channels: Channels,
        slot: &mut Slot,
    ) {
        let (here, inside) = (self.here, self.inside);
        let (before, before2) = (self.load(simd, &slot.w), self.load(simd, &slot.w2));
        let wins = inside & here.simd_gt(before);
        // a fragment behind the first may be the second; a new first makes the old one second
        let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
        let any = wins.any_true();
        if !any && behind.all_false() {
            return;
        }
        let dy = f64x4::splat(simd, f64::from(self.y));
        let start = narrow(simd, *origin + *down * dy);
        self.store(wins.select(before, behind.select(here, before2)), &mut slot.w2);
        self.store(wins.select(here, before), &mut slot.w);
        let lit = channels.light;
        let (light, normals) = slot.attributes.split_at_mut(usize::from(lit));
        for ((k, first), second) in normals.iter_mut().enumerate().zip(&mut slot.normal2) {
            let new = S::f32s::simd_from(simd, start[k]) + self.xs * right[k];
            let (old, old2) = (self.load(simd, first), self.load(simd, second));
            self.store(wins.select(old, behind.select(new, old2)), second);
            self.store(wins.select(new, old), first);
        }
        if any && let Some(plane) = light.first_mut() {
            let new = if face >= 0.0 {
                S::f32s::simd_from(simd, face)
            } else {
                S::f32s::simd_from(simd, start[3]) + self.xs * right[3]
            };
            self.store(wins.select(new, self.load(simd, plane)), plane);
        }
    }

    #[inline(always)]
    fn value(&self, simd: S, slope: &Slope) -> S::f32s {
        let right = S::f32s::simd_from(simd, slope.right as f32);
        S::f32s::simd_from(simd, slope.at(f64::from(self.y))) + self.xs * right
    }

    /// Keeps what a phantom hides.
    #[inline(always)]
    pub fn hide(&self, simd: S, slot: &mut Slot) {
        let before = self.load(simd, &slot.shield);
        let nearer = self.inside & self.here.simd_gt(before);
        self.store(nearer.select(self.here, before), &mut slot.shield);
    }

    #[inline(always)]
    pub fn draw(
        &self,
        simd: S,
        surface: u32,
        channels: Channels,
        light: Line<S::f32s>,
        others: &[Slope],
        slot: &mut Slot,
    ) {
        let (here, mut inside) = (self.here, self.inside);
        if channels.phantoms {
            inside &= here.simd_gt(self.load(simd, &slot.shield));
        }
        let before = self.load(simd, &slot.w);
        let wins = inside & here.simd_gt(before);
        let any = wins.any_true();
        if channels.second {
            // a fragment behind the first may be the second; a new first makes the old one second
            let before2 = self.load(simd, &slot.w2);
            let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
            if !any && behind.all_false() {
                return;
            }
            self.store(wins.select(before, behind.select(here, before2)), &mut slot.w2);
            let firsts = slot.attributes.iter_mut().skip(channels.normal_at());
            for ((slope, first), second) in others.iter().zip(firsts).zip(&mut slot.normal2) {
                let (old, old2) = (self.load(simd, first), self.load(simd, second));
                let new = self.value(simd, slope);
                self.store(wins.select(old, behind.select(new, old2)), second);
                self.store(wins.select(new, old), first);
            }
        }
        if !any {
            return;
        }
        self.store(wins.select(here, before), &mut slot.w);
        let mut planes = slot.attributes.iter_mut();
        if channels.light
            && let Some(plane) = planes.next()
        {
            let new = S::f32s::simd_from(simd, light.start) + self.xs * light.right;
            self.store(wins.select(new, self.load(simd, plane)), plane);
        }
        // the second layer has seen to the normals
        let done = if channels.second { 3 } else { 0 };
        for (slope, plane) in others.iter().zip(planes).skip(done) {
            self.store(wins.select(self.value(simd, slope), self.load(simd, plane)), plane);
        }
        if channels.surfaces {
            let ids = &mut slot.surface[self.at..self.at + S::i32s::LEN];
            let own = S::i32s::simd_from(simd, surface as i32);
            wins.select(own, S::i32s::from_slice(simd, ids)).store_slice(ids);
        }
    }
}
