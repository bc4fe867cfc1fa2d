//! A power station's piping, in place of the UNC Power Plant: pipes along the axes and across, tube banks, gratings and a tall steel
//! frame in a box that is mostly empty; no textures.
//!
//! Modules of pipes or bars are instanced in slots whose weights are drawn from a heavy-tailed distribution, so that a few
//! places are very dense. Round things have about one vertex a triangle and bars two thirds, and whichever is wanting to
//! reach the model's vertices a triangle comes next.

use super::Recipe;
use super::assembly::{Assembly, MeshId, matte};
use super::rng::Rng;
use super::row::Reference;
use super::shapes::{Shape, quarter, turned};
use crate::{Environment, Material, Scene};
use glam::{DVec2, DVec3};

/// Edges of the model's box relative to the longest: length (x), height (y), depth (z).
const BOX: [f64; 3] = [1.0, 250.0 / 616.0, 187.0 / 616.0];
/// Length in metres.
const LENGTH: f64 = 200.0;
const HEIGHT: f64 = LENGTH * BOX[1];
const DEPTH: f64 = LENGTH * BOX[2];
/// The frame's bays and the slots' side.
const BAY: f64 = 8.0;
/// The frame's low corner.
const FRAME: DVec3 = DVec3::new(60.0, 0.0, -24.0);
/// Its bays along x and z, its levels.
const FRAME_BAYS: [usize; 3] = [6, 9, 6];
/// Height above a slot's floor that pipes keep, so that none lies under the ground.
const FLOOR: f64 = 0.8;
/// Sides of the pipes that make up the last triangles.
const LAST_SIDES: u64 = 4;

pub(super) fn generate(recipe: &Recipe) -> Scene {
    let target = u64::from(recipe.triangles);
    let mut a = Assembly::new("plant");
    let paints = Paints::new(&mut a);
    // 1 from about 100,000 triangles on; less coarsens the large round things and thins the frame.
    let detail = libm::sqrt(target as f64 / 100_000.0).min(1.0);
    site(&mut a, &paints, detail);
    frame(&mut a, &paints, detail);
    modules(&mut a, &paints, recipe);
    last_pipes(&mut a, &paints, recipe);
    views(&mut a);
    a.finish()
}

struct Paints {
    concrete: usize,
    steel: usize,
    grating: usize,
    tank: usize,
    stack: usize,
    pipes: [usize; 5],
}

impl Paints {
    fn new(a: &mut Assembly) -> Self {
        let lacquer = |name: &str, color: [f32; 3], roughness: f32| Material {
            specular: [0.04; 3],
            roughness,
            ..matte(name, color)
        };
        Self {
            concrete: a.material(matte("concrete", [0.46, 0.45, 0.42])),
            steel: a.material(lacquer("steel", [0.24, 0.33, 0.40], 0.6)),
            grating: a.material(matte("grating", [0.36, 0.36, 0.37])),
            tank: a.material(lacquer("tank", [0.68, 0.69, 0.68], 0.25)),
            stack: a.material(matte("stack", [0.72, 0.66, 0.60])),
            pipes: [
                a.material(lacquer("white pipe", [0.78, 0.78, 0.76], 0.35)),
                a.material(Material { metallic: 1.0, ..lacquer("bright pipe", [0.80, 0.80, 0.82], 0.15) }),
                a.material(lacquer("rusty pipe", [0.46, 0.19, 0.08], 0.7)),
                a.material(lacquer("yellow pipe", [0.85, 0.60, 0.06], 0.4)),
                a.material(lacquer("green pipe", [0.10, 0.36, 0.20], 0.4)),
            ],
        }
    }
}

