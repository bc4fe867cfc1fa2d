//! Scenes for the pack tests.

use tessera_pack::{
    Ambient, Camera, Environment, EnvironmentKind, ImageInput, Light, LightKind, Material, PackInput, Wrap,
};

/// A height field of `side` x `side` quads with normals, colours, texture coordinates that need shifts, splits and the side
/// table, three materials and one of everything else.
pub fn everything(side: u32) -> PackInput {
    let mut input = PackInput::default();
    let height = |x: f64, y: f64| 0.3 * libm::sin(5.0 * x) * libm::cos(3.0 * y);
    for j in 0..=side {
        for i in 0..=side {
            let (x, y) = (f64::from(i) / f64::from(side), f64::from(j) / f64::from(side));
            input.positions.push([x, y, height(x, y)]);
            input.normals.push(if i == 3 { [0.0; 3] } else { [-libm::cosf(5.0 * x as f32), 0.5, 1.0] });
            // The steep end spans more than 2 a quad: the side table.
            input.uvs.push([(x * x * 12.0 - 3.7) as f32, (y * 7.0) as f32]);
            input.colors.push([(i * 7) as u8, (j * 5) as u8, 200, 255]);
        }
    }
    let row = side + 1;
    for j in 0..side {
        for i in 0..side {
            let v = j * row + i;
            input.triangles.push([v, v + 1, v + row]);
            input.triangles.push([v + row, v + 1, v + row + 1]);
        }
    }
    let n = input.triangles.len() as u32;
    input.material_runs = vec![(0, 2), (n / 4, 0), (n / 2, 1), (n / 2 + 3, 2)];
    let textured = |t| Material { base_texture: t, ..Material::default() };
    input.materials = vec![textured(0), Material::default(), textured(1)];
    input.textures = vec![image(4, 2, Wrap::Repeat, Wrap::Repeat), image(3, 5, Wrap::Mirror, Wrap::Clamp)];
    input.lights = vec![
        Light { position: [0.5, 0.5, 2.0], ..light(LightKind::Point) },
        light(LightKind::Directional),
        Light { position: [0.0, 0.0, 3.0], ..light(LightKind::Spot) },
    ];
    input.ambient = Ambient { radiance: [0.1, 0.2, 0.3] };
    input.environment =
        Environment { kind: EnvironmentKind::Gradient as u32, zenith: [1.0; 3], ..Environment::default() };
    input.cameras = vec![Camera {
        eye: [0.5, -2.0, 1.0],
        target: [0.5, 0.5, 0.0],
        up: [0.0, 0.0, 1.0],
        fov_degrees: 45.0,
        name: Camera::encode_name("from the front"),
    }];
    input
}

/// `triangles` over `positions`, one plain material.
pub fn bare(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> PackInput {
    PackInput {
        positions,
        triangles,
        material_runs: vec![(0, 0)],
        materials: vec![Material::default()],
        ..PackInput::default()
    }
}

/// A test picture.
pub fn image(width: u32, height: u32, wrap_s: Wrap, wrap_t: Wrap) -> ImageInput {
    let rgba = (0..width * height * 4).map(|i| (i * 37) as u8).collect();
    ImageInput { name: format!("{width}x{height}"), width, height, rgba, wrap_s, wrap_t, nearest: false }
}

fn light(kind: LightKind) -> Light {
    Light {
        position: [0.0; 3],
        kind: kind as u32,
        direction: [0.0, 0.0, -1.0],
        range: f32::INFINITY,
        intensity: [10.0; 3],
        cos_inner: 0.9,
        cos_outer: 0.7,
        reserved: [0; 3],
    }
}
