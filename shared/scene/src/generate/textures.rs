//! Images made by rule, `size` texels a side. All of them tile without a seam; colours are sRGB-coded.

use super::rng::split_mix;
use crate::Image;
use std::f64::consts::{PI, TAU};

/// sRGB-coded, each in [0, 1].
type Color = [f64; 3];

/// Pale or dark marble: `ground` with veins of `vein`.
pub(super) fn marble(name: &str, size: u32, ground: Color, vein: Color, seed: u64) -> Image {
    paint(name, size, |u, v| {
        let bend = fbm(u, v, 4, 5, seed) - 0.5;
        let fine = fbm(u, v, 16, 3, seed ^ 1) - 0.5;
        // Whole numbers of waves along both sides, so that the picture tiles.
        let wave = libm::sin(TAU * (u + 2.0 * v) + 9.0 * bend).abs();
        let thin = libm::sin(TAU * (3.0 * u - v) + 14.0 * bend).abs();
        let veins = 0.75 * libm::pow(1.0 - wave, 5.0) + 0.4 * libm::pow(1.0 - thin, 9.0);
        let cloud = 0.35 * fbm(u, v, 3, 3, seed ^ 2);
        opaque(shade(mix(ground, vein, (veins + cloud).min(1.0)), 0.12 * fine))
    })
}

/// Cut stone in courses of half an image's width, each block a little different.
pub(super) fn ashlar(name: &str, size: u32, stone: Color, joint: Color, seed: u64) -> Image {
    masonry(name, size, [stone, joint], [2, 4], 0.012, 0.10, seed)
}

/// Bricks: four along, twelve up.
pub(super) fn bricks(name: &str, size: u32, brick: Color, joint: Color, seed: u64) -> Image {
    masonry(name, size, [brick, joint], [4, 12], 0.008, 0.30, seed)
}

fn masonry(
    name: &str,
    size: u32,
    [stone, joint]: [Color; 2],
    [across, up]: [u32; 2],
    gap: f64,
    spread: f64,
    seed: u64,
) -> Image {
    paint(name, size, |u, v| {
        let row = (v * f64::from(up)).floor();
        let along = u * f64::from(across) + if row as u32 % 2 == 1 { 0.5 } else { 0.0 };
        let column = along.floor();
        let (x, y) = (along - column, v * f64::from(up) - row);
        let wobble = 0.5 * gap * (fbm(u, v, 32, 2, seed ^ 3) - 0.5);
        // Distance to the nearest joint, in parts of the image.
        let edge = (x.min(1.0 - x) / f64::from(across)).min(y.min(1.0 - y) / f64::from(up)) + wobble;
        let own = lattice_value(column as i64 % i64::from(across), row as i64, seed);
        let grain = fbm(u, v, 24, 4, seed ^ 4) - 0.5;
        let face = shade(stone, spread * (own - 0.5) + 0.22 * grain);
        opaque(mix(joint, face, smooth_step(0.5 * gap, 1.1 * gap, edge)))
    })
}

/// Planks along v, four to an image.
pub(super) fn planks(name: &str, size: u32, wood: Color, seed: u64) -> Image {
    const PLANKS: f64 = 4.0;
    paint(name, size, |u, v| {
        let plank = (u * PLANKS).floor();
        let x = u * PLANKS - plank;
        let own = lattice_value(plank as i64, 0, seed);
        let rings = fbm(u, v, 4, 4, seed ^ 5);
        // Grain: rings that run along the plank, stretched eight times.
        let grain = libm::sin(TAU * (6.0 * x + 5.0 * rings + own));
        let fibre = value_noise(u * 128.0, v * 8.0, [128, 8], seed ^ 6) - 0.5;
        let gap = smooth_step(0.0, 0.02, x.min(1.0 - x));
        opaque(shade(wood, (0.10 * grain + 0.16 * fibre + 0.25 * (own - 0.5)) * gap - 0.7 * (1.0 - gap)))
    })
}

/// A night-blue ground with gold stars in staggered rows.
pub(super) fn stars(name: &str, size: u32, ground: Color, gold: Color, seed: u64) -> Image {
    paint(name, size, |u, v| {
        let row = (v * 4.0).floor();
        let x = (u * 4.0 + if row as u32 % 2 == 1 { 0.5 } else { 0.0 }).fract() - 0.5;
        let y = v * 4.0 - row - 0.5;
        let angle = libm::atan2(x, -y);
        // Six rays: the radius falls from the tip to the notch.
        let ray = (angle * 6.0 / TAU).rem_euclid(1.0);
        let radius = 0.10 + 0.17 * libm::pow((2.0 * ray - 1.0).abs(), 1.6);
        let inside = 1.0 - smooth_step(radius - 0.02, radius + 0.02, libm::sqrt(x * x + y * y));
        let cloud = fbm(u, v, 6, 4, seed) - 0.5;
        opaque(mix(shade(ground, 0.4 * cloud), shade(gold, 0.2 * cloud), inside))
    })
}

/// A pierced screen: rings that cross, with holes between; alpha is 0 in the holes.
pub(super) fn screen(name: &str, size: u32, metal: Color, seed: u64) -> Image {
    paint(name, size, |u, v| {
        let ring = |cx: f64, cy: f64, radius: f64| {
            let (dx, dy) = (wrap_distance(u - cx), wrap_distance(v - cy));
            (libm::sqrt(dx * dx + dy * dy) - radius).abs()
        };
        // Two lattices of rings and the square grid through their middles.
        let rings = ring(0.5, 0.5, 0.36).min(ring(0.0, 0.0, 0.36)).min(ring(0.5, 0.5, 0.13));
        let bars = wrap_distance(u).abs().min(wrap_distance(v).abs());
        let solid = rings < 0.045 || bars < 0.05;
        let [r, g, b] = shade(metal, 0.3 * (fbm(u, v, 16, 3, seed) - 0.5));
        [r, g, b, if solid { 1.0 } else { 0.0 }]
    })
}

