//! What a `.glb` says, against values worked out by hand.

use crate::write::{Data, glb_of};
use crate::{alone, corners, loaded, parse, png, texture};
use glam::{DAffine3, DMat3, DVec2, DVec3, Vec2, Vec3};
use vernissage::scene::Wrap;

#[test]
fn nodes_place_their_meshes() {
    let _alone = alone();
    let mut data = Data::default();
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.5], [3.0, 1.0, -1.0]];
    let position = data.floats(&points);
    let normal = data.floats(&[[0.6, 0.0, 0.8]; 4]);
    let file = data.file(&format!(
        r#""scene":1,"scenes":[{{"nodes":[3]}},{{"nodes":[0]}}],
        "nodes":[{{"translation":[1,2,3],"rotation":[0,0.6,0,0.8],"scale":[2,3,-4],"children":[1,2]}},
        {{"mesh":0,"matrix":[0,1,0,0, -1,0,0,0, 0,0,1,0, 5,6,7,1]}},{{"mesh":0}},{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":{position},"NORMAL":{normal}}},"mode":5}}]}}]"#
    ));
    let mesh = loaded(&file);
    // by hand: a turn about y by 2 atan(.6/.8), a mirror in z
    let (sin, cos) = (2.0 * 0.6 * 0.8, 0.8 * 0.8 - 0.6 * 0.6);
    let turn = DMat3::from_cols(DVec3::new(cos, 0.0, -sin), DVec3::Y, DVec3::new(sin, 0.0, cos));
    let outer = DAffine3 {
        matrix3: turn * DMat3::from_diagonal(DVec3::new(2.0, 3.0, -4.0)),
        translation: DVec3::new(1.0, 2.0, 3.0),
    };
    let inner = DAffine3 {
        matrix3: DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z),
        translation: DVec3::new(5.0, 6.0, 7.0),
    };
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (8, 4));
    // a strip turns every other triangle, a mirror all of them
    assert_eq!(mesh.triangles[..2], [[0, 2, 1], [1, 2, 3]]);
    for (k, to_file) in [outer * inner, outer].into_iter().enumerate() {
        for (i, p) in points.iter().enumerate() {
            let expected = to_file.transform_point3(Vec3::from(*p).as_dvec3());
            assert!((mesh.positions[4 * k + i].as_dvec3() - expected).length() < 1e-5);
            let normal = (to_file.matrix3.inverse().transpose() * DVec3::new(0.6, 0.0, 0.8)).normalize();
            assert!((mesh.normals[4 * k + i].as_dvec3() - normal).length() < 1e-6, "inverse transpose");
        }
    }
}

#[test]
fn glb_faces_without_normals_are_flat() {
    let _alone = alone();
    let mut data = Data::default();
    let position = data.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let indices = data.indices(&[0, 1, 2, 0, 3, 1, 0, 1, 9]);
    let scene = |mode: u32| {
        format!(
            r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[
            {{"attributes":{{"POSITION":{position}}},"indices":{indices},"mode":{mode}}},
            {{"attributes":{{"POSITION":{position}}},"mode":1}}]}}]"#
        )
    };
    let mesh = loaded(&data.file(&scene(4)));
    assert_eq!(mesh.triangles, [[0, 1, 2], [3, 4, 5]], "an index past the vertices drops its triangle");
    assert_eq!(mesh.normals, [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::Y, Vec3::Y, Vec3::Y]);
    // §3.7.2.1 by hand: a fan's triangles begin with its second corner
    let fan = loaded(&data.file(&scene(6)));
    let [o, x, y, z] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    assert_eq!(corners(&fan)[..3], [[x, y, o], [y, o, o], [o, z, o]]);
}

