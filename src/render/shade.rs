//! From intensity and texture to 8-bit color (contracts: `draw`).

use crate::pixels::Rgb;
use crate::scene::{Light, Model, Scene, Shading};
use glam::Vec3;

/// How intensity is found on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Smooth,
    Flat,
    Toon,
    ThreeSteps,
}

/// One material of one placed model, ready for shading.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub kind: Kind,
    /// Base color times 255.
    pub color: [f32; 3],
    /// Share of light that reaches every surface.
    pub ambient: f32,
    /// The toon ramp.
    pub ramp: [f32; 32],
    /// Where its texture is: model and material.
    texture: Option<(usize, usize)>,
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
        let (kind, ramp) = match shading {
            Shading::Smooth => (Kind::Smooth, [0.0; 32]),
            Shading::Flat => (Kind::Flat, [0.0; 32]),
            Shading::Toon { steps, base } => (Kind::Toon, ramp(steps, base)),
            Shading::ThreeSteps => (Kind::ThreeSteps, [0.0; 32]),
        };
        let share = |v: f32| if v >= 0.0 { v.min(1.0) } else { 0.0 };
        let surface = |color: Vec3, texture| Surface {
            kind,
            color: (color * light.tint).to_array().map(|v| share(v) * 255.0),
            ambient: if kind == Kind::ThreeSteps { 0.0 } else { share(light.ambient) },
            ramp,
            texture,
        };
        for (k, material) in model.mesh.materials.iter().enumerate() {
            let textured = material.texture.as_ref().is_some_and(|t| t.size().area() > 0);
            surfaces.push(surface(material.color, textured.then_some((index, k))));
        }
        surfaces.push(surface(Vec3::ONE, None));
    }

    /// The texture, where it has any texels.
    pub fn texture<'a>(&self, scene: &'a Scene) -> Option<&'a Rgb> {
        let (model, material) = self.texture?;
        scene.models.get(model)?.mesh.materials.get(material)?.texture.as_deref()
    }

    /// Intensity of the toon ramp for an intensity in 0..1.
    #[inline(always)]
    pub fn toon(&self, intensity: f32) -> f32 {
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

/// The texture's color at (u, v), v up, repeated outside 0..1, bilinear between texel centers; 0..1 each.
#[inline(always)]
pub(super) fn sample(texture: &Rgb, u: f32, v: f32) -> [f32; 3] {
    let size = texture.size();
    let (x0, x1, fx) = taps(u, size.width);
    let (y0, y1, fy) = taps(1.0 - v, size.height);
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

/// Both texels around a repeated coordinate and the weight of the second.
#[inline(always)]
fn taps(coordinate: f32, count: usize) -> (usize, usize, f32) {
    let share = coordinate - coordinate.floor();
    let share = if (0.0..1.0).contains(&share) { share } else { 0.0 };
    let at = share * count as f32 - 0.5;
    let cell = at.floor();
    let first = if cell < 0.0 { count - 1 } else { (cell as usize).min(count - 1) };
    let second = if first + 1 == count { 0 } else { first + 1 };
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
        assert_eq!(taps(0.0, 4), (3, 0, 0.5));
        assert_eq!(taps(0.125, 4), (0, 1, 0.0));
        assert_eq!(taps(-0.125, 4), (3, 0, 0.0));
        assert_eq!(taps(7.5, 1), (0, 0, 0.0));
        assert_eq!(taps(f32::NAN, 4).0, 3);
    }
}
