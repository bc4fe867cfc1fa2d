//! What a kernel leaves out changes no picture: the GPU's twin of the tests of `tessera_whitted::variant`.

use crate::stage::{Stage, chalk, glass, look, mirror, one_sided, point_light};
use crate::support::gpu;
use tessera_master::FrameJob;
use tessera_pack::{Forced, ImageInput, Material, MaterialFlags, Pack, PackOptions, build_pack};
use tessera_whitted::PixelFormat;
use tessera_whitted::variant::{Part, Variant};
use tessera_wire::{Frame, FrameId, PackId};
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::GpuProbe;

const SIDE: u32 = 32;

/// A floor of `floor` under a ball of `ball`.
fn scene(floor: Material, ball: Material) -> Pack {
    stage(floor, ball).pack()
}

fn stage(floor: Material, ball: Material) -> Stage {
    let mut stage = Stage::default();
    let rgba = (0..64).map(|i| (i * 37 % 256) as u8).collect();
    stage.input.textures = vec![ImageInput { width: 4, height: 4, rgba, ..ImageInput::default() }];
    stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], floor);
    stage.ball([0.0; 3], 0.9, 6, ball);
    stage.light(point_light([1.0, 2.5, 2.0], 20.0));
    stage
}

fn frame(pack: &Pack) -> Frame {
    frame_as(pack, PixelFormat::Rgba8)
}

fn frame_as(pack: &Pack, format: PixelFormat) -> Frame {
    let params = look([0.3, 0.6, 5.0], [0.0; 3]).sized(SIDE, SIDE).params(pack, format);
    let job = FrameJob {
        tile: SIDE,
        format: match format {
            PixelFormat::Rgba8 => tessera_wire::PixelFormat::Rgba8,
            PixelFormat::Rgba16 => tessera_wire::PixelFormat::Rgba16,
            PixelFormat::Layers => tessera_wire::PixelFormat::Layers,
        },
        ..FrameJob::new(params.camera, SIDE, SIDE)
    };
    job.to_wire(FrameId(1), PackId(pack.id().0))
}

#[test]
fn a_kernel_with_everything_renders_the_same_picture() {
    let Some(lean) = gpu() else { return };
    let full = lean.with(GpuOptions { lean: false, ..GpuOptions::default() });
    let mask = Material { base_texture: 0, flags: MaterialFlags::ALPHA_MASK, ..chalk() };
    let veil = Material {
        base_color: [0.2, 0.5, 0.9, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    for (floor, ball) in
        [(chalk(), chalk()), (mask, one_sided(chalk())), (mirror(0.8), veil), (chalk(), glass(1.5))]
    {
        let pack = scene(floor, ball);
        let name = Variant::of(&pack).name();
        let render = |gpu: &GpuProbe| gpu.load(&pack).and_then(|scene| scene.frame(&frame(&pack)));
        let (of, everything) = (render(&lean).expect("a frame"), render(&full).expect("a frame"));
        assert_eq!(of.1, everything.1, "{name}: rays");
        assert!(of.0 == everything.0, "{name}: the pictures differ");
        assert!(of.0.chunks_exact(4).any(|pixel| pixel != &of.0[..4]), "{name}: the picture is empty");
    }
}

#[test]
fn a_part_that_is_forced_in_changes_no_bit_of_the_picture() {
    let Some(lean) = gpu() else { return };
    let veil = Material {
        base_color: [0.2, 0.5, 0.9, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    let textured = Material { base_texture: 0, ..chalk() };
    // Flat and opaque, of one material; without mirrors; with nearly everything.
    let sheet = |stage: &mut Stage| stage.quad([-1.0, -1.0, 0.0], [2.0, 0.5, 0.3], [0.0, 2.0, 0.0], chalk());
    let mut flat = Stage::default();
    flat.light(point_light([1.0, 2.5, 2.0], 20.0));
    sheet(&mut flat);
    for stage in [flat, stage(textured, veil), stage(mirror(0.8), glass(1.5))] {
        let pack = |forced| {
            let options = PackOptions { forced, ..PackOptions::default() };
            build_pack(stage.input.clone(), &options).expect("a packable scene").0
        };
        let thin = pack(None);
        let variant = Variant::of(&thin);
        let frames = |gpu: &GpuProbe, pack: &Pack| {
            let scene = gpu.load(pack).expect("the GPU holds the scene");
            let formats = [PixelFormat::Rgba8, PixelFormat::Rgba16, PixelFormat::Layers];
            formats.map(|format| scene.frame(&frame_as(pack, format)).expect("a frame"))
        };
        let expected = frames(&lean, &thin);
        for part in Part::ALL.into_iter().filter(|&part| variant.with(part) != variant) {
            let full = lean.with(GpuOptions { forced: Some(part), ..GpuOptions::default() });
            assert!(frames(&full, &thin) == expected, "{}: {} in the kernel", variant.name(), part.name());
        }
        for forced in Forced::ALL {
            let full = pack(Some(forced));
            if full.id() != thin.id() {
                assert!(
                    frames(&lean, &full) == expected,
                    "{}: {} in the pack",
                    variant.name(),
                    forced.name()
                );
            }
        }
    }
}
