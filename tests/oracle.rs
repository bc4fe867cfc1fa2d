//! The fast kernels, on packs with plain vertices, held to the `f64` oracle over the original scene.
//!
//! What may differ: which triangle a ray meets, and what is seen behind it, where the ray passes an edge (of a triangle, a shadow, a
//! mirrored thing, a texel) within the rounding of `f32`. So a pixel is explained when the oracle itself comes to the kernel's value for
//! a ray that is a little turned: [`TURN`] of a pixel.

use crate::support::{root, scene_folder};
use std::time::Duration;
use tessera_geometry::CameraPose;
use tessera_master::prepare::{PrepareOptions, prepare_scene};
use tessera_oracle::{Oracle, OracleImage, View};
use tessera_pack::Plain;
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_scene::{LoadOptions, Scene, Without};
use tessera_whitted::{Features, FrameParams, PixelBlock, PixelFormat, Renderer};

const SIZE: u32 = 96;
const DEPTH: u32 = 5;

/// Of a pixel.
const TURN: f64 = 1.0 / 128.0;

fn check(scene: &Scene, without: Without) {
    let pose = scene.cameras[0].pose;
    let kernel = by_kernel(scene, &pose, without);
    let oracle = Oracle::new(scene, without).expect("a sound scene");
    let start = std::time::Instant::now();
    let truth = by_oracle(&oracle, &pose);
    let time = start.elapsed();
    let right = (pose.target - pose.eye).cross(pose.up).normalize();
    let up = right.cross(pose.target - pose.eye).normalize();
    let pixel = 2.0 * libm::tan(pose.fov_degrees.to_radians() * 0.5) / f64::from(SIZE)
        * (pose.target - pose.eye).length();
    let near: Vec<OracleImage> = [
        (1.0, 0.3),
        (-1.0, -0.3),
        (0.3, -1.0),
        (-0.3, 1.0),
        (1.0, -0.8),
        (-0.8, 1.0),
        (0.4, 0.4),
        (-0.4, -0.4),
    ]
    .into_iter()
    .map(|(x, y)| {
        let turn = (right * x + up * y) * (pixel * TURN);
        by_oracle(&oracle, &CameraPose { target: pose.target + turn, ..pose })
    })
    .collect();

    let (mut wrong, mut wrong_unexplained, mut off, mut off_unexplained) = (0, 0, 0, 0);
    let mut worst = 0.0_f64;
    let mut lines = Vec::new();
    for k in 0..truth.id.len() {
        let (x, y) = (k as u32 % SIZE, k as u32 / SIZE);
        if kernel.id[k] != truth.id[k] {
            wrong += 1;
            if !near.iter().any(|image| image.id[k] == kernel.id[k]) {
                wrong_unexplained += 1;
                lines.push(format!(
                    "  id {x},{y}: {} for {} at {} {}",
                    kernel.id[k] as i32, truth.id[k] as i32, kernel.depth[k], truth.depth[k]
                ));
            }
            continue;
        }
        let difference = |c: usize| (kernel.color[k][c] - truth.color[k][c]).abs();
        let tolerance = |c: usize| 1e-4 * truth.color[k][c].abs() + 1e-5;
        let d = (0..4).map(difference).fold(0.0, f64::max);
        if (0..4).all(|c| difference(c) <= tolerance(c)) {
            worst = worst.max(d);
            continue;
        }
        off += 1;
        let is_within = |c: usize| {
            let all = near.iter().chain([&truth]).map(|image| image.color[k][c]);
            let (low, high) = all.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
            (low - tolerance(c)..=high + tolerance(c)).contains(&kernel.color[k][c])
        };
        if !(0..4).all(is_within) {
            off_unexplained += 1;
            lines.push(format!(
                "  color {x},{y}: id {} {:?} for {:?}",
                truth.id[k] as i32, kernel.color[k], truth.color[k]
            ));
        }
    }
    println!(
        "{:40} {:7} triangles {without:?}: wrong {wrong} ({wrong_unexplained}) off {off} ({off_unexplained}) worst {worst:.2e}; {:.2} s, {} rays",
        scene.name,
        oracle.triangles(),
        time.as_secs_f64(),
        truth.rays.total()
    );
    for line in lines.iter().take(12) {
        println!("{line}");
    }
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

fn all_without() -> [Without; 5] {
    let on = Without::default();
    [
        on,
        Without { textures: true, ..on },
        Without { shadows: true, ..on },
        Without { reflection: true, ..on },
        Without { refraction: true, ..on },
    ]
}

#[test]
fn generated_scenes() {
    for kind in Kind::ALL {
        let mut scene = generate(&Recipe { kind, triangles: 5000, seed: 1 }).expect("in range");
        scene.name = kind.name().into();
        for without in all_without() {
            check(&scene, without);
        }
    }
}

#[test]
fn real_scenes() {
    let Some(folder) = scene_folder() else { return };
    let options = LoadOptions { scenes_folder: Some(folder.clone()) };
    for path in ["cornell_box.toml", "bunny.toml", "spaceship.toml", "sponza.toml"] {
        let mut scene = tessera_scene::load(&root().join("scenes").join(path), &options).expect("it loads");
        scene.name = path.into();
        check(&scene, Without::default());
    }
    for case in std::fs::read_dir(folder.join("gltf_cases")).expect("a folder") {
        let case = case.expect("an entry").path();
        for kind in ["glTF", "glTF-Binary"] {
            let Ok(files) = std::fs::read_dir(case.join(kind)) else { continue };
            for file in files {
                let file = file.expect("an entry").path();
                if file.extension().is_some_and(|e| e == "gltf" || e == "glb") {
                    let mut scene = tessera_scene::load(&file, &options).expect("it loads");
                    scene.name = file.file_name().unwrap().to_string_lossy().into_owned();
                    check(&scene, Without::default());
                }
            }
        }
    }
}
