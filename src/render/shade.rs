//! From a pixel's attributes to 8-bit color (contracts: `draw`): once a pixel, of the nearest surface alone.

use super::tile::{Channels, STRIDE, Slot};
use crate::pixels::{Rgb, TILE};
use crate::scene::{Light, Model, Scene, Shading, Wrap};
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x8, i32x8, prelude::*};
use glam::Vec3;

/// How intensity is found on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Smooth,
    Flat,
    Toon,
    ThreeSteps,
    /// Light has no part in it.
    Unlit,
    /// It hides what is behind it, and nothing more.
    Phantom,
}

/// One material of one placed model, ready for shading.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub kind: Kind,
    /// Index of its model in the scene.
    pub model: usize,
    /// Base color times 255.
    color: [f32; 3],
    /// Share of light that reaches every surface.
    pub(super) ambient: f32,
    /// The toon ramp.
    ramp: [f32; 32],
    /// Where its texture is, model and material, and how it goes on past its edges.
    texture: Option<(usize, usize)>,
    wrap: [Wrap; 2],
    /// Whether vertices have colors.
    colored: bool,
}

impl Surface {
    /// One surface a material, and a last one, white, for triangles without a material.
    pub fn push_all(
        index: usize,
        model: &Model,
        shading: Shading,
        light: &Light,
        surfaces: &mut Vec<Surface>,
    ) {
        let (lit, ramp) = match shading {
            Shading::Smooth => (Kind::Smooth, [0.0; 32]),
            Shading::Flat => (Kind::Flat, [0.0; 32]),
            Shading::Toon { steps, base } => (Kind::Toon, ramp(steps, base)),
            Shading::ThreeSteps => (Kind::ThreeSteps, [0.0; 32]),
        };
        let share = |v: f32| if v >= 0.0 { v.min(1.0) } else { 0.0 };
        let surface = |color: Vec3, texture, wrap, unlit| {
            let kind = match (model.phantom, unlit) {
                (true, _) => Kind::Phantom,
                (false, true) => Kind::Unlit,
                (false, false) => lit,
            };
            let color = (color * light.tint).to_array().map(|v| share(v) * 255.0);
            let ambient = if kind == Kind::ThreeSteps { 0.0 } else { share(light.ambient) };
            let colored = !model.mesh.colors.is_empty();
            Surface { kind, model: index, color, ambient, ramp, texture, wrap, colored }
        };
        for (k, material) in model.mesh.materials.iter().enumerate() {
            let textured = material.texture.as_ref().is_some_and(|t| t.size().area() > 0);
            let texture = textured.then_some((index, k));
            surfaces.push(surface(material.color, texture, material.wrap, material.unlit));
        }
        surfaces.push(surface(Vec3::ONE, None, [Wrap::Repeat; 2], false));
    }

    /// Whether it has a texture with texels.
    pub fn is_textured(&self) -> bool {
        self.texture.is_some()
    }

    /// Whether its vertices have colors.
    pub fn is_colored(&self) -> bool {
        self.colored
    }

    fn texture<'a>(&self, scene: &'a Scene) -> Option<&'a Rgb> {
        let (model, material) = self.texture?;
        scene.models.get(model)?.mesh.materials.get(material)?.texture.as_deref()
    }

    /// Intensity of the toon ramp for an intensity in 0..1.
    #[inline(always)]
    fn toon(&self, intensity: f32) -> f32 {
        self.ramp[((intensity * 32.0) as usize).min(31)]
    }
}

/// 32 entries of `steps` equal levels from `base` to 1; the last entry is 1.
fn ramp(steps: u32, base: f32) -> [f32; 32] {
    let steps = steps.clamp(2, 1 << 16);
    let base = if base >= 0.0 { f64::from(base.min(1.0)) } else { 0.0 };
    let mut ramp = [1.0; 32];
    for (i, entry) in ramp.iter_mut().enumerate().take(31) {
        let level = i as u32 * steps / 32;
        *entry = (base + (1.0 - base) * f64::from(level) / f64::from(steps - 1)) as f32;
    }
    ramp
}

/// What a frame's pixels are shaded with.
#[derive(Clone, Copy)]
pub(super) struct Palette<'a> {
    pub scene: &'a Scene,
    pub surfaces: &'a [Surface],
    pub channels: Channels,
    /// 1/z that stands for no surface.
    pub nothing: f32,
}

/// Pixels that are shaded together.
pub(super) const RUN: usize = 8;