/// One leaf with its tip at the top; alpha is 0 around it.
pub(super) fn leaf(name: &str, size: u32, green: Color, vein: Color, seed: u64) -> Image {
    paint(name, size, |u, v| {
        // Half width along the leaf: widest below the middle, pointed at the tip, a stalk at the foot.
        let along = 1.0 - v;
        let half = 0.44 * libm::pow(libm::sin(PI * libm::pow(along, 0.75)).max(0.0), 0.8);
        let x = (u - 0.5).abs();
        let serrated = half * (1.0 - 0.06 * libm::sin(along * 70.0).abs());
        let solid = (along > 0.03 && along < 0.98 && x < serrated) || (along <= 0.12 && x < 0.02);
        let rib = (1.0 - smooth_step(0.0, 0.018, x))
            .max(1.0 - smooth_step(0.0, 0.09, libm::sin(PI * (along * 9.0 - x * 7.0)).abs()));
        let patch = fbm(u, v, 8, 4, seed) - 0.5;
        let [r, g, b] = mix(shade(green, 0.5 * patch), vein, 0.55 * rib);
        [r, g, b, if solid { 1.0 } else { 0.0 }]
    })
}

/// Cloth with a gold border and a diamond pattern, to be shown once over a banner.
pub(super) fn banner(name: &str, size: u32, cloth: Color, gold: Color, seed: u64) -> Image {
    paint(name, size, |u, v| {
        let edge = u.min(1.0 - u).min(0.5 * v.min(1.0 - v));
        let border = (edge > 0.045 && edge < 0.075) || (edge > 0.09 && edge < 0.10);
        let (x, y) = ((u * 4.0).fract() - 0.5, (v * 10.0).fract() - 0.5);
        let diamond = x.abs() + y.abs();
        let inner = edge > 0.13;
        let figure = inner && (diamond < 0.16 || (diamond > 0.30 && diamond < 0.34));
        let weave = 0.10 * (fbm(u, v, 96, 2, seed) - 0.5) + 0.12 * (fbm(u, v, 4, 3, seed ^ 7) - 0.5);
        opaque(shade(if border || figure { gold } else { cloth }, weave))
    })
}

fn paint(name: &str, size: u32, color: impl Fn(f64, f64) -> [f64; 4]) -> Image {
    let mut rgba = Vec::with_capacity((size * size * 4) as usize);
    for y in 0..size {
        for x in 0..size {
            let at = |k: u32| (f64::from(k) + 0.5) / f64::from(size);
            rgba.extend(color(at(x), at(y)).map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        }
    }
    Image { name: name.to_owned(), width: size, height: size, rgba: rgba.into() }
}

fn opaque([r, g, b]: Color) -> [f64; 4] {
    [r, g, b, 1.0]
}

fn mix(a: Color, b: Color, t: f64) -> Color {
    [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * t)
}

/// Brighter or darker by a share.
fn shade(color: Color, by: f64) -> Color {
    color.map(|c| c * (1.0 + by))
}

fn smooth_step(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// To the nearest whole number, in [-0.5, 0.5].
fn wrap_distance(x: f64) -> f64 {
    x - (x + 0.5).floor()
}

/// A sum of octaves of value noise over the unit square, in [0, 1]; `cells` of the first along each side.
fn fbm(u: f64, v: f64, cells: i64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut weight, mut total, mut n) = (0.0, 1.0, 0.0, cells);
    for octave in 0..octaves {
        let scale = n as f64;
        sum += weight * value_noise(u * scale, v * scale, [n, n], seed.wrapping_add(u64::from(octave) << 32));
        total += weight;
        weight *= 0.5;
        n *= 2;
    }
    sum / total
}

/// Values at whole points joined smoothly, repeating after `period`.
fn value_noise(x: f64, y: f64, period: [i64; 2], seed: u64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (smooth_step(0.0, 1.0, x - x0), smooth_step(0.0, 1.0, y - y0));
    let at = |i: i64, j: i64| {
        lattice_value((x0 as i64 + i).rem_euclid(period[0]), (y0 as i64 + j).rem_euclid(period[1]), seed)
    };
    let low = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
    let high = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
    low + (high - low) * fy
}

/// An even number in [0, 1) for every whole point.
fn lattice_value(i: i64, j: i64, seed: u64) -> f64 {
    let hash = split_mix(split_mix(split_mix(seed) ^ i as u64) ^ j as u64);
    (hash >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats() {
        for k in 0..20 {
            let x = f64::from(k) * 0.37;
            let noise = |x: f64, y: f64| value_noise(x, y, [8, 4], 5);
            assert!((noise(x, 1.3) - noise(x + 8.0, 1.3)).abs() < 1e-12);
            assert!((noise(x, 1.3) - noise(x, 5.3)).abs() < 1e-12);
        }
    }

    #[test]
    fn cut_outs_have_holes_and_substance() {
        for image in [screen("screen", 256, [0.5; 3], 1), leaf("leaf", 256, [0.2, 0.5, 0.1], [0.5; 3], 1)] {
            let solid = image.rgba.chunks_exact(4).filter(|t| t[3] == 255).count() as f64;
            let share = solid / f64::from(image.width * image.height);
            assert!((0.25..0.75).contains(&share), "{}: {share}", image.name);
        }
    }
}