/// Ground, stack, tanks, turbine hall.
fn site(a: &mut Assembly, paints: &Paints, detail: f64) {
    let sides = |usual: f64| ((usual * detail) as usize).max(6);
    let mut ground = Shape::new();
    let p = |x: f64, z: f64| DVec3::new(x, 0.0, z * DEPTH * 0.5);
    ground.quad(p(0.0, 1.0), p(LENGTH, 1.0), p(LENGTH, -1.0), p(0.0, -1.0));

    let mut stack = Shape::new();
    let flue = [
        (5.0, 0.0),
        (4.1, 30.0),
        (3.6, HEIGHT - 2.0),
        (3.6, HEIGHT - 2.0),
        (3.9, HEIGHT - 1.0),
        (3.9, HEIGHT),
    ];
    stack.lathe(DVec3::new(188.0, 0.0, 6.0), &flue.map(DVec2::from), sides(48.0));

    let mut tanks = Shape::new();
    for (x, z, radius, height) in
        [(14.0, -17.0, 9.0, 14.0), (14.0, 14.0, 8.0, 18.0), (38.0, -16.0, 7.5, 12.0)]
    {
        let dome = (1..=4).map(|k| {
            let (sin, cos) = super::shapes::turn(k, 16);
            DVec2::new(radius * cos, height + 0.35 * radius * sin)
        });
        let profile = [DVec2::new(radius, 0.0), DVec2::new(radius, height), DVec2::new(radius, height)];
        let profile: Vec<DVec2> = profile.into_iter().chain(dome).collect();
        tanks.lathe(DVec3::new(x, 0.0, z), &profile, sides(64.0));
    }
    let mut hall = Shape::new();
    for (x, z) in [(120.0, -27.0), (120.0, -9.0), (120.0, 9.0), (172.0, -27.0), (172.0, -9.0), (172.0, 9.0)] {
        bar(&mut hall, DVec3::new(x, 0.0, z), DVec3::new(x, 16.0, z), 0.5);
    }
    // Three turbines lie in the hall under an open roof.
    let mut turbines = Shape::new();
    for k in 0..3 {
        let x = 124.0 + 16.0 * f64::from(k);
        for (from, to, radius) in [(0.0, 5.0, 3.0), (5.0, 8.0, 2.2), (8.0, 13.0, 2.6)] {
            let at = |dx: f64| DVec3::new(x + dx, 4.0, -9.0);
            turbines.pipe(at(from), at(to), radius, sides(36.0));
            turbines.disc(at(from), DVec3::NEG_X, radius, sides(36.0));
            turbines.disc(at(to), DVec3::X, radius, sides(36.0));
        }
    }
    a.add(
        "site",
        [
            (ground, paints.concrete),
            (stack, paints.stack),
            (tanks, paints.tank),
            (hall, paints.steel),
            (turbines, paints.pipes[4]),
        ],
    );
}

/// A bar of square section, `half` its half side.
fn bar(shape: &mut Shape, from: DVec3, to: DVec3, half: f64) {
    let along = (to - from) * 0.5;
    let y = super::shapes::perpendicular(along) * half;
    let z = along.normalize().cross(y);
    shape.beam(from + along, along, y, z);
}

/// Columns, beams and braces of the boiler house.
fn frame(a: &mut Assembly, paints: &Paints, detail: f64) {
    let [bx, levels, bz] = FRAME_BAYS.map(|n| ((n as f64 * detail).round() as usize).max(1));
    let size = DVec3::new(FRAME_BAYS[0] as f64, FRAME_BAYS[1] as f64, FRAME_BAYS[2] as f64) * BAY;
    let at = |i: usize, j: usize, k: usize| {
        FRAME + size * DVec3::new(i as f64 / bx as f64, j as f64 / levels as f64, k as f64 / bz as f64)
    };
    let mut steel = Shape::new();
    for i in 0..=bx {
        for k in 0..=bz {
            for j in 0..levels {
                bar(&mut steel, at(i, j, k), at(i, j + 1, k), 0.28);
            }
        }
    }
    for j in 1..=levels {
        for i in 0..=bx {
            for k in 0..bz {
                bar(&mut steel, at(i, j, k), at(i, j, k + 1), 0.2);
            }
        }
        for k in 0..=bz {
            for i in 0..bx {
                bar(&mut steel, at(i, j, k), at(i + 1, j, k), 0.2);
            }
        }
        // Braces across the outer bays of the long sides.
        for k in [0, bz] {
            for i in [0, bx - 1] {
                bar(&mut steel, at(i, j - 1, k), at(i + 1, j, k), 0.1);
                bar(&mut steel, at(i + 1, j - 1, k), at(i, j, k), 0.1);
            }
        }
    }
    a.add("frame", [(steel, paints.steel)]);
}

/// Places modules until less than the smallest is left.
fn modules(a: &mut Assembly, paints: &Paints, recipe: &Recipe) {
    let target = u64::from(recipe.triangles);
    let mut rng = Rng::new(recipe.seed, 20);
    // Between 600 instances of small modules and ever more of large ones.
    let size = (target as f64 / 600.0).clamp(48.0, 2_400.0);
    let round: Vec<MeshId> = (0..12).map(|k| pipe_module(a, paints, &mut rng, k, size)).collect();
    let bars: Vec<MeshId> = (0..6).map(|k| bar_module(a, paints, &mut rng, k, size)).collect();
    let slots = slots(&mut rng);
    let total_weight: f64 = slots.iter().map(|s| s.weight).sum();
    let ratio = Reference::POWER_PLANT.vertices_per_triangle();
    let mut missed = 0;
    while missed < 16 {
        let total = a.total();
        let want_round = (total.vertices as f64) < ratio * total.triangles as f64;
        let choice = if want_round { &round } else { &bars };
        let mesh = choice[rng.below(choice.len())];
        if total.triangles + a.count(mesh).triangles > target {
            missed += 1;
            continue;
        }
        let mut pick = rng.range(0.0, total_weight);
        let slot = slots.iter().find(|s| {
            pick -= s.weight;
            pick < 0.0
        });
        let Some(slot) = slot else { continue };
        // Never the same place twice: two modules that coincide would hide each other.
        let shift = DVec3::new(rng.range(-1.2, 1.2), rng.range(0.0, 0.5), rng.range(-1.2, 1.2));
        a.place(mesh, turned(slot.at + shift, rng.below(4)));
    }
}