/// Depth and color of one row of a tile, as long as the outputs are; 64 pixels at most.
#[inline(always)]
pub(super) fn shade_row<S: Simd>(
    simd: S,
    palette: &Palette<'_>,
    slot: &Slot,
    row: usize,
    depth: &mut [f32],
    out: [&mut [u8]; 3],
) {
    let mut far = [f32::INFINITY; TILE];
    let mut levels = [[0i32; TILE]; 3];
    let [reds, greens, blues] = &mut levels;
    let zero = i32x8::splat(simd, 0);
    for x in (0..depth.len()).step_by(RUN) {
        let at = row * STRIDE + x;
        let w = load(simd, slot.w(), at);
        let covered = w.simd_gt(f32x8::splat(simd, palette.nothing));
        let mut left = covered.to_bitmask();
        if left == 0 {
            continue;
        }
        let z = f32x8::splat(simd, 1.0) / w;
        covered.select(z, f32x8::splat(simd, f32::INFINITY)).store_slice(&mut far[x..x + RUN]);
        let (mut r, mut g, mut b) = (zero, zero, zero);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            let (id, same) = if palette.channels.surfaces {
                let id = slot.surface[at + lane];
                let ids = i32x8::from_slice(simd, &slot.surface[at..at + RUN]);
                (id as usize, covered & ids.simd_eq(i32x8::splat(simd, id)))
            } else {
                (0, covered)
            };
            left &= !(same.to_bitmask() | 1 << lane);
            let Some(surface) = palette.surfaces.get(id) else { continue };
            let (red, green, blue) = surface.shade(simd, palette, slot, at, z);
            r = same.select(red, r);
            g = same.select(green, g);
            b = same.select(blue, b);
        }
        r.store_slice(&mut reds[x..x + RUN]);
        g.store_slice(&mut greens[x..x + RUN]);
        b.store_slice(&mut blues[x..x + RUN]);
    }
    depth.copy_from_slice(&far[..depth.len()]);
    for (levels, out) in levels.iter().zip(out) {
        for (out, &level) in out.iter_mut().zip(levels) {
            *out = level as u8;
        }
    }
}

impl Surface {
    /// The base color of a smooth surface that has no other colors than grays.
    pub(super) fn gray(&self) -> Option<f32> {
        let [r, g, b] = self.color;
        let plain = self.kind == Kind::Smooth && self.texture.is_none() && !self.colored;
        (plain && r == g && g == b).then_some(r)
    }

    /// Levels of a run of pixels at these depths.
    #[inline(always)]
    fn shade<S: Simd>(
        &self,
        simd: S,
        palette: &Palette<'_>,
        slot: &Slot,
        at: usize,
        z: f32x8<S>,
    ) -> (i32x8<S>, i32x8<S>, i32x8<S>) {
        let channels = palette.channels;
        let light = match self.kind {
            Kind::Smooth => unit_range(simd, load(simd, slot.light(), at) * z),
            Kind::Flat => load(simd, slot.light(), at),
            Kind::Toon => {
                let mut out = [0.0f32; RUN];
                unit_range(simd, load(simd, slot.light(), at) * z).store_slice(&mut out);
                for value in &mut out {
                    *value = self.toon(*value);
                }
                f32x8::simd_from(simd, out)
            }
            Kind::ThreeSteps => {
                let nx = load(simd, &slot.near[1], at);
                let ny = load(simd, &slot.near[2], at);
                let nz = load(simd, &slot.near[3], at);
                let [lx, ly, lz] = palette.scene.light.direction.to_array();
                let length = (nx * nx + ny * ny + nz * nz).sqrt();
                let towards = nx * lx + ny * ly + nz * lz;
                let (dark, middle) = (f32x8::splat(simd, 0.1), f32x8::splat(simd, 0.4));
                let light = towards.simd_gt(length * 0.2).select(middle, dark);
                towards.simd_gt(length * 0.7).select(f32x8::splat(simd, 1.0), light)
            }
            Kind::Unlit | Kind::Phantom => f32x8::splat(simd, 1.0),
        };
        let light = f32x8::splat(simd, self.ambient) + f32x8::splat(simd, 1.0 - self.ambient) * light;
        let [r, g, b] = self.color;
        let texture = self.texture(palette.scene);
        if texture.is_none() && !self.colored && r == g && g == b {
            let gray = to_level(simd, light, r);
            return (gray, gray, gray);
        }
        let (mut red, mut green, mut blue) = (light, light, light);
        if self.colored {
            let first = channels.color_at();
            red *= unit_range(simd, load(simd, &slot.others[first], at) * z);
            green *= unit_range(simd, load(simd, &slot.others[first + 1], at) * z);
            blue *= unit_range(simd, load(simd, &slot.others[first + 2], at) * z);
        }
        if let Some(texture) = texture {
            let first = channels.uv_at();
            let (mut u, mut v) = ([0.0f32; RUN], [0.0f32; RUN]);
            (load(simd, &slot.others[first], at) * z).store_slice(&mut u);
            (load(simd, &slot.others[first + 1], at) * z).store_slice(&mut v);
            let mut texels = [[1.0f32; RUN]; 3];
            for k in 0..RUN {
                if slot.w()[at + k] > palette.nothing {
                    let [r, g, b] = sample(texture, self.wrap, u[k], v[k]);
                    (texels[0][k], texels[1][k], texels[2][k]) = (r, g, b);
                }
            }
            red *= f32x8::simd_from(simd, texels[0]);
            green *= f32x8::simd_from(simd, texels[1]);
            blue *= f32x8::simd_from(simd, texels[2]);
        }
        (to_level(simd, red, r), to_level(simd, green, g), to_level(simd, blue, b))
    }
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, plane: &[f32], at: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &plane[at..at + RUN])
}

