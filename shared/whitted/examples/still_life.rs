//! Renders a mirror ball, a glass ball, a pane, a veil and a cut-out on a chequered floor, to look at.
//!
//! `cargo run --release -p tessera-whitted --example still_life -- FILE.png [SIZE [SAMPLES]]`

use std::time::Instant;
use tessera_pack::{
    Environment, EnvironmentKind, ImageInput, Light, LightKind, Material, MaterialFlags, Plain,
};
use tessera_whitted::PixelFormat;
use tessera_whitted::stage::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let file = args.next().ok_or("give the name of the PNG file to write")?;
    let size = args.next().map_or(Ok(800), |s| s.parse())?;
    let samples = args.next().map_or(Ok(4), |s| s.parse())?;

    let pack = still_life().pack_with(Plain::default())?;
    let mut view = View { samples, ..look([2.2, 2.1, 6.4], [0.0, 0.55, 0.0]).sized(size, size * 3 / 4) };
    view.pose.fov_degrees = 38.0;
    let start = Instant::now();
    let (bytes, rays) = view.bytes(&pack, PixelFormat::Rgba8);
    let seconds = start.elapsed().as_secs_f64();
    let total = rays.primary + rays.shadow + rays.reflection + rays.refraction;
    println!("{} triangles, {rays:?}", pack.triangle_count());
    println!("{seconds:.2} s on one core, {:.2} million rays a second", total as f64 / seconds * 1e-6);
    image::save_buffer(&file, &bytes, size, size * 3 / 4, image::ColorType::Rgba8)?;
    Ok(())
}

fn still_life() -> Stage {
    let mut stage = Stage::default();
    let cell = |x: u32, y: u32| if (x ^ y) & 1 == 0 { [225, 215, 195, 255] } else { [60, 70, 90, 255] };
    let disc = |x: u32, y: u32| {
        let (dx, dy) = (f64::from(x) - 31.5, f64::from(y) - 31.5);
        [200, 120, 40, if (dx * dx + dy * dy).sqrt() < 20.0 { 0 } else { 255 }]
    };
    let picture = |size: u32, texel: &dyn Fn(u32, u32) -> [u8; 4], nearest| ImageInput {
        name: "made".into(),
        width: size,
        height: size,
        rgba: (0..size * size).flat_map(|i| texel(i % size, i / size)).collect(),
        nearest,
        ..ImageInput::default()
    };
    stage.input.textures = vec![picture(16, &cell, true), picture(64, &disc, false)];

    let floor = Material { base_texture: 0, ..chalk() };
    stage.quad([-6.0, 0.0, -6.0], [0.0, 0.0, 12.0], [12.0, 0.0, 0.0], floor);
    let red = Material { base_color: [0.6, 0.08, 0.06, 1.0], roughness: 0.3, ..Material::default() };
    stage.ball([-0.1, 0.4, 1.0], 0.4, 48, red);
    stage.ball([-1.4, 0.9, -0.6], 0.9, 64, mirror(0.92));
    stage.ball([1.0, 0.8, 0.2], 0.8, 64, Material { base_color: [0.9, 1.0, 0.95, 1.0], ..glass(1.5) });
    let gold = Material { base_color: [0.95, 0.7, 0.3, 1.0], roughness: 0.25, ..mirror(0.9) };
    stage.cuboid([-0.2, 0.0, -2.4], [0.8, 1.5, -1.6], gold);
    let pane =
        Material { flags: MaterialFlags::THIN_WALLED, base_color: [0.7, 0.85, 1.0, 1.0], ..glass(1.5) };
    stage.quad([1.7, 0.0, -1.2], [1.0, 0.0, 0.8], [0.0, 1.4, 0.0], pane);
    let veil = Material { base_color: [0.2, 0.7, 0.2, 0.5], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    stage.quad([-2.6, 0.0, 1.0], [0.9, 0.0, 0.4], [0.0, 0.9, 0.0], veil);
    let cut = Material { base_texture: 1, flags: MaterialFlags::ALPHA_MASK, ..chalk() };
    stage.quad([0.7, 0.0, 1.6], [0.8, 0.0, 0.2], [0.0, 0.8, 0.0], cut);

    stage.light(point_light([3.0, 4.5, 3.0], 70.0));
    stage.light(Light {
        kind: LightKind::Spot as u32,
        direction: [0.6, -0.8, 0.0],
        cos_inner: 0.97,
        cos_outer: 0.93,
        ..point_light([-4.0, 4.0, 0.5], 60.0)
    });
    stage.input.ambient.radiance = [0.08; 3];
    stage.input.environment = Environment {
        kind: EnvironmentKind::Gradient as u32,
        zenith: [0.15, 0.3, 0.7],
        horizon: [0.7, 0.8, 0.9],
        nadir: [0.2; 3],
        ..Environment::default()
    };
    stage
}
