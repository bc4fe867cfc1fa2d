//! Textures, image codes, sizes of images, and kernels that must agree.

use crate::commands::check::backend::{Renders, Rounding, frame_of};
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::{exact, packs};
use tessera_master::PixelFormat;
use tessera_pack::{Environment, EnvironmentKind, ImageInput, Material, Wrap};
use tessera_whitted::stage::stages::bazaar;
use tessera_whitted::stage::{Stage, View, decode, look, unlit};
use tessera_wire::{Adaptive, Frame, Sampling, TileGrid, TileId};
use tessera_worker::Kernel;
use tessera_worker::gpu::probe::cpu_frame;

pub const CASES: &[Case] = &[
    Case {
        id: "26",
        input: "texture coordinates 0, 1, 2, just below 1, and far beyond",
        judge: "A: f64 look-ups",
        run: Run::Each(textures),
    },
    Case {
        id: "28",
        input: "images of 1 x 1, 1 x H, tiles that do not divide or exceed them",
        judge: "A: every pixel once",
        run: Run::Each(sizes),
    },
    Case {
        id: "codes",
        input: "8- and 16-bit codes of a gradient",
        judge: "D: f64, half a code",
        run: Run::Each(codes),
    },
    Case {
        id: "twins",
        input: "mirrors, glass, holes, veils and textures, 4 samples a pixel",
        judge: "I: the picture of the CPU ray by ray",
        run: Run::Each(twins),
    },
];

const SIDE: u32 = 8;

/// Texels whose red, green and blue have nothing to do with their neighbours'.
fn texels() -> Vec<u8> {
    (0..4 * SIDE * SIDE).map(|i| if i % 4 == 3 { 255 } else { (i * 37 % 256) as u8 }).collect()
}

fn textures(renders: &dyn Renders, _: Effort) -> Outcome {
    let mut findings = Vec::new();
    for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
        let (mut worst, mut pixels) = ([0.0f64; 2], 0);
        for span in [[-3.7f32, 12.2], [0.0, 1.0], [1.0f32.next_down(), 2.0]] {
            let mut stage = Stage::default();
            stage.input.textures = vec![ImageInput {
                width: SIDE,
                height: SIDE,
                rgba: texels().into(),
                wrap_s: wrap,
                wrap_t: wrap,
                ..ImageInput::default()
            }];
            let material = Material { base_texture: 0, ..unlit([1.0; 3]) };
            stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], material);
            for uv in stage.input.uvs.iter_mut().flatten() {
                *uv = span[0] + (span[1] - span[0]) * *uv;
            }
            // The pixels look at 2 x 2 tan 25 degrees, less than the square, straight on.
            let view = look([0.0, 0.0, 2.0], [0.0; 3]).sized(96, 96);
            let half = 2.0 * libm::tan(25f64.to_radians());
            for (pack, worst) in packs(&stage)?.iter().zip(&mut worst) {
                for (i, pixel) in renders.layers(pack, &view)?.iter().enumerate() {
                    let across = |k: usize| (k as f64 + 0.5) / 48.0 - 1.0;
                    let at = [half * across(i % 96), -half * across(i / 96)];
                    let uv = at.map(|x| f64::from(span[0]) + f64::from(span[1] - span[0]) * (x + 1.0) / 2.0);
                    for (got, wanted) in pixel.color.into_iter().zip(looked_up(uv, wrap)) {
                        *worst = worst.max((f64::from(got) - wanted).abs());
                    }
                    pixels += 1;
                }
            }
        }
        // Light changes by 8 a unit of texture coordinate at most, along each of two axes. Plain coordinates are off by the rounding of
        // corners up to 12.2 and of their weights, and the point by that of the ray: 16 roundoffs of 12.2, and those of colours. Packed
        // ones by 2^-16 besides, and by half a voxel.
        let rounding = 16.0 * (16.0 * 12.2 + 4.0) / 16_777_216.0;
        let [packed, plain] = worst;
        findings.push(Finding::within(&format!("{wrap:?}: light off"), plain, rounding));
        findings.push(Finding::within(
            "packed",
            packed,
            rounding + 16.0 * (1.0 / 65_536.0 + 1.0 / 1_048_576.0),
        ));
        findings.push(Finding::at_least("pixels", pixels, 50_000));
    }
    Ok(Finding::all(findings))
}

