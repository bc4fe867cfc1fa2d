//! What a kernel leaves out changes no picture: the GPU's twin of the tests of `tessera_whitted::variant`.

use crate::stage::{Stage, chalk, glass, look, mirror, one_sided, point_light};
use crate::support::gpu;
use tessera_master::{Balance, FrameJob};
use tessera_pack::{ImageInput, Material, MaterialFlags, Pack};
use tessera_whitted::PixelFormat;
use tessera_whitted::variant::Variant;
use tessera_wire::{Features, Frame, FrameId, PackId};
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::GpuProbe;

const SIDE: u32 = 32;

/// A floor of `floor` under a ball of `ball`.
fn scene(floor: Material, ball: Material) -> Pack {
    let mut stage = Stage::default();
    let rgba = (0..64).map(|i| (i * 37 % 256) as u8).collect();
    stage.input.textures = vec![ImageInput { width: 4, height: 4, rgba, ..ImageInput::default() }];
    stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], floor);
    stage.ball([0.0; 3], 0.9, 6, ball);
    stage.light(point_light([1.0, 2.5, 2.0], 20.0));
    stage.pack()
}

fn frame(pack: &Pack) -> Frame {
    let params = look([0.3, 0.6, 5.0], [0.0; 3]).sized(SIDE, SIDE).params(pack, PixelFormat::Rgba8);
    let job = FrameJob {
        camera: params.camera,
        width: SIDE,
        height: SIDE,
        tile: SIDE,
        samples: 1,
        sampling: Default::default(),
        depth: 8,
        seed: 0,
        features: Features::default(),
        format: tessera_wire::PixelFormat::Rgba8,
        balance: Balance::default(),
        mix: false,
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
