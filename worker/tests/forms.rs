//! What a ray remembers of its way, and in which order rays are taken, changes no byte of a picture.
//!
//! `TESSERA_GPU=require` fails without an adapter, `off` skips aloud, `allow` (the default) skips aloud where there is none.

use tessera_geometry::{CameraPose, DVec3};
use tessera_kdtree::Kernel;
use tessera_pack::{
    Environment, EnvironmentKind, ImageInput, Light, LightKind, Material, MaterialFlags, Pack, PackInput,
    PackOptions, build_pack,
};
use tessera_wire::{
    Adaptive, Camera, Frame, FrameId, PackId, PixelFormat, Rays, ReturnMode, Sampler, Sampling,
};
use tessera_worker::gpu::probe::{GpuProbe, cpu_frame};
use tessera_worker::gpu::{GpuOptions, TestPolicy, TraversalForm};

/// A probe for each form, or none where nothing is to be tested.
fn probes() -> Option<[GpuProbe; 3]> {
    let policy = TestPolicy::from_env().expect("a known policy");
    let open = |form| policy.open(GpuOptions { form, ..GpuOptions::default() }).expect("a GPU is required");
    match TraversalForm::ALL.map(open) {
        [Some(a), Some(b), Some(c)] => Some([a, b, c]),
        _ => None,
    }
}

/// A floor under panes, a mirror, balls of glass, a blended and a masked screen, with two lights; every kind of ray is asked for.
fn scene() -> Pack {
    let mut input = PackInput::default();
    let mut quad = |corner: [f64; 3], u: [f64; 3], v: [f64; 3], material: Material| {
        let first = input.positions.len() as u32;
        let index = input.materials.iter().position(|m| *m == material).unwrap_or_else(|| {
            input.materials.push(material);
            input.materials.len() - 1
        });
        input.material_runs.push((input.triangles.len() as u32, index as u32));
        input.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        let (o, u, v) = (DVec3::from(corner), DVec3::from(u), DVec3::from(v));
        input.positions.extend([o, o + u, o + u + v, o + v].map(|p| p.to_array()));
        input.normals.extend([[0.0; 3]; 4]);
        input.uvs.extend([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]]);
        input.colors.extend([[255; 4]; 4]);
    };
    let plain = Material::default();
    let with_flag = |flag| plain.flags | flag;
    let mirror = Material { base_color: [0.9, 0.8, 0.7, 1.0], metallic: 1.0, roughness: 0.0, ..plain };
    let glass =
        Material { base_color: [0.8, 1.0, 0.9, 1.0], roughness: 0.0, transmission: 1.0, ior: 1.5, ..plain };
    let pane = Material { flags: with_flag(MaterialFlags::THIN_WALLED), ..glass };
    let blended =
        Material { base_color: [0.9, 0.2, 0.1, 0.4], flags: with_flag(MaterialFlags::ALPHA_BLEND), ..plain };
    let masked = Material { base_texture: 0, flags: with_flag(MaterialFlags::ALPHA_MASK), ..plain };
    let one_sided = Material { flags: plain.flags & !MaterialFlags::DOUBLE_SIDED, ..plain };
    quad([-6.0, 0.0, -6.0], [0.0, 0.0, 12.0], [12.0, 0.0, 0.0], Material { roughness: 0.2, ..plain });
    quad([-6.0, 0.0, -6.0], [12.0, 0.0, 0.0], [0.0, 6.0, 0.0], mirror);
    quad([6.0, 0.0, 6.0], [-12.0, 0.0, 0.0], [0.0, 6.0, 0.0], mirror);
    quad([-3.0, 0.0, -2.0], [2.5, 0.0, 0.5], [0.0, 3.0, 0.0], masked);
    quad([0.5, 0.0, -2.5], [2.5, 0.0, 0.0], [0.0, 3.0, 0.3], blended);
    quad([0.0, 0.2, 1.5], [2.0, 0.0, 0.0], [0.0, 2.5, 0.0], pane);
    quad([-2.5, 0.5, 2.0], [1.5, 0.0, 0.2], [0.0, 2.0, 0.0], blended);
    quad([-4.0, 3.0, -4.0], [0.0, 0.0, 3.0], [3.0, 0.0, 0.0], one_sided);
    // A block of glass, and one within it.
    for (low, high) in [(-1.0, 1.0), (-0.4, 0.4)] {
        let side = high - low;
        let [x, y, z] = [[side, 0.0, 0.0], [0.0, side, 0.0], [0.0, 0.0, side]];
        let at = |x: f64, y: f64, z: f64| [x, y + 1.2, z];
        for (corner, u, v) in [
            (at(low, low, low), z, y),
            (at(low, low, low), x, z),
            (at(low, low, low), y, x),
            (at(high, low, low), y, z),
            (at(low, high, low), z, x),
            (at(low, low, high), x, y),
        ] {
            quad(corner, u, v, glass);
        }
    }
    let texel = |is_solid: bool| if is_solid { [200, 220, 90, 255] } else { [0; 4] };
    input.textures.push(ImageInput {
        name: "holes".into(),
        width: 2,
        height: 2,
        rgba: [true, false, false, true].map(texel).as_flattened().into(),
        ..ImageInput::default()
    });
    for (position, intensity) in [([2.0, 5.0, 3.0], 60.0), ([-3.0, 4.0, -1.0], 30.0)] {
        input.lights.push(Light {
            position,
            kind: LightKind::Point as u32,
            direction: [0.0, -1.0, 0.0],
            range: f32::INFINITY,
            intensity: [intensity; 3],
            cos_inner: 1.0,
            cos_outer: 0.0,
            reserved: [0; 3],
        });
    }
    input.environment = Environment {
        kind: EnvironmentKind::Gradient as u32,
        zenith: [0.2, 0.4, 0.9],
        horizon: [0.8, 0.8, 0.7],
        nadir: [0.1; 3],
        ..Environment::default()
    };
    input.ambient.radiance = [0.05; 3];
    build_pack(input, &PackOptions::default()).expect("a packable scene").0
}

