//! One mesh, written in every format by hand.

use crate::png;
use glam::Vec3;

/// A shape with everything a vertex can have. Texture coordinates are v up.
pub struct Sample {
    pub positions: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
    pub texcoords: Vec<[f32; 2]>,
    /// 0..255, sRGB.
    pub colors: Vec<[u8; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// An octahedron with coordinates that no decimal cuts short, each vertex at a place of its own.
pub fn sample() -> Sample {
    let positions = vec![
        [0.1, 0.2, 1.7],
        [1.3, -0.1, 0.3],
        [0.07, 1.1, 0.0],
        [-1.9, 0.0, 1e-3],
        [0.0, -1.234567, 0.5],
        [1e-7, 0.3, -2.5],
    ];
    let ring = [1, 2, 3, 4, 1];
    let triangles = ring.windows(2).flat_map(|r| [[0, r[0], r[1]], [5, r[1], r[0]]]).collect();
    let unit = |p: &[f32; 3]| Vec3::from(*p).normalize().to_array();
    Sample {
        normals: positions.iter().map(unit).collect(),
        texcoords: (0..6).map(|k| [k as f32 / 8.0, 1.0 - k as f32 / 16.0]).collect(),
        colors: (0..6).map(|k| [40 * k, 255 - 40 * k, 7 + k]).collect(),
        positions,
        triangles,
    }
}

impl Sample {
    pub fn corners(&self) -> Vec<[Vec3; 3]> {
        self.triangles.iter().map(|t| t.map(|i| Vec3::from(self.positions[i as usize]))).collect()
    }
}

pub fn obj(sample: &Sample) -> Vec<u8> {
    let mut text = String::from("mtllib m.mtl\nusemtl paint\n");
    for (p, c) in sample.positions.iter().zip(&sample.colors) {
        let [r, g, b] = c.map(|c| f32::from(c) / 255.0);
        text += &format!("v {} {} {} {r} {g} {b}\n", p[0], p[1], p[2]);
    }
    sample.texcoords.iter().for_each(|t| text += &format!("vt {} {}\n", t[0], t[1]));
    sample.normals.iter().for_each(|n| text += &format!("vn {} {} {}\n", n[0], n[1], n[2]));
    for t in &sample.triangles {
        let [a, b, c] = t.map(|i| i + 1);
        text += &format!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\n");
    }
    text.into_bytes()
}

#[derive(Clone, Copy, PartialEq)]
pub enum Order {
    Ascii,
    Little,
    Big,
}

pub fn ply(sample: &Sample, order: Order) -> Vec<u8> {
    let format = match order {
        Order::Ascii => "ascii",
        Order::Little => "binary_little_endian",
        Order::Big => "binary_big_endian",
    };
    let mut out = format!(
        "ply\nformat {format} 1.0\ncomment TextureFile t.png\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty uchar red\n\
         property uchar green\nproperty uchar blue\nproperty float s\nproperty double t\nelement edge 1\n\
         property list uchar short ends\nelement face {}\nproperty uchar flags\n\
         property list uchar int vertex_indices\nend_header\n",
        sample.positions.len(),
        sample.triangles.len()
    )
    .into_bytes();
    // bytes are given in little-endian order
    let mut put = |bytes: &[u8], text: String| match order {
        Order::Ascii => out.extend(format!("{text} ").bytes()),
        Order::Little => out.extend(bytes),
        Order::Big => out.extend(bytes.iter().rev()),
    };
    for i in 0..sample.positions.len() {
        for v in sample.positions[i].iter().chain(&sample.normals[i]) {
            put(&v.to_le_bytes(), v.to_string());
        }
        sample.colors[i].iter().for_each(|c| put(&[*c], c.to_string()));
        let [s, t] = sample.texcoords[i];
        put(&s.to_le_bytes(), s.to_string());
        put(&f64::from(t).to_le_bytes(), t.to_string());
    }
    put(&[2], "2".into());
    (0..2_i16).for_each(|end| put(&end.to_le_bytes(), end.to_string()));
    for triangle in &sample.triangles {
        put(&[9], "9".into());
        put(&[3], "3".into());
        triangle.iter().for_each(|i| put(&i.to_le_bytes(), i.to_string()));
    }
    out
}

pub fn stl_binary(sample: &Sample) -> Vec<u8> {
    let mut out = b"solid in name only".to_vec();
    out.resize(80, b' ');
    out.extend((sample.triangles.len() as u32).to_le_bytes());
    for corners in sample.corners() {
        out.extend([0; 12]);
        corners.iter().flat_map(|c| c.to_array()).for_each(|v| out.extend(v.to_le_bytes()));
        out.extend([1, 2]);
    }
    out
}

pub fn stl_ascii(sample: &Sample) -> Vec<u8> {
    let mut text = String::from("solid\n");
    for corners in sample.corners() {
        text += "  facet normal 0 0 0\n    outer loop\n";
        corners.iter().for_each(|c| text += &format!("      vertex {} {} {}\n", c.x, c.y, c.z));
        text += "    endloop\n  endfacet\n";
    }
    (text + "endsolid\n").into_bytes()
}

/// A `.glb` of JSON text and binary data.
pub fn glb_of(json: &str, data: &[u8]) -> Vec<u8> {
    let (mut json, mut data) = (json.as_bytes().to_vec(), data.to_vec());
    json.resize(json.len().next_multiple_of(4), b' ');
    data.resize(data.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    out.extend(2_u32.to_le_bytes());
    out.extend((28 + json.len() as u32 + data.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", data)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

/// Binary data with the views and accessors that describe it.
#[derive(Default)]
pub struct Data {
    pub bytes: Vec<u8>,
    pub views: Vec<String>,
    pub accessors: Vec<String>,
}

impl Data {
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(format!(
            r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#,
            self.bytes.len(),
            bytes.len()
        ));
        self.bytes.extend(bytes);
        self.views.len() - 1
    }

    pub fn accessor(&mut self, shape: &str, component: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{shape}"}}"#
        ));
        self.accessors.len() - 1
    }

    pub fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&format!("VEC{N}"), 5126, values.len(), &bytes)
    }

    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor("SCALAR", 5123, values.len(), &bytes)
    }

