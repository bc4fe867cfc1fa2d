//! The fast kernels, on packs with plain vertices, held to the `f64` oracle over the original scene: generated scenes, real ones where
//! they are, with and without each thing that can be left out.
//!
//! Same id, same colour, up to [`TOLERANCE`]; what else may differ is what a ray meets where it passes an edge (of a triangle, a
//! shadow, a mirrored thing, a texel) within the rounding of `f32`. Such a pixel counts as explained when the oracle itself comes to the
//! kernel's value, or to values on both sides of it, for rays that are turned by [`TURN`]. Of all others a few may stray ([`STRAYS_MAX`]), and
//! not far: a highlight's exponent of up to 1024, a curved mirror, and a texture of a thousand texels that repeats a dozen times each
//! magnify roundings of normals and texture coordinates by that much. No pixel may show another triangle without a reason.

use crate::support::{root, scene_folder};
use std::path::Path;
use std::time::Duration;
use tessera_geometry::CameraPose;
use tessera_master::prepare::{PrepareOptions, prepare_scene};
use tessera_oracle::{Oracle, OracleImage, View};
use tessera_pack::Plain;
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_scene::{LoadOptions, Scene, Without};
use tessera_whitted::{Features, FrameParams, PixelBlock, PixelFormat, Renderer, Sampling};

/// Pixels along a side.
const SIZE: u32 = 96;
const DEPTH: u32 = 5;

/// Of a pixel. Rounding to `f32` moves what a ray sees by 2^-22 of the scene's size or so, a few hundred-thousandths of a pixel of these
/// pictures; mirrors, glass and shadows that fall flatly carry it on, magnified. This leaves room for a factor of a hundred.
const TURN: f64 = 1.0 / 128.0;

/// Relative difference of a channel: some dozens of roundings of 2^-24 a surface, in highlights times an exponent of up to 1024.
const TOLERANCE: f64 = 1e-4;

/// What a channel may differ by besides, far below a step of 8-bit codes (3e-4 where they are finest).
const LEAST: f64 = 1e-5;

/// Share of pixels that may differ for a reason: Sponza's textures make it 4 %, in most scenes it is below 1 %.
const EXPLAINED_MAX: f64 = 0.06;

/// Share of pixels that may differ without one, and by how much of its value a channel of such a pixel may: what magnified roundings come to.
const STRAYS_MAX: f64 = 0.005;
const STRAY: f64 = 0.05;

/// `coplanar`: how many pixels may show another triangle for a reason that turned rays don't tell, because two triangles lie in one
/// plane: `f32` calls distances equal that differ for the oracle, or the other way round, and the smallest id comes first among equals.
/// Such a pixel is as deep, and of the same colour.
fn check(scene: &Scene, without: Without, coplanar: usize) {
    let pose = scene.cameras[0].pose;
    let kernel = by_kernel(scene, &pose, without);
    let oracle = Oracle::new(scene, without).expect("a sound scene");
    let truth = by_oracle(&oracle, &pose);
    let near = turned(&pose).map(|pose| by_oracle(&oracle, &pose));

    let what = format!("{} {without:?}", scene.name);
    let (mut differing, mut strays, mut in_one_plane, mut unexplained) = (0, 0, 0, Vec::new());
    for k in 0..truth.id.len() {
        let is_same = |c: usize, low: f64, high: f64, tolerance: f64| {
            let room = tolerance * high.abs() + LEAST;
            (low - room..=high + room).contains(&kernel.color[k][c])
        };
        let shows = |image: &OracleImage| image.id[k] == kernel.id[k];
        let is_equal = |c: usize| is_same(c, truth.color[k][c], truth.color[k][c], TOLERANCE);
        differing += u32::from(!shows(&truth) || !(0..4).all(is_equal));
        let is_between = |c: usize, tolerance: f64| {
            let all = near.iter().chain([&truth]).map(|image| image.color[k][c]);
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            is_same(c, low, high, tolerance)
        };
        // A depth is off by the rounding of places in the grid, more where the surface is seen flatly: so are those of turned rays.
        let depths = near.iter().chain([&truth]).map(|image| image.depth[k]);
        let (low, high) = depths.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        let is_as_deep = (low * (1.0 - LEAST)..=high * (1.0 + LEAST)).contains(&kernel.depth[k]);
        let is_shown = near.iter().chain([&truth]).any(shows);
        let is_colored = (0..4).all(|c| is_between(c, TOLERANCE));
        strays += u32::from(!is_colored);
        if !is_shown && is_as_deep && is_colored {
            in_one_plane += 1;
        } else if !(is_shown && is_as_deep && (0..4).all(|c| is_between(c, STRAY))) {
            let (x, y) = (k as u32 % SIZE, k as u32 / SIZE);
            unexplained.push(format!(
                "({x}, {y}): triangle {} at {} of {:?}, not {} at {} of {:?}",
                kernel.id[k] as i32,
                kernel.depth[k],
                kernel.color[k],
                truth.id[k] as i32,
                truth.depth[k],
                truth.color[k]
            ));
        }
    }
    assert!(
        unexplained.is_empty(),
        "{what}: {} pixels: {:#?}",
        unexplained.len(),
        &unexplained[..unexplained.len().min(9)]
    );
    assert!(
        in_one_plane <= coplanar,
        "{what}: {in_one_plane} pixels show another triangle of the same place and colour, not {coplanar}"
    );
    let share = |count: u32| f64::from(count) / truth.id.len() as f64;
    assert!(share(differing) <= EXPLAINED_MAX, "{what}: {differing} pixels differ");
    assert!(share(strays) <= STRAYS_MAX, "{what}: {strays} pixels differ without a reason");
}