/// A view of `scene` past everything that is in it.
fn frame(
    pack: &Pack,
    (width, height): (u32, u32),
    (samples, sampling): (u32, Sampling),
    format: PixelFormat,
) -> Frame {
    let pose = CameraPose {
        eye: DVec3::new(0.5, 2.0, 5.5),
        target: DVec3::new(0.0, 1.2, 0.0),
        up: CameraPose::DEFAULT_UP,
        fov_degrees: 60.0,
    };
    let camera = pose.to_local(&pack.frame(), width, height).expect("a usable pose");
    Frame {
        frame: FrameId(1),
        pack: PackId(pack.id().0),
        camera: Camera {
            origin: camera.origin.into(),
            forward: camera.forward.into(),
            right: camera.right.into(),
            up: camera.up.into(),
        },
        width,
        height,
        tile: 48,
        samples,
        sampling,
        depth: 6,
        seed: 7,
        features: Default::default(),
        format,
        returns: ReturnMode::AtEnd,
        coding: tessera_wire::Coding::Raw,
    }
}

#[test]
fn all_forms_render_the_same_bytes() {
    let Some(probes) = probes() else { return };
    let pack = scene();
    let f64 = probes[0].uses_f64();
    let scenes = probes.map(|probe| probe.load(&pack).expect("a scene that fits"));
    // Tiles together in a submission; more pixels than paths are under way on a software driver; edges that cut blocks; fewer pixels
    // than a block. By either sampler, with all weights, and in rounds.
    let usual = Sampling::default();
    let sobol = Sampling { sampler: Sampler::LowDiscrepancy, ..usual };
    let adaptive = Some(Adaptive { error: 0.03 });
    for (size, samples, sampling, format) in [
        ((131, 70), 3, usual, PixelFormat::Rgba8),
        ((37, 21), 4, sobol, PixelFormat::Layers),
        ((64, 40), 1, usual, PixelFormat::Rgba16),
        ((9, 7), 1, Sampling { cutoff: 0.0, ..usual }, PixelFormat::Rgba16),
        ((3, 2), 9, Sampling { cutoff: 0.2, ..usual }, PixelFormat::Layers),
        ((60, 37), 40, Sampling { adaptive, ..sobol }, PixelFormat::Rgba8),
        ((35, 20), 40, Sampling { adaptive, ..usual }, PixelFormat::Layers),
    ] {
        let frame = frame(&pack, size, (samples, sampling), format);
        let [whole, short, waves]: [(Vec<u8>, Rays); 3] =
            scenes.each_ref().map(|scene| scene.frame(&frame).expect("a frame"));
        let Rays { shadow, reflection, refraction, .. } = whole.1;
        assert!(shadow > 0 && reflection > 0 && refraction > 0, "the scene asks for every kind of ray");
        // Where all is computed in f64 that decides, the CPU traces the same rays, and blocks end with the same rounds. A distance or a
        // colour may be a roundoff off, which no code of 8 bits shows.
        if f64 {
            let (bytes, rays) = cpu_frame(&pack, Kernel::default(), &frame);
            assert_eq!(
                whole.1, rays,
                "the CPU: rays of {size:?}, {samples} samples, {sampling:?}, {format:?}"
            );
            assert!(format != PixelFormat::Rgba8 || whole.0 == bytes, "the CPU: bytes of {sampling:?}");
        }
        for (name, other) in [("a short stack", short), ("waves", waves)] {
            assert_eq!(
                whole.1, other.1,
                "{name}: rays of {size:?}, {samples} samples, {sampling:?}, {format:?}"
            );
            let differ = whole.0.iter().zip(&other.0).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "{name}: bytes of {size:?}, {samples} samples, {sampling:?}, {format:?}");
        }
    }
}