/// A place for modules, by its middle.
struct Slot {
    at: DVec3,
    weight: f64,
}

fn slots(rng: &mut Rng) -> Vec<Slot> {
    // Pareto with exponent 1.2, cut at 60: a few slots get most.
    let mut heavy = |scale: f64| scale * (1.0 / libm::pow(1.0 - rng.unit(), 1.0 / 1.2)).min(60.0);
    let mut slots = Vec::new();
    let middle = BAY * 0.5;
    for j in 0..FRAME_BAYS[1] {
        for i in 0..FRAME_BAYS[0] {
            for k in 0..FRAME_BAYS[2] {
                let at = FRAME + (DVec3::new(i as f64, j as f64, k as f64)) * BAY + DVec3::splat(middle);
                // The boiler in the middle is the densest.
                let inner = (1..5).contains(&i) && (1..5).contains(&k);
                slots.push(Slot { at, weight: heavy(if inner { 1.0 } else { 0.35 }) });
            }
        }
    }
    // Racks along the ground on both sides, and the turbine hall's basement.
    let mut x = 6.0;
    while x < LENGTH - 6.0 {
        if !(FRAME.x - 4.0..FRAME.x + 52.0).contains(&x) {
            for z in [-24.5, 24.5] {
                let at = DVec3::new(x, middle + 0.4, z);
                slots.push(Slot { at, weight: heavy(0.25) });
            }
        }
        x += BAY;
    }
    for i in 0..6 {
        for k in 0..2 {
            let at = DVec3::new(124.0 + BAY * f64::from(i), middle + 0.4, BAY * (f64::from(k) - 0.2));
            slots.push(Slot { at, weight: heavy(0.5) });
        }
    }
    slots
}

/// Pipes in a cube of [`BAY`]: straight runs with bends, a bank of tubes, or a tangle, about `size` triangles.
fn pipe_module(a: &mut Assembly, paints: &Paints, rng: &mut Rng, kind: usize, size: f64) -> MeshId {
    let mut parts: [Shape; 5] = Default::default();
    let h = BAY * 0.5;
    match kind % 3 {
        // Runs along x that turn away at a bend, or go through.
        0 => {
            let color = rng.below(5);
            let mut made = 0;
            while (made as f64) < size {
                let radius = 0.05 + 0.35 * rng.unit() * rng.unit();
                let sides = 5 + rng.below(10);
                let (y, z) = (rng.range(FLOOR - h, h), rng.range(-h, h));
                let shape = &mut parts[(color + rng.below(2)) % 5];
                let before = shape.triangles.len();
                let x = rng.range(-h * 0.6, h * 0.6);
                let (to, room) = if rng.chance(0.5) { (DVec3::Y, h - y) } else { (DVec3::NEG_Z, z + h) };
                let bend = radius * 2.5;
                if size > 400.0 && rng.chance(0.4) && room > bend + 0.5 {
                    let centre = DVec3::new(x, y, z) + to * bend;
                    shape.pipe(DVec3::new(-h, y, z), DVec3::new(x, y, z), radius, sides);
                    let arc: Vec<DVec3> = quarter(centre, -to, DVec3::X, bend, 3).collect();
                    shape.tube(&arc, radius, sides);
                    let end = DVec3::new(x + bend, y, z) + to * bend;
                    shape.pipe(end, end + to * rng.range(0.4, room - bend), radius, sides);
                } else {
                    shape.pipe(DVec3::new(-h, y, z), DVec3::new(h, y, z), radius, sides);
                }
                made += shape.triangles.len() - before;
            }
        }
        // A bank of thin parallel tubes.
        1 => {
            let sides = 5 + rng.below(3);
            let n = (libm::sqrt(size / (2 * sides) as f64) as usize).max(2);
            let (pitch, long) = (rng.range(0.10, 0.24), rng.range(4.0, BAY));
            let shape = &mut parts[rng.below(3)];
            for i in 0..n {
                for k in 0..n {
                    let offset = |q: usize| (q as f64 - (n as f64 - 1.0) * 0.5) * pitch;
                    let foot = DVec3::new(offset(i), -long * 0.5, offset(k));
                    shape.pipe(foot, foot + DVec3::Y * long, pitch * 0.32, sides);
                }
            }
        }
        // Thin conduits in any direction.
        _ => {
            let mut made = 0;
            while (made as f64) < size {
                let mut point = || DVec3::new(rng.range(-h, h), rng.range(FLOOR - h, h), rng.range(-h, h));
                let (from, to) = (point(), point());
                if (to - from).length() < 1.0 {
                    continue;
                }
                let sides = 4 + rng.below(5);
                let shape = &mut parts[rng.below(5)];
                shape.pipe(from, to, rng.range(0.02, 0.09), sides);
                made += 2 * sides;
            }
        }
    }
    a.mesh("pipes", parts.into_iter().zip(paints.pipes))
}