/// Light times base color, rounded to a whole level.
#[inline(always)]
pub(super) fn to_level<S: Simd>(simd: S, light: f32x8<S>, base: f32) -> i32x8<S> {
    (light * f32x8::splat(simd, base) + f32x8::splat(simd, 0.5)).to_int()
}

/// Clamped to 0..1; not-a-number becomes 0.
#[inline(always)]
pub(super) fn unit_range<S: Simd>(simd: S, v: f32x8<S>) -> f32x8<S> {
    let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
    v.simd_gt(zero).select(v, zero).min(one)
}

/// The texture's color at (u, v), v up, bilinear between texel centers; 0..1 each.
#[inline(always)]
pub(super) fn sample(texture: &Rgb, [across, along]: [Wrap; 2], u: f32, v: f32) -> [f32; 3] {
    let size = texture.size();
    let (x0, x1, fx) = taps(across, u, size.width);
    let (y0, y1, fy) = taps(along, 1.0 - v, size.height);
    let mut color = [0.0; 3];
    for (value, plane) in color.iter_mut().zip(&texture.planes) {
        let (above, below) = (plane.row(y0), plane.row(y1));
        let (a, b) = (mix(above[x0], above[x1], fx), mix(below[x0], below[x1], fx));
        *value = (a + (b - a) * fy) * (1.0 / 255.0);
    }
    color
}

#[inline(always)]
fn mix(a: u8, b: u8, share: f32) -> f32 {
    f32::from(a) + (f32::from(b) - f32::from(a)) * share
}

/// Both texels around a coordinate, which runs from 0 to 1 over `count` texels, and the weight of the second.
#[inline(always)]
fn taps(wrap: Wrap, coordinate: f32, count: usize) -> (usize, usize, f32) {
    let fraction = |v: f32| {
        let share = v - v.floor();
        if (0.0..1.0).contains(&share) { share } else { 0.0 }
    };
    let share = match wrap {
        Wrap::Repeat => fraction(coordinate),
        Wrap::Mirror => {
            let twice = 2.0 * fraction(coordinate * 0.5);
            if twice > 1.0 { 2.0 - twice } else { twice }
        }
        Wrap::Clamp if coordinate >= 0.0 => coordinate.min(1.0),
        Wrap::Clamp => 0.0,
    };
    let at = share * count as f32 - 0.5;
    let cell = at.floor();
    let last = count - 1;
    let first =
        if cell < 0.0 { if wrap == Wrap::Repeat { last } else { 0 } } else { (cell as usize).min(last) };
    let second = match wrap {
        Wrap::Repeat if first == last => 0,
        Wrap::Repeat => first + 1,
        // at the first texel's outer half both are that texel
        _ if cell < 0.0 => 0,
        _ => (first + 1).min(last),
    };
    (first, second, at - cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_is_the_contracts_ramp() {
        let ramp = ramp(4, 0.25);
        assert_eq!(
            [ramp[0], ramp[7], ramp[8], ramp[16], ramp[24], ramp[31]],
            [0.25, 0.25, 0.5, 0.75, 1.0, 1.0]
        );
        assert_eq!(super::ramp(64, 0.0)[31], 1.0, "the last entry is 1 for any number of steps");
    }

    #[test]
    fn taps_wrap_around() {
        let taps = |coordinate, count| taps(Wrap::Repeat, coordinate, count);
        assert_eq!(taps(0.0, 4), (3, 0, 0.5));
        assert_eq!(taps(0.125, 4), (0, 1, 0.0));
        assert_eq!(taps(-0.125, 4), (3, 0, 0.0));
        assert_eq!(taps(7.5, 1), (0, 0, 0.0));
        assert_eq!(taps(f32::NAN, 4).0, 3);
    }

    #[test]
    fn taps_mirror_and_stop() {
        let value = |wrap, coordinate: f32| {
            let (a, b, share) = taps(wrap, coordinate, 4);
            a as f32 * (1.0 - share) + b as f32 * share
        };
        for k in -40..=40 {
            let at = k as f32 / 8.0;
            // plainly: unfolded into the first period, then between texel centers, the ends held
            let folded = (at - 2.0 * (at / 2.0).floor() - 1.0).abs();
            let plain = |share: f32| (share * 4.0 - 0.5).clamp(0.0, 3.0);
            assert_eq!(value(Wrap::Mirror, at), plain(1.0 - folded), "mirror at {at}");
            assert_eq!(value(Wrap::Clamp, at), plain(at.clamp(0.0, 1.0)), "clamp at {at}");
        }
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e-30] {
                let (a, b, share) = taps(wrap, odd, 3);
                assert!(a < 3 && b < 3 && (0.0..=1.0).contains(&share), "{wrap:?} {odd}");
            }
        }
    }
}