#[test]
fn sparse_accessors_replace_values() {
    let _alone = alone();
    let mut data = Data::default();
    let places = data.view(&[1, 3]);
    let values: Vec<u8> =
        [7.0_f32, 8.0, 9.0, -1.0, -2.0, -3.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = data.view(&values);
    let whole = data.floats(&[[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0], [4.0, 4.0, 4.0]]);
    let sparse = format!(
        r#""componentType":5126,"count":4,"type":"VEC3","sparse":{{"count":2,
        "indices":{{"bufferView":{places},"componentType":5121}},"values":{{"bufferView":{values}}}}}}}"#
    );
    data.accessors.push(format!("{{{sparse}"));
    data.accessors.push(format!(r#"{{"bufferView":2,{sparse}"#));
    let normal = data.floats(&[[0.0, 0.0, 1.0]; 4]);
    let read = |position: usize| {
        let primitive = format!(r#"{{"attributes":{{"POSITION":{position},"NORMAL":{normal}}}}}"#);
        loaded(&data.file(&format!(r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitive}]}}]"#)))
    };
    let [a, b] = [Vec3::new(7.0, 8.0, 9.0), Vec3::new(-1.0, -2.0, -3.0)];
    assert_eq!(read(whole + 1).positions, [Vec3::ZERO, a, Vec3::ZERO, b]);
    assert_eq!(read(whole + 2).positions, [Vec3::ONE, a, Vec3::splat(3.0), b]);
}

#[test]
fn glb_materials_come_along() {
    let _alone = alone();
    let mut data = Data::default();
    let position = data.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let normal = data.floats(&[[0.0, 0.0, 1.0]; 3]);
    let first = data.floats(&[[0.0, 0.0], [1.0, 0.0], [0.25, 0.5]]);
    let second: Vec<u8> =
        [0_u16, 65535, 13107, 26214, 65535, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let second = data.accessor("VEC2", 5123, 3, &second);
    let image = data.view(&png());
    let attributes =
        format!(r#"{{"POSITION":{position},"NORMAL":{normal},"TEXCOORD_0":{first},"TEXCOORD_1":{second}}}"#);
    let file = data.file(&format!(
        r#""extensionsUsed":["KHR_materials_unlit","KHR_texture_transform","KHR_materials_ior"],
        "extensionsRequired":["KHR_materials_unlit","KHR_texture_transform"],
        "nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{attributes},"material":0}},
        {{"attributes":{attributes},"material":1}},{{"attributes":{attributes}}},{{"attributes":{attributes},"material":2}}]}}],
        "materials":[{{"name":"a","extensions":{{"KHR_materials_unlit":{{}}}},"pbrMetallicRoughness":{{
        "baseColorFactor":[0.5,1,0,1],"baseColorTexture":{{"index":0,"extensions":{{"KHR_texture_transform":
        {{"offset":[0.5,-1],"rotation":0.3,"scale":[2,3]}}}}}}}}}},
        {{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":1,"texCoord":0,"extensions":{{"KHR_texture_transform":
        {{"texCoord":1}}}}}}}}}},{{"name":"plain"}}],
        "textures":[{{"source":0,"sampler":0}},{{"source":1}}],
        "samplers":[{{"wrapS":33071,"wrapT":33648}}],"images":[{{"bufferView":{image}}},{{"uri":"else.png"}}]"#
    ));
    let mesh = loaded(&file);
    assert_eq!(mesh.material_of, [0, 1, u16::MAX, 2]);
    let [a, b, plain] = [&mesh.materials[0], &mesh.materials[1], &mesh.materials[2]];
    assert_eq!((a.name.as_str(), a.unlit, a.wrap), ("a", true, [Wrap::Clamp, Wrap::Mirror]));
    assert_eq!((b.unlit, b.wrap, b.color, plain.color), (false, [Wrap::Repeat; 2], Vec3::ONE, Vec3::ONE));
    // IEC 61966-2-1: linear .5
    assert!((a.color - Vec3::new(0.735357, 1.0, 0.0)).abs().max_element() < 1e-6, "{}", a.color);
    assert_eq!(a.texture.as_deref(), Some(&texture()));
    assert!(b.texture.is_none(), "pictures in other files are done without");
    // counter-clockwise as seen, v down: u to the right turns up, towards lower v
    let (sin, cos) = libm::sincos(0.3);
    for (k, uv) in [DVec2::ZERO, DVec2::X, DVec2::new(0.25, 0.5)].into_iter().enumerate() {
        let (x, y) = (2.0 * uv.x, 3.0 * uv.y);
        let expected = DVec2::new(cos * x + sin * y + 0.5, 1.0 - (-sin * x + cos * y - 1.0));
        assert!((mesh.texcoords[k].as_dvec2() - expected).length() < 1e-6, "{k}");
    }
    // the second set, its integers by their full range
    for (k, uv) in [[0.0, 0.0], [0.2, 0.6], [1.0, 1.0]].into_iter().enumerate() {
        assert!((mesh.texcoords[3 + k] - Vec2::from(uv)).length() < 1e-6, "{k}");
    }
    assert_eq!(mesh.positions.len(), 9, "the last two primitives read the same vertices in the same way");
}