/// Linear light at texture coordinates, blended between the centres of four texels.
fn looked_up(uv: [f64; 2], wrap: Wrap) -> [f64; 3] {
    let size = f64::from(SIDE);
    let fold = |i: f64| -> usize {
        let i = match wrap {
            Wrap::Repeat => i.rem_euclid(size),
            Wrap::Mirror => {
                let i = i.rem_euclid(2.0 * size);
                if i < size { i } else { 2.0 * size - 1.0 - i }
            }
            Wrap::Clamp => i.clamp(0.0, size - 1.0),
        };
        i as usize
    };
    let texels = texels();
    let [x, y] = uv.map(|u| u * size - 0.5);
    let (left, top) = (x.floor(), y.floor());
    std::array::from_fn(|channel| {
        let light = |i: f64, j: f64| {
            linear(f64::from(texels[4 * (fold(j) * SIDE as usize + fold(i)) + channel]) / 255.0)
        };
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let row = |j: f64| mix(light(left, j), light(left + 1.0, j), x - left);
        mix(row(top), row(top + 1.0), y - top)
    })
}

/// IEC 61966-2-1.
fn linear(code: f64) -> f64 {
    if code <= 0.040_45 { code / 12.92 } else { libm::pow((code + 0.055) / 1.055, 2.4) }
}

fn sizes(renders: &dyn Renders, _: Effort) -> Outcome {
    let mut uncovered = 0;
    let grids = [(1, 1, 128), (1, 97, 16), (97, 1, 16), (100, 70, 32), (33, 21, 64), (64, 64, 1)];
    for (width, height, tile) in grids {
        let grid = TileGrid::new(width, height, tile).map_err(|e| e.to_string())?;
        let mut count = vec![0u32; (width * height) as usize];
        for rect in (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile))) {
            for y in rect.y..rect.y + rect.height {
                for x in rect.x..rect.x + rect.width {
                    count[(y * width + x) as usize] += 1;
                }
            }
        }
        uncovered += count.iter().filter(|n| **n != 1).count();
    }
    let pack = exact(&bazaar())?;
    let (mut differ, mut pixels, mut stopped) = (0, 0, 0);
    // Each picture as one tile, and cut; in the last one blocks of pixels decide about their samples, and the image's edges cut them.
    let whole_and_cut = |(width, height, tile), sampling: Sampling| -> Result<[Vec<u8>; 2], String> {
        let samples = if sampling.adaptive.is_some() { 64 } else { 1 };
        let view = View { samples, ..look([0.3, 0.6, 5.0], [0.0; 3]).sized(width, height) };
        // A side that is a whole number of blocks, as adaptive sampling asks for.
        let whole = width.max(height).next_multiple_of(Adaptive::BLOCK);
        let frame = Frame { sampling, tile: whole, ..frame_of(&pack, &view, PixelFormat::Rgba8, 0)? };
        let cut = Frame { tile, ..frame };
        cut.check().map_err(|e| e.to_string())?;
        Ok([renders.frame(&pack, &frame)?, renders.frame(&pack, &cut)?])
    };
    let adaptive = Sampling { adaptive: Some(Adaptive { error: 0.02 }), ..Sampling::default() };
    let sizes = [(1, 1, 8), (1, 45, 8), (45, 1, 8), (45, 31, 7), (20, 20, 64)];
    let all = sizes.map(|size| (size, Sampling::default())).into_iter().chain([((70, 45, 32), adaptive)]);
    for ((width, height, tile), sampling) in all {
        let [whole, cut] = whole_and_cut((width, height, tile), sampling)?;
        differ += whole.chunks(4).zip(cut.chunks(4)).filter(|(a, b)| a != b).count();
        differ += whole.len().abs_diff((width * height * 4) as usize) + cut.len().abs_diff(whole.len());
        pixels += (width * height) as usize;
        if sampling.adaptive.is_some() {
            // It has decided something: with all samples everywhere the picture is another.
            let view = View { samples: 64, ..look([0.3, 0.6, 5.0], [0.0; 3]).sized(width, height) };
            let full = renders.bytes(&pack, &view, PixelFormat::Rgba8)?;
            stopped += whole.chunks(4).zip(full.chunks(4)).filter(|(a, b)| a != b).count();
        }
    }
    Ok(Finding::all([
        Finding::none(uncovered, grids.len(), "pixels not covered once in grids"),
        Finding::none(differ, pixels, "pixels depend on the tiles"),
        Finding::at_least("pixels of less samples", stopped, 1),
    ]))
}