/// A grating with its rail, or a ladder and trays, about `size` triangles of bars.
fn bar_module(a: &mut Assembly, paints: &Paints, rng: &mut Rng, kind: usize, size: f64) -> MeshId {
    let (mut grating, mut steel) = (Shape::new(), Shape::new());
    let h = BAY * 0.5;
    let count = ((size / 12.0) as usize).max(2);
    if kind.is_multiple_of(2) {
        let bearing = (count * 4 / 5).max(1);
        for k in 0..bearing {
            let z = -h + BAY * (k as f64 + 0.5) / bearing as f64;
            let centre = DVec3::new(0.0, -h + 0.25, z);
            grating.beam(
                centre,
                DVec3::X * h,
                DVec3::Y * 0.03,
                DVec3::Z * (0.12 * BAY / bearing as f64).min(0.05),
            );
        }
        for k in 0..count - bearing {
            let x = -h + BAY * (k as f64 + 0.5) / (count - bearing) as f64;
            bar(&mut steel, DVec3::new(x, -h + 0.22, -h), DVec3::new(x, -h + 0.22, h), 0.025);
        }
    } else {
        // Rungs, and posts of a rail.
        let x = rng.range(-h, h - 0.6);
        let rungs = count / 2;
        for side in [0.0, 0.5] {
            bar(&mut steel, DVec3::new(x + side, -h, 0.0), DVec3::new(x + side, h, 0.0), 0.03);
        }
        for k in 0..rungs {
            let y = -h + BAY * (k as f64 + 0.5) / rungs as f64;
            bar(&mut steel, DVec3::new(x, y, 0.0), DVec3::new(x + 0.5, y, 0.0), 0.015);
        }
        for k in 0..count.saturating_sub(rungs + 2) {
            let x = -h + BAY * (k as f64 + 0.5) / (count - rungs) as f64;
            bar(&mut grating, DVec3::new(x, -h + 0.25, h - 0.3), DVec3::new(x, -h + 1.35, h - 0.3), 0.02);
        }
    }
    a.mesh("bars", [(grating, paints.grating), (steel, paints.steel)])
}

/// Long thin pipes from one end of the plant to the other, with exactly the triangles that are left.
fn last_pipes(a: &mut Assembly, paints: &Paints, recipe: &Recipe) {
    let mut rng = Rng::new(recipe.seed, 21);
    let missing = u64::from(recipe.triangles).saturating_sub(a.total().triangles);
    let mut pipes = Shape::new();
    for _ in 0..missing / (2 * LAST_SIDES) {
        let y = rng.range(0.6, 9.0);
        let z = if rng.chance(0.5) { 1.0 } else { -1.0 } * rng.range(25.5, 29.5);
        let (x0, x1) = (rng.range(2.0, 90.0), rng.range(110.0, 198.0));
        let tilt = rng.range(-0.3, 0.3);
        let radius = rng.range(0.03, 0.12);
        pipes.pipe(DVec3::new(x0, y, z), DVec3::new(x1, y + tilt, z), radius, LAST_SIDES as usize);
    }
    a.add("long pipes", [(pipes, paints.pipes[0])]);
}

fn views(a: &mut Assembly) {
    a.camera("overview", [-42.0, 62.0, 118.0], [92.0, 26.0, 0.0], 46.0);
    a.camera("inside", [61.5, 18.2, 21.0], [96.0, 23.0, -12.0], 62.0);
    a.camera("ground", [34.0, 2.2, 8.0], [92.0, 26.0, -4.0], 64.0);
    a.sun([0.50, -0.66, -0.56], [3.4, 3.2, 2.8]);
    let scene = a.scene();
    scene.ambient = [0.30, 0.32, 0.36];
    scene.environment = Environment::Gradient {
        zenith: [0.20, 0.38, 0.72],
        horizon: [0.80, 0.86, 0.92],
        nadir: [0.34, 0.33, 0.31],
    };
}
