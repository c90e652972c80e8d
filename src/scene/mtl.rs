//! Wavefront MTL: the colors and textures of OBJ files.

use super::Limits;
use super::mesh::{Material, Wrap};
use super::obj::{numbers, statements, text};
use super::texture::Textures;
use glam::Vec3;
use std::path::Path;

/// Reads the material library `name` into `materials`: `newmtl`, `Kd`, `map_Kd`; the first material of a name counts.
/// One that cannot be read is logged and done without.
pub(super) fn load(name: &str, limits: &Limits, textures: &mut Textures, materials: &mut Vec<Material>) {
    let bytes = match textures.bytes(name) {
        Some(Ok(bytes)) => bytes,
        Some(Err(error)) => return log::warn!("{error}; drawing without these materials"),
        None => return,
    };
    let first = materials.len();
    // textures lie beside the library, which may lie in another folder than the model
    let name = name.replace('\\', "/");
    let folder = Path::new(&name).parent().unwrap_or(Path::new(""));
    statements(&text(&bytes), |statement| {
        let statement = statement.trim();
        let (keyword, rest) =
            statement.split_once(char::is_whitespace).map_or((statement, ""), |(k, r)| (k, r.trim()));
        match keyword {
            "newmtl" if materials.len() < limits.materials => {
                materials.push(Material { name: rest.to_owned(), color: Vec3::ONE, ..Material::default() });
            }
            "Kd" => {
                let [r, g, b] = numbers(rest);
                // one number stands for all three
                let color = if g.is_nan() && b.is_nan() { Vec3::splat(r) } else { Vec3::new(r, g, b) };
                if let (Some(material), true) = (materials[first..].last_mut(), color.is_finite()) {
                    material.color = color.clamp(Vec3::ZERO, Vec3::ONE);
                }
            }
            "map_Kd" => {
                if let Some(material) = materials[first..].last_mut() {
                    let map = Map::new(rest);
                    material.texture =
                        textures.file(&folder.join(map.name.replace('\\', "/")).to_string_lossy());
                    material.wrap = [map.wrap; 2];
                }
            }
            _ => {}
        }
    });
}

/// A `map_Kd` statement.
#[derive(Debug, PartialEq)]
struct Map<'a> {
    /// The picture file; may hold spaces.
    name: &'a str,
    /// From `-clamp on`.
    wrap: Wrap,
}

impl<'a> Map<'a> {
    fn new(rest: &'a str) -> Self {
        let mut map = Map { name: rest, wrap: Wrap::Repeat };
        while let Some((option, after)) = map.name.split_once(char::is_whitespace) {
            let values = match option {
                "-blendu" | "-blendv" | "-cc" | "-clamp" | "-boost" | "-texres" | "-bm" | "-imfchan"
                | "-type" => 1,
                "-mm" => 2,
                "-o" | "-s" | "-t" => 3,
                _ => break,
            };
            map.name = after.trim_start();
            // offsets and scales may give fewer than three numbers
            for k in 0..values {
                let Some((word, after)) = map.name.split_once(char::is_whitespace) else { break };
                if k > 0 && word.parse::<f32>().is_err() {
                    break;
                }
                if option == "-clamp" {
                    map.wrap = if word == "on" { Wrap::Clamp } else { Wrap::Repeat };
                }
                map.name = after.trim_start();
            }
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_before_the_name_are_understood() {
        for (rest, name, wrap) in [
            ("a b.png", "a b.png", Wrap::Repeat),
            ("-clamp on a b.png", "a b.png", Wrap::Clamp),
            ("-clamp off a.png", "a.png", Wrap::Repeat),
            ("-s 1 1 -clamp on -o 0 a.png", "a.png", Wrap::Clamp),
            ("-clamp", "-clamp", Wrap::Repeat),
            ("-clamp on", "on", Wrap::Repeat),
        ] {
            assert_eq!(Map::new(rest), Map { name, wrap }, "{rest}");
        }
    }
}