fn codes(renders: &dyn Renders, _: Effort) -> Outcome {
    // Nothing but a sky, brighter upward.
    let mut stage = Stage::default();
    stage.input.environment = Environment {
        kind: EnvironmentKind::Gradient as u32,
        zenith: [1.2, 0.9, 0.3],
        horizon: [0.4, 0.2, 0.05],
        nadir: [0.001, 0.0, 0.02],
        ..Environment::default()
    };
    let pack = exact(&stage)?;
    let mut view = look([0.0; 3], [1.0, 0.2, 0.0]).sized(64, 256);
    view.pose.fov_degrees = 130.0;
    let light = renders.layers(&pack, &view)?;
    let mut findings = Vec::new();
    for (format, bits, peak) in
        [(PixelFormat::Rgba8, "8-bit", 255.0), (PixelFormat::Rgba16, "16-bit", 65_535.0)]
    {
        let bytes = renders.bytes(&pack, &view, format)?;
        let codes: Vec<f64> = match format {
            PixelFormat::Rgba16 => {
                bytes.chunks_exact(2).map(|b| f64::from(u16::from_le_bytes([b[0], b[1]]))).collect()
            }
            _ => bytes.iter().copied().map(f64::from).collect(),
        };
        let mut worst = 0.0f64;
        for (pixel, codes) in light.iter().zip(codes.chunks_exact(4)) {
            for (light, code) in pixel.color.into_iter().zip(codes) {
                let light = f64::from(light).clamp(0.0, 1.0);
                let curve = if light <= 0.003_130_8 {
                    12.92 * light
                } else {
                    1.055 * libm::pow(light, 1.0 / 2.4) - 0.055
                };
                worst = worst.max((code - curve * peak).abs());
            }
        }
        // Half a code, and the error of the curve: 1e-14 in f64 (color.rs), in f32 a few roundoffs of 1 (color.wgsl).
        let curve = if renders.is_exact() { 1e-9 } else { 16.0 / 16_777_216.0 * peak };
        findings.push(Finding::within(&format!("{bits}: codes off"), worst, 0.5 + curve));
    }
    Ok(Finding::all(findings))
}

fn twins(renders: &dyn Renders, effort: Effort) -> Outcome {
    let pack = exact(&bazaar())?;
    let side = effort.pick(128, 256);
    let view = View { samples: 4, ..look([0.3, 0.6, 5.0], [0.0; 3]).sized(side, side) };
    let frame = frame_of(&pack, &view, PixelFormat::Layers, 7)?;
    let (own, _) = cpu_frame(&pack, Kernel::Scalar, &frame);
    let others = renders.frame(&pack, &frame)?;
    if others.len() != own.len() {
        return Err(format!("{} bytes instead of {}", others.len(), own.len()));
    }
    let (own, others) = (decode(&own), decode(&others));
    let differ = own.iter().zip(&others).filter(|(a, b)| a != b).count();
    if renders.is_exact() {
        return Ok(Finding::none(differ, own.len(), "pixels differ"));
    }
    // Fused and inexact operations show in the last digits: forty of 2.5 u on each of a dozen surfaces are 7e-5 of a light of 1, a tenth of what
    // counts as far. Without f64 they also decide single paths at edges; that these are below a hundredth is chosen, not derived.
    let far = own
        .iter()
        .zip(&others)
        .filter(|(a, b)| a.color.iter().zip(b.color).any(|(a, b)| (a - b).abs() > 1e-3));
    let allowed = if renders.rounding() == Rounding::Single { 0.01 } else { 0.0 };
    Ok(Finding::within(
        "share of pixels that differ by 0.001",
        far.count() as f64 / own.len() as f64,
        allowed,
    ))
}