    /// The file, with `more` of JSON.
    pub fn file(&self, more: &str) -> Vec<u8> {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],{more}}}"#,
            self.bytes.len(),
            self.views.join(","),
            self.accessors.join(",")
        );
        glb_of(&json, &self.bytes)
    }
}

pub fn linear(srgb: f64) -> f32 {
    (if srgb <= 0.04045 { srgb / 12.92 } else { libm::pow((srgb + 0.055) / 1.055, 2.4) }) as f32
}

pub fn glb(sample: &Sample) -> Vec<u8> {
    let mut data = Data::default();
    let position = data.floats(&sample.positions);
    let normal = data.floats(&sample.normals);
    let down: Vec<[f32; 2]> = sample.texcoords.iter().map(|&[u, v]| [u, 1.0 - v]).collect();
    let texcoord = data.floats(&down);
    let colors: Vec<_> = sample.colors.iter().map(|c| c.map(|c| linear(f64::from(c) / 255.0))).collect();
    let color = data.floats(&colors);
    let flat: Vec<u16> = sample.triangles.iter().flatten().map(|&i| i as u16).collect();
    let indices = data.indices(&flat);
    let image = data.view(&png());
    data.file(&format!(
        r#""scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1]}},{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":{position},"NORMAL":{normal},"TEXCOORD_0":{texcoord},
        "COLOR_0":{color}}},"indices":{indices},"material":0}}]}}],
        "materials":[{{"name":"paint","pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
        "textures":[{{"source":0}}],"images":[{{"bufferView":{image},"mimeType":"image/png"}}]"#
    ))
}
