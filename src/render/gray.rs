//! The common case of shading, one smooth surface without color: sixteen pixels at a time, straight into the planes.

use super::shade::{Palette, RUN, load, to_level, unit_range};
use crate::pixels::TILE;
use fearless_simd::{Simd, SimdBase, f32x8, i32x8, mask32x8, prelude::*};

/// The common case, one smooth surface without color: its ambient share and gray.
#[derive(Clone, Copy)]
pub(super) struct Gray {
    ambient: f32,
    gray: f32,
    /// 1/z that stands for no surface.
    nothing: f32,
}

/// Pixels whose levels are one vector of bytes.
const WIDE: usize = 16;

impl Palette<'_> {
    /// The common case, where it is one.
    pub fn gray(&self) -> Option<Gray> {
        let ([surface], false) = (self.surfaces, self.channels.surfaces) else { return None };
        Some(Gray { ambient: surface.ambient, gray: surface.gray()?, nothing: self.nothing })
    }
}

impl Gray {
    /// A row of a tile, of any length: depth and colors.
    #[inline(always)]
    pub fn shade_part<S: Simd>(
        &self,
        simd: S,
        from: [&[f32; TILE]; 2],
        depth: &mut [f32],
        [r, g, b]: [&mut [u8]; 3],
    ) {
        let (mut z, [mut red, mut green, mut blue]) = ([0.0; TILE], [[0; TILE]; 3]);
        self.shade_row(simd, from, &mut z, [&mut red, &mut green, &mut blue]);
        depth.copy_from_slice(&z[..depth.len()]);
        for (out, levels) in [r, g, b].into_iter().zip([red, green, blue]) {
            out.copy_from_slice(&levels[..out.len()]);
        }
    }

    /// What `shade_row` does, of a whole row of a tile: from 1/z and light to depth and colors.
    #[inline(always)]
    pub fn shade_row<S: Simd>(
        &self,
        simd: S,
        [w, light]: [&[f32; TILE]; 2],
        depth: &mut [f32; TILE],
        [r, g, b]: [&mut [u8; TILE]; 3],
    ) {
        let from = w.as_chunks().0.iter().zip(light.as_chunks().0);
        let colors = r.as_chunks_mut().0.iter_mut().zip(g.as_chunks_mut().0).zip(b.as_chunks_mut().0);
        for ((from, z), ((r, g), b)) in from.zip(depth.as_chunks_mut().0).zip(colors) {
            self.shade(simd, from, z, [r, g, b]);
        }
    }

    #[inline(always)]
    fn shade<S: Simd>(
        &self,
        simd: S,
        (w, light): (&[f32; WIDE], &[f32; WIDE]),
        depth: &mut [f32; WIDE],
        [r, g, b]: [&mut [u8; WIDE]; 3],
    ) {
        let nothing = f32x8::splat(simd, self.nothing);
        let (w0, w1) = (load(simd, w, 0), load(simd, w, RUN));
        let (covered0, covered1) = (w0.simd_gt(nothing), w1.simd_gt(nothing));
        if (covered0 | covered1).all_false() {
            (*depth, *r, *g, *b) = ([f32::INFINITY; WIDE], [0; WIDE], [0; WIDE], [0; WIDE]);
            return;
        }
        let (one, infinite) = (f32x8::splat(simd, 1.0), f32x8::splat(simd, f32::INFINITY));
        let (z0, z1) = (one / w0, one / w1);
        covered0.select(z0, infinite).store_slice(&mut depth[..RUN]);
        covered1.select(z1, infinite).store_slice(&mut depth[RUN..]);
        let level0 = self.level(simd, load(simd, light, 0) * z0, covered0);
        let level1 = self.level(simd, load(simd, light, RUN) * z1, covered1);
        let ((p, q), (s, t)) = (simd.split_i32x8(level0), simd.split_i32x8(level1));
        let (low, high) = (simd.relaxed_narrow_i32x4(p, q), simd.relaxed_narrow_i32x4(s, t));
        let levels = simd.relaxed_narrow_u16x8(low.bitcast(), high.bitcast());
        levels.store_slice(r);
        levels.store_slice(g);
        levels.store_slice(b);
    }

    #[inline(always)]
    fn level<S: Simd>(&self, simd: S, light: f32x8<S>, covered: mask32x8<S>) -> i32x8<S> {
        let light = f32x8::splat(simd, self.ambient)
            + f32x8::splat(simd, 1.0 - self.ambient) * unit_range(simd, light);
        covered.select(to_level(simd, light, self.gray), i32x8::splat(simd, 0))
    }
}
