//! Materials: base color, its texture with wrap modes and transform, and whether it is unlit (§3.9).

use super::accessor::Buffers;
use super::broken;
use super::json::{Document, TextureTransform};
use crate::pixels::Rgb;
use crate::scene::load::Refusal;
use crate::scene::mesh::{Material, Wrap};
use crate::scene::texture::Textures;
use glam::{DAffine2, DMat2, DVec2, Vec3};
use std::sync::Arc;

/// The materials of a file.
pub(super) struct Materials<'a> {
    document: &'a Document,
    materials: Vec<Material>,
}

impl<'a> Materials<'a> {
    /// Reads all materials; textures that cannot be had are logged and done without.
    pub fn new(buffers: &Buffers<'a>, textures: &mut Textures) -> Result<Self, Refusal> {
        let document = buffers.document;
        let mut images: Vec<Option<Option<Arc<Rgb>>>> = vec![None; document.images.len()];
        let mut materials = Vec::with_capacity(document.materials.len());
        for source in &document.materials {
            let surface = &source.pbr_metallic_roughness;
            let [r, g, b, _] = surface.base_color_factor.unwrap_or([1.0; 4]);
            let mut material = Material {
                name: source.name.clone(),
                color: coded(Vec3::new(r, g, b)),
                unlit: source.extensions.unlit.is_some(),
                ..Material::default()
            };
            if let Some(used) = &surface.base_color_texture {
                let texture = document.textures.get(used.index as usize);
                let texture =
                    texture.ok_or_else(|| broken(format_args!("there is no texture {}", used.index)))?;
                if let Some(sampler) = texture.sampler.and_then(|s| document.samplers.get(s as usize)) {
                    material.wrap = [sampler.wrap_s, sampler.wrap_t].map(wrap);
                }
                if let Some(image) = texture.source.map(|source| source as usize) {
                    let slot = images.get_mut(image);
                    let slot = slot.ok_or_else(|| broken(format_args!("there is no image {image}")))?;
                    if slot.is_none() {
                        *slot = Some(picture(buffers, image, textures)?);
                    }
                    material.texture = slot.clone().flatten();
                }
            }
            materials.push(material);
        }
        Ok(Self { document, materials })
    }

    /// Which texture coordinates a material uses, and how they are changed first.
    pub fn texcoords(&self, material: Option<u32>) -> (u32, DAffine2) {
        let material = material.and_then(|m| self.document.materials.get(m as usize));
        let Some(used) = material.and_then(|m| m.pbr_metallic_roughness.base_color_texture.as_ref()) else {
            return (0, DAffine2::IDENTITY);
        };
        match &used.extensions.transform {
            Some(transform) => (transform.tex_coord.unwrap_or(used.tex_coord), change(transform)),
            None => (used.tex_coord, DAffine2::IDENTITY),
        }
    }

    pub fn into_materials(self) -> Vec<Material> {
        self.materials
    }
}

/// The picture number `image`, which must be inside the file.
fn picture(buffers: &Buffers, image: usize, textures: &mut Textures) -> Result<Option<Arc<Rgb>>, Refusal> {
    let view = buffers.document.images.get(image).and_then(|image| image.buffer_view);
    let name = format!("picture {image} in the model");
    let Some(view) = view else {
        log::warn!("{name}: in another file; drawing without it (save everything in one .glb)");
        return Ok(None);
    };
    Ok(textures.decode(&name, buffers.view(view)?.0))
}

/// Offset · rotation · scale, v down. Counter-clockwise is as the picture is seen; the listing in the extension's text
/// turns the other way, against its words and its sample model.
fn change(transform: &TextureTransform) -> DAffine2 {
    let angle = transform.rotation.unwrap_or(0.0);
    let (sin, cos) = if angle.is_finite() { libm::sincos(angle) } else { (0.0, 1.0) };
    let turn = DMat2::from_cols(DVec2::new(cos, -sin), DVec2::new(sin, cos));
    let scale = DMat2::from_diagonal(DVec2::from(transform.scale.unwrap_or([1.0; 2])));
    DAffine2 { matrix2: turn * scale, translation: DVec2::from(transform.offset.unwrap_or_default()) }
}

fn wrap(mode: Option<u32>) -> Wrap {
    match mode {
        Some(33071) => Wrap::Clamp,
        Some(33648) => Wrap::Mirror,
        _ => Wrap::Repeat,
    }
}

/// A linear color as sRGB values (IEC 61966-2-1), 0..1; not finite is white.
pub(super) fn coded(linear: Vec3) -> Vec3 {
    if !linear.is_finite() || linear == Vec3::ONE {
        return Vec3::ONE;
    }
    let code = |value: f32| {
        let value = f64::from(value.clamp(0.0, 1.0));
        let coded =
            if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * libm::pow(value, 1.0 / 2.4) - 0.055 };
        coded as f32
    };
    Vec3::new(code(linear.x), code(linear.y), code(linear.z))
}