#[test]
fn what_a_glb_cannot_ask_for_is_named() {
    let _alone = alone();
    let mut data = Data::default();
    let position = data.floats(&[[0.0; 3]; 3]);
    let mesh = format!(r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":{position}}}}}]}}]"#);
    let refused = |more: &str| parse("bad.glb", &data.file(more)).expect_err(more);
    let required =
        refused(r#""extensionsRequired":["KHR_draco_mesh_compression","KHR_materials_unlit","X_y"]"#);
    assert!(
        required.contains("bad.glb: ") && required.contains("KHR_draco_mesh_compression, X_y;"),
        "{required}"
    );
    for (more, says) in [
        (format!(r#""nodes":[{{"mesh":1}}],{mesh}"#), "no mesh 1"),
        (format!(r#""nodes":[{{"children":[4]}}],{mesh}"#), "no node 4"),
        (
            format!(r#""scenes":[{{"nodes":[0,1]}}],"nodes":[{{"children":[1]}},{{"mesh":0}}],{mesh}"#),
            "two parents",
        ),
        (format!(r#""scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[0]}}],{mesh}"#), "two parents"),
        (
            r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":7}}]}]"#.into(),
            "no accessor 7",
        ),
        (
            r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":0}]}]"#
                .into(),
            "not of the type",
        ),
        (r#""nodes":3"#.into(), "JSON"),
    ] {
        let error = refused(&more);
        assert!(error.contains(says), "{more}: {error}");
    }
    let raw = |json: &str, data: &[u8]| parse("bad.glb", &glb_of(json, data)).expect_err(json);
    let one = |buffer: &str, view: &str, accessor: &str| {
        format!(
            r#"{{"buffers":[{{{buffer}}}],"bufferViews":[{{"buffer":0,{view}}}],"accessors":[{{"bufferView":0,
            "type":"VEC3",{accessor}}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}]}}"#
        )
    };
    let good = r#""componentType":5126,"count":3"#;
    for (json, says) in [
        (one("", r#""byteLength":37"#, good), "past the data"),
        (one("", r#""byteLength":36"#, r#""componentType":5126,"count":4"#), "past its buffer view"),
        (one("", r#""byteLength":36"#, r#""componentType":5126,"count":4294967295"#), "past its buffer view"),
        (one("", r#""byteLength":36,"byteStride":18446744073709551615"#, good), "past its buffer view"),
        (one("", r#""byteLength":36,"byteOffset":18446744073709551615"#, good), "past the data"),
        (one("", r#""byteLength":36"#, r#""componentType":99,"count":3"#), "component type"),
        (one(r#""uri":"else.bin""#, r#""byteLength":36"#, good), "another file"),
    ] {
        let error = raw(&json, &[0; 36]);
        assert!(error.contains(says), "{json}: {error}");
    }
    for (bytes, says) in [
        (&b"{}"[..], ".glb"),
        (b"glTF", "shorter"),
        (b"glTF\x01\0\0\0\x0c\0\0\0", "version 1"),
        (b"glTF\x02\0\0\0\0\0\0\0", "no JSON"),
    ] {
        let error = parse("bad.gltf", bytes).expect_err(says);
        assert!(error.contains(says) && error.contains("glTF"), "{error}");
    }
}
