//! A run of pixels in a row of a tile: the depth test, and what is kept of the nearest and second-nearest surface.

use super::setup::{BOTH, PLAIN, Setup};
use super::slopes::{Slope, Slopes};
use super::tile::{Channels, Slot, Values};
use fearless_simd::{Simd, prelude::*};

/// The pixels of a slot, as the case at hand needs them.
pub(super) struct Pixels<'a> {
    /// 1/z and intensity, where there is nothing else.
    plain: Option<(&'a mut Values, &'a mut Values)>,
    /// Both layers, where there is no more than light beside.
    both: Option<(&'a mut [Values; 4], &'a mut [Values; 5])>,
    /// Otherwise.
    near: &'a mut [Values],
    others: &'a mut [Values],
    surface: &'a mut [i32],
}

impl<'a> Pixels<'a> {
    /// And where triangles are set up.
    #[inline(always)]
    pub fn of<const MODE: u8>(slot: &'a mut Slot) -> (Self, &'a mut [Setup; 2]) {
        let (near, others) = (&mut slot.near[..], &mut slot.others[..]);
        let mut pixels =
            Self { plain: None, both: None, near: &mut [], others: &mut [], surface: &mut slot.surface };
        match MODE {
            PLAIN => pixels.plain = near.first_mut().zip(others.first_mut()),
            BOTH => pixels.both = near.first_chunk_mut().zip(others.first_chunk_mut()),
            _ => (pixels.near, pixels.others) = (near, others),
        }
        (pixels, &mut slot.setups)
    }

    /// The same for a while: in a place of its own, of which a loop keeps in registers what it needs.
    #[inline(always)]
    pub fn again(&mut self) -> Pixels<'_> {
        Pixels {
            plain: self.plain.as_mut().map(|(w, light)| (&mut **w, &mut **light)),
            both: self.both.as_mut().map(|(near, others)| (&mut **near, &mut **others)),
            near: self.near,
            others: self.others,
            surface: self.surface,
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
    fn load(&self, simd: S, plane: &Values) -> S::f32s {
        S::f32s::from_slice(simd, &plane[self.at..self.at + S::f32s::LEN])
    }

    #[inline(always)]
    fn store(&self, value: S::f32s, plane: &mut Values) {
        value.store_slice(&mut plane[self.at..self.at + S::f32s::LEN]);
    }

    /// Stores the value where it wins.
    #[inline(always)]
    fn keep(&self, simd: S, wins: S::mask32s, value: S::f32s, plane: &mut Values) {
        self.store(wins.select(value, self.load(simd, plane)), plane);
    }

    /// Where there is light and nothing else.
    #[inline(always)]
    pub fn draw_plain(&self, simd: S, light: Line<S::f32s>, pixels: &mut Pixels<'_>) {
        let Some((ws, lights)) = pixels.plain.as_mut() else { return };
        let (before, old) = (self.load(simd, ws), self.load(simd, lights));
        // 1/z is never below 0
        let here = self.inside.select(self.here, S::f32s::simd_from(simd, 0.0));
        let wins = here.simd_gt(before);
        let new = light.start + self.xs * light.right;
        self.store(before.max(here), ws);
        self.store(wins.select(new, old), lights);
    }

    /// Where there are both layers and no more than light beside; `lit` is whether that is kept.
    #[inline(always)]
    pub fn draw_both(
        &self,
        simd: S,
        slopes: &Slopes<S>,
        right: &[S::f32s; 4],
        face: f32,
        lit: bool,
        pixels: &mut Pixels<'_>,
    ) {
        let Some(([ws, first @ ..], [lights, w2s, second @ ..])) = pixels.both.as_mut() else { return };
        let (here, inside) = (self.here, self.inside);
        let (before, before2) = (self.load(simd, ws), self.load(simd, w2s));
        let wins = inside & here.simd_gt(before);
        // a fragment behind the first may be the second; a new first makes the old one second
        let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
        if (wins | behind).all_false() {
            return;
        }
        let start = slopes.at(simd, f64::from(self.y));
        let old_light = self.load(simd, lights);
        self.store(wins.select(before, behind.select(here, before2)), w2s);
        self.store(wins.select(here, before), ws);
        for (k, (first, second)) in first.iter_mut().zip(second).enumerate() {
            let new = S::f32s::simd_from(simd, start[k]) + self.xs * right[k];
            let (old, old2) = (self.load(simd, first), self.load(simd, second));
            self.store(wins.select(old, behind.select(new, old2)), second);
            self.store(wins.select(new, old), first);
        }
        if lit {
            let new = if face >= 0.0 {
                S::f32s::simd_from(simd, face)
            } else {
                S::f32s::simd_from(simd, start[3]) + self.xs * right[3]
            };
            self.store(wins.select(new, old_light), lights);
        }
    }

    #[inline(always)]
    fn value(&self, simd: S, slope: &Slope) -> S::f32s {
        let right = S::f32s::simd_from(simd, slope.right as f32);
        S::f32s::simd_from(simd, slope.at(f64::from(self.y))) + self.xs * right
    }

    /// Keeps what a phantom hides.
    #[inline(always)]
    pub fn hide(&self, simd: S, channels: Channels, pixels: &mut Pixels<'_>) {
        let Some(shield) = pixels.others.get_mut(channels.shield_at()) else { return };
        let before = self.load(simd, shield);
        let nearer = self.inside & self.here.simd_gt(before);
        self.store(nearer.select(self.here, before), shield);
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
        let (near, rest) = (&mut *pixels.near, &mut *pixels.others);
        if channels.phantoms {
            inside &= here.simd_gt(self.load(simd, &rest[channels.shield_at()]));
        }
        let before = self.load(simd, &near[0]);
        let wins = inside & here.simd_gt(before);
        let any = wins.any_true();
        if channels.second {
            // a fragment behind the first may be the second; a new first makes the old one second
            let seconds = &mut rest[channels.second_at()..];
            let before2 = self.load(simd, &seconds[0]);
            let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
            if !any && behind.all_false() {
                return;
            }
            self.store(wins.select(before, behind.select(here, before2)), &mut seconds[0]);
            for ((slope, first), second) in others.iter().zip(&near[1..]).zip(&mut seconds[1..]) {
                let (old, old2) = (self.load(simd, first), self.load(simd, second));
                let new = self.value(simd, slope);
                self.store(wins.select(old, behind.select(new, old2)), second);
            }
        }
        if !any {
            return;
        }
        self.store(wins.select(here, before), &mut near[0]);
        if channels.light {
            let new = light.start + self.xs * light.right;
            self.keep(simd, wins, new, &mut rest[0]);
        }
        let (normals, others) = others.split_at(if channels.normals { 3 } else { 0 });
        for (slope, plane) in normals.iter().zip(&mut near[1..]) {
            self.keep(simd, wins, self.value(simd, slope), plane);
        }
        for (slope, plane) in others.iter().zip(&mut rest[channels.uv_at()..]) {
            self.keep(simd, wins, self.value(simd, slope), plane);
        }
        if channels.surfaces {
            let ids = &mut pixels.surface[self.at..self.at + S::i32s::LEN];
            let own = S::i32s::simd_from(simd, surface as i32);
            wins.select(own, S::i32s::from_slice(simd, ids)).store_slice(ids);
        }
    }
}