/// The pose turned by [`TURN`] in eight directions, none along rows or columns.
fn turned(pose: &CameraPose) -> [CameraPose; 8] {
    let ahead = pose.target - pose.eye;
    let right = ahead.cross(pose.up).normalize();
    let up = right.cross(ahead).normalize();
    let half_height = libm::tan(pose.fov_degrees.to_radians() * 0.5);
    let pixel = 2.0 * half_height / f64::from(SIZE) * ahead.length();
    std::array::from_fn(|k| {
        let angle = (k as f64 + 0.3) * std::f64::consts::TAU / 8.0;
        let turn = (right * libm::cos(angle) + up * libm::sin(angle)) * (pixel * TURN);
        CameraPose { target: pose.target + turn, ..*pose }
    })
}

fn by_oracle(oracle: &Oracle, pose: &CameraPose) -> OracleImage {
    let view =
        View { pose: *pose, width: SIZE, height: SIZE, samples: 1, depth: DEPTH, min_weight: 1.0 / 512.0 };
    view.check().expect("a usable view");
    oracle.render(&view, |_| ())
}

fn by_kernel(scene: &Scene, pose: &CameraPose, without: Without) -> OracleImage {
    let options = PrepareOptions {
        plain: Plain { positions: true, normals: true, uvs: true },
        without,
        ..PrepareOptions::default()
    };
    let prepared = prepare_scene(scene.clone(), &options, Duration::ZERO).expect("it packs");
    let params = FrameParams {
        camera: pose.to_local(&prepared.pack.frame(), SIZE, SIZE).expect("a usable pose"),
        width: SIZE,
        height: SIZE,
        samples: 1,
        sampling: Sampling::default(),
        max_depth: DEPTH,
        frame: 0,
        features: Features {
            shadows: !without.shadows,
            reflection: !without.reflection,
            refraction: !without.refraction,
        },
        format: PixelFormat::Layers,
    };
    let block = PixelBlock { x: 0, y: 0, width: SIZE, height: SIZE };
    let mut rows = vec![0; block.byte_len(PixelFormat::Layers)];
    Renderer::new(&prepared.pack).render_block(&params, block, &mut rows);
    OracleImage::from_layers(SIZE, SIZE, &rows).expect("whole rows")
}

fn check_generated(kind: Kind, without: &[Without]) {
    let mut scene = generate(&Recipe { kind, triangles: 5000, seed: 1 }).expect("in range");
    scene.name = kind.name().into();
    without.iter().for_each(|&without| check(&scene, without, 0));
}

const ON: Without = Without { textures: false, shadows: false, reflection: false, refraction: false };
const BARE: Without = Without { textures: true, ..ON };
const OPEN: Without = Without { shadows: true, ..ON };
const DULL: Without = Without { reflection: true, ..ON };
const OPAQUE: Without = Without { refraction: true, ..ON };

fn check_file(folder: &Path, path: &Path, coplanar: usize) {
    let options = LoadOptions { scenes_folder: Some(folder.to_owned()) };
    let mut scene = tessera_scene::load(path, &options).expect("it loads");
    scene.name = path.display().to_string();
    check(&scene, ON, coplanar);
}

#[test]
fn cornell() {
    check_generated(Kind::Cornell, &[ON, BARE, OPEN, DULL, OPAQUE]);
}

#[test]
fn hall() {
    check_generated(Kind::Hall, &[ON, BARE, OPEN, DULL, OPAQUE]);
}

#[test]
fn rooms() {
    check_generated(Kind::Rooms, &[ON, BARE, OPEN, DULL, OPAQUE]);
}

#[test]
fn plant() {
    check_generated(Kind::Plant, &[ON, BARE, OPEN, DULL, OPAQUE]);
}

#[test]
fn city() {
    check_generated(Kind::City, &[ON, BARE, OPEN, DULL, OPAQUE]);
}

#[test]
fn real_scenes() {
    let Some(folder) = scene_folder() else { return };
    for file in ["cornell_box", "bunny", "sponza"] {
        check_file(&folder, &root().join("scenes").join(file).with_extension("toml"), 0);
    }
}

#[test]
fn gltf_cases() {
    let Some(folder) = scene_folder() else { return };
    let cases = [
        "Box/glTF/Box.gltf",
        "Cameras/glTF/Cameras.gltf",
        "GlassVaseFlowers/glTF-Binary/GlassVaseFlowers.glb",
        "MeshPrimitiveModes/glTF/MeshPrimitiveModes.gltf",
        "NegativeScaleTest/glTF-Binary/NegativeScaleTest.glb",
        "OrientationTest/glTF-Binary/OrientationTest.glb",
        "SimpleMeshes/glTF/SimpleMeshes.gltf",
        "SimpleSparseAccessor/glTF/SimpleSparseAccessor.gltf",
        "TextureCoordinateTest/glTF-Binary/TextureCoordinateTest.glb",
        "TextureSettingsTest/glTF/TextureSettingsTest.gltf",
        "ToyCar/glTF/ToyCar.gltf",
        "VertexColorTest/glTF-Binary/VertexColorTest.glb",
    ];
    for case in cases {
        check_file(&folder, &folder.join("gltf_cases").join(case), 0);
    }
    // Its balls' halves and labels lie in planes that two triangles share.
    check_file(&folder, &folder.join("gltf_cases/TransmissionTest/glTF-Binary/TransmissionTest.glb"), 5);
}
