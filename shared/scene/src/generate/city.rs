//! A street grid of houses with recessed windows, in place of the Manhattan of the visibility papers: from any street most of it is
//! hidden.
//!
//! Houses are instances of a few dozen types at three depths of detail; every lot takes the finest that fits its share of the
//! triangles. Trees, cars and lamps along the streets take what is left, and boxes on the roofs the last of it.

use super::Recipe;
use super::assembly::{Assembly, MeshId, glowing, matte, mirror, polished};
use super::rng::Rng;
use super::shapes::{Shape, perpendicular, placed, turned};
use crate::{Environment, Scene};
use glam::{DMat4, DVec2, DVec3};
use std::f64::consts::TAU;

/// Lots along a block, in two rows back to back.
const LOTS: usize = 4;
/// A lot's width and depth.
const LOT: [f64; 2] = [20.0, 22.0];
/// Between the houses of neighbouring blocks, pavements included.
const STREET: f64 = 18.0;
/// Of each side of a street.
const PAVEMENT: f64 = 3.5;
/// Height of a storey.
const STOREY: f64 = 3.6;
/// A block's share of the triangles.
const BLOCK_TRIANGLES: f64 = 14_000.0;
/// Share of the triangles that houses get.
const HOUSES: f64 = 0.72;
/// Numbers of storeys that there are.
const HEIGHTS: [usize; 6] = [3, 5, 7, 10, 17, 30];

pub(super) fn generate(recipe: &Recipe) -> Scene {
    let blocks = (libm::sqrt(f64::from(recipe.triangles) / BLOCK_TRIANGLES).round() as usize).max(1);
    let mut a = Assembly::new("city");
    let paints = Paints::new(&mut a);
    ground(&mut a, &paints, blocks);
    let roofs = houses(&mut a, &paints, blocks, recipe);
    street_life(&mut a, &paints, blocks, recipe);
    roof_boxes(&mut a, &paints, &roofs, recipe);
    views(&mut a, blocks);
    a.finish()
}

struct Paints {
    asphalt: usize,
    pavement: usize,
    line: usize,
    walls: [usize; 4],
    glass: usize,
    roof: usize,
    leaf: usize,
    bark: usize,
    cars: [usize; 4],
    dark: usize,
    steel: usize,
    lamp: usize,
}

impl Paints {
    fn new(a: &mut Assembly) -> Self {
        Self {
            asphalt: a.material(matte("asphalt", [0.13, 0.13, 0.14])),
            pavement: a.material(matte("pavement", [0.44, 0.43, 0.41])),
            line: a.material(matte("line", [0.75, 0.74, 0.70])),
            walls: [[0.48, 0.24, 0.16], [0.66, 0.58, 0.46], [0.50, 0.49, 0.47], [0.72, 0.66, 0.60]]
                .map(|c| a.material(matte("wall", c))),
            glass: a.material(polished(matte("window", [0.05, 0.07, 0.09]), 0.14)),
            roof: a.material(matte("roof", [0.30, 0.29, 0.28])),
            leaf: a.material(matte("leaf", [0.15, 0.34, 0.08])),
            bark: a.material(matte("bark", [0.20, 0.13, 0.08])),
            cars: [[0.52, 0.04, 0.03], [0.80, 0.56, 0.05], [0.10, 0.16, 0.32], [0.62, 0.63, 0.65]]
                .map(|c| a.material(polished(matte("car", c), 0.05))),
            dark: a.material(matte("dark", [0.04, 0.04, 0.05])),
            steel: a.material(mirror("steel", [0.60, 0.61, 0.63])),
            lamp: a.material(glowing("lamp", [1.0, 0.95, 0.8])),
        }
    }
}

/// Width and depth of a block with its streets.
fn pitch() -> [f64; 2] {
    [LOTS as f64 * LOT[0] + STREET, 2.0 * LOT[1] + STREET]
}

/// Middle of a block; the city's middle lies at the origin.
fn block(i: usize, j: usize, blocks: usize) -> DVec3 {
    let [px, pz] = pitch();
    let middle = (blocks as f64 - 1.0) * 0.5;
    DVec3::new((i as f64 - middle) * px, 0.0, (j as f64 - middle) * pz)
}

fn ground(a: &mut Assembly, paints: &Paints, blocks: usize) {
    let [px, pz] = pitch();
    let (mut pavement, mut asphalt, mut line) = (Shape::new(), Shape::new(), Shape::new());
    let (w, d) = ((px - STREET) * 0.5 + PAVEMENT, (pz - STREET) * 0.5 + PAVEMENT);
    pavement.cuboid_faces(
        DVec3::new(-w, 0.0, -d),
        DVec3::new(w, 0.15, d),
        [true, true, false, true, true, true],
    );
    let p = |x: f64, z: f64, y: f64| DVec3::new(x, y, z);
    asphalt.quad(
        p(-px * 0.5, pz * 0.5, 0.0),
        p(px * 0.5, pz * 0.5, 0.0),
        p(px * 0.5, -pz * 0.5, 0.0),
        p(-px * 0.5, -pz * 0.5, 0.0),
    );
    // Dashes along the middle of the streets in front and to the right.
    let mut dash = |x: f64, z: f64, w: f64, d: f64| {
        let y = 0.01;
        line.quad(p(x - w, z + d, y), p(x + w, z + d, y), p(x + w, z - d, y), p(x - w, z - d, y));
    };
    for k in 0..6 {
        let t = (f64::from(k) - 2.5) / 6.0;
        dash(t * px * 0.8, pz * 0.5, 1.5, 0.08);
        dash(px * 0.5, t * pz * 0.8, 0.08, 1.5);
    }
    let parts = [(pavement, paints.pavement), (asphalt, paints.asphalt), (line, paints.line)];
    let mesh = a.mesh("block", parts);
    for j in 0..blocks {
        for i in 0..blocks {
            a.place(mesh, DMat4::from_translation(block(i, j, blocks)));
        }
    }
}

/// How windows are made.
#[derive(Clone, Copy, PartialEq)]
enum Windows {
    None,
    Flush,
    Recessed,
}

/// A house's type: its mesh, height and cost.
struct House {
    mesh: MeshId,
    storeys: usize,
    triangles: u64,
}

/// Fills every lot; returns the roofs' middles.
fn houses(a: &mut Assembly, paints: &Paints, blocks: usize, recipe: &Recipe) -> Vec<DVec3> {
    let mut types = Vec::new();
    for (k, storeys) in HEIGHTS.into_iter().enumerate() {
        for style in 0..2 {
            for windows in [Windows::None, Windows::Flush, Windows::Recessed] {
                let wall = paints.walls[(k + 2 * style) % 4];
                let mesh = house(a, paints, storeys, 4 + style, windows, wall);
                types.push(House { mesh, storeys, triangles: a.count(mesh).triangles });
            }
        }
    }
    let mut rng = Rng::new(recipe.seed, 30);
    let goal = (f64::from(recipe.triangles) * HOUSES) as u64;
    let mut left = (blocks * blocks * LOTS * 2) as u64;
    let mut roofs = Vec::new();
    for j in 0..blocks {
        for i in 0..blocks {
            let middle = block(i, j, blocks);
            // Towers stand in the middle of the city.
            let centre = 1.0 - 2.0 * middle.length() / (pitch()[0] * blocks as f64).max(1.0);
            for lot in 0..LOTS * 2 {
                let share = goal.saturating_sub(a.total().triangles) / left;
                left -= 1;
                let tall = (rng.unit() * rng.unit() + 0.35 * centre.max(0.0)).min(0.999);
                let mut height = (tall * HEIGHTS.len() as f64) as usize;
                let style = rng.below(2);
                let (column, row) = (lot % LOTS, lot / LOTS);
                let x = (column as f64 - (LOTS as f64 - 1.0) * 0.5) * LOT[0];
                let z = (row as f64 - 0.5) * LOT[1];
                // The finest detail, then the height, that the share allows.
                let fits = |t: &&House| t.storeys == HEIGHTS[height] && t.triangles <= 2 * share;
                let same = types[(height * 2 + style) * 3..(height * 2 + style + 1) * 3].iter();
                let Some(chosen) = same.rev().find(fits).or_else(|| {
                    height = 0;
                    types[..3].iter().rev().find(|t| t.triangles <= share)
                }) else {
                    continue;
                };
                let size = DVec3::new(rng.range(0.90, 1.0), rng.range(0.92, 1.08), rng.range(0.86, 1.0));
                let at = middle + DVec3::new(x, 0.15, z);
                let turn = turned(at, 2 * (row + 1)) * DMat4::from_scale(size);
                a.place(chosen.mesh, turn);
                roofs.push(at + DVec3::Y * (chosen.storeys as f64 * STOREY * size.y));
            }
        }
    }
    roofs
}

/// A house on the middle of its lot, its front to -z.
fn house(
    a: &mut Assembly,
    paints: &Paints,
    storeys: usize,
    across: usize,
    windows: Windows,
    wall: usize,
) -> MeshId {
    let (mut walls, mut glass, mut roof) = (Shape::new(), Shape::new(), Shape::new());
    let (w, d, h) = (LOT[0] * 0.5, LOT[1] * 0.5, storeys as f64 * STOREY);
    let corner = |k: usize| DVec3::new([w, -w, -w, w][k % 4], 0.0, [-d, -d, d, d][k % 4]);
    for side in 0..4 {
        let (from, to) = (corner(side), corner(side + 1));
        let along = (to - from).normalize();
        let (width, out) = ((to - from).length(), along.cross(DVec3::Y));
        let at = |s: f64, t: f64, depth: f64| from + along * s + DVec3::Y * t + out * depth;
        if windows == Windows::None {
            walls.quad(at(0.0, 0.0, 0.0), at(width, 0.0, 0.0), at(width, h, 0.0), at(0.0, h, 0.0));
            continue;
        }
        let cell = width / across as f64;
        for j in 0..storeys {
            let (low, high) = (j as f64 * STOREY, (j + 1) as f64 * STOREY);
            if windows == Windows::Flush {
                walls.quad(at(0.0, low, 0.0), at(width, low, 0.0), at(width, high, 0.0), at(0.0, high, 0.0));
            }
            for i in 0..across {
                let (s0, s1) = (i as f64 * cell, (i + 1) as f64 * cell);
                let (a0, a1) = (s0 + cell * 0.27, s1 - cell * 0.27);
                let (t0, t1) = if j == 0 { (low + 0.4, high - 0.5) } else { (low + 0.95, high - 0.55) };
                if windows == Windows::Flush {
                    let z = 0.03;
                    glass.quad(at(a0, t0, z), at(a1, t0, z), at(a1, t1, z), at(a0, t1, z));
                    continue;
                }
                let mut wall = |s0: f64, s1: f64, t0: f64, t1: f64| {
                    walls.quad(at(s0, t0, 0.0), at(s1, t0, 0.0), at(s1, t1, 0.0), at(s0, t1, 0.0));
                };
                wall(s0, a0, low, high);
                wall(a1, s1, low, high);
                wall(a0, a1, low, t0);
                wall(a0, a1, t1, high);
                let z = -0.28;
                glass.quad(at(a0, t0, z), at(a1, t0, z), at(a1, t1, z), at(a0, t1, z));
                walls.quad(at(a0, t0, 0.0), at(a0, t0, z), at(a0, t1, z), at(a0, t1, 0.0));
                walls.quad(at(a1, t0, z), at(a1, t0, 0.0), at(a1, t1, 0.0), at(a1, t1, z));
                walls.quad(at(a0, t1, z), at(a1, t1, z), at(a1, t1, 0.0), at(a0, t1, 0.0));
                walls.quad(at(a0, t0, 0.0), at(a1, t0, 0.0), at(a1, t0, z), at(a0, t0, z));
            }
        }
    }
    let p = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    roof.quad(p(-w, h, d), p(w, h, d), p(w, h, -d), p(-w, h, -d));
    if windows == Windows::Recessed {
        // A parapet and a house for the lift; on tall ones a water tank.
        for (low, high) in [
            (p(-w, h, -d), p(w, h + 0.9, -d + 0.3)),
            (p(-w, h, d - 0.3), p(w, h + 0.9, d)),
            (p(-w, h, -d + 0.3), p(-w + 0.3, h + 0.9, d - 0.3)),
            (p(w - 0.3, h, -d + 0.3), p(w, h + 0.9, d - 0.3)),
        ] {
            walls.cuboid_faces(low, high, [true, true, false, true, true, true]);
        }
        roof.cuboid_faces(p(-3.0, h, 1.0), p(1.5, h + 3.2, 6.0), [true, true, false, true, true, true]);
        if storeys >= 7 {
            let tank = [(1.6, 1.5), (1.6, 4.2), (1.6, 4.2), (0.0, 5.4)];
            roof.lathe(p(5.0, h, -3.0), &tank.map(DVec2::from), 20);
            for (x, z) in [(4.0, -4.0), (6.0, -4.0), (6.0, -2.0), (4.0, -2.0)] {
                roof.pipe(p(x, h, z), p(x, h + 1.6, z), 0.12, 6);
            }
        }
    }
    a.mesh("house", [(walls, wall), (glass, paints.glass), (roof, paints.roof)])
}

/// Trees, cars and lamps along the pavements.
fn street_life(a: &mut Assembly, paints: &Paints, blocks: usize, recipe: &Recipe) {
    let target = u64::from(recipe.triangles);
    let mut rng = Rng::new(recipe.seed, 31);
    let trees = [(); 3].map(|()| tree(a, paints, &mut rng));
    let cars = paints.cars.map(|paint| car(a, paints, paint));
    let lamp = street_lamp(a, paints);
    let [px, pz] = pitch();
    let (w, d) = ((px - STREET) * 0.5, (pz - STREET) * 0.5);
    // Places along a block's four sides in a shuffled order, the same for every block: where, and the quarter turns that
    // bring +z to the street.
    let mut places: Vec<(DVec3, usize)> = Vec::new();
    let kerb = PAVEMENT - 0.7;
    for k in 0..24 {
        let t = (f64::from(k) + 0.5) / 12.0 - 1.0;
        places.push((DVec3::new(t * w, 0.15, d + kerb), 0));
        places.push((DVec3::new(t * w, 0.15, -d - kerb), 2));
        if k % 2 == 0 {
            places.push((DVec3::new(w + kerb, 0.15, t * d), 1));
            places.push((DVec3::new(-w - kerb, 0.15, t * d), 3));
        }
    }
    for k in (1..places.len()).rev() {
        places.swap(k, rng.below(k + 1));
    }
    let at_kerb = |a: &mut Assembly, mesh: MeshId, transform: DMat4| {
        if a.total().triangles + a.count(mesh).triangles <= target {
            a.place(mesh, transform);
        }
    };
    for (round, &(place, quarters)) in places.iter().enumerate() {
        for j in 0..blocks {
            for i in 0..blocks {
                let at = block(i, j, blocks) + place;
                match round % 3 {
                    0 => {
                        let size = DVec3::splat(rng.range(0.8, 1.25));
                        at_kerb(a, trees[rng.below(3)], placed(at, rng.range(0.0, TAU), size));
                    }
                    1 => {
                        let street = turned(DVec3::ZERO, quarters).transform_vector3(DVec3::Z);
                        let at = at + street * 1.9 - DVec3::Y * 0.15;
                        at_kerb(a, cars[rng.below(4)], turned(at, quarters + 1 + 2 * rng.below(2)));
                    }
                    _ => at_kerb(a, lamp, turned(at, quarters)),
                }
            }
        }
    }
}

fn tree(a: &mut Assembly, paints: &Paints, rng: &mut Rng) -> MeshId {
    let (mut bark, mut leaves) = (Shape::new(), Shape::new());
    bark.pipe(DVec3::ZERO, DVec3::Y * 2.6, 0.14, 6);
    for _ in 0..90 {
        // In an egg-shaped crown, leaves like little kites.
        let (sin, cos) = super::shapes::turn(rng.below(360), 360);
        let (r, y) = (libm::sqrt(rng.unit()), rng.range(-1.0, 1.0));
        let r = r * libm::sqrt(1.0 - y * y);
        let at = DVec3::new(1.7 * r * cos, 4.2 + 2.0 * y, 1.7 * r * sin);
        let out = DVec3::new(cos, rng.range(-0.6, 0.9), sin).normalize();
        let side = perpendicular(out) * rng.range(0.25, 0.4);
        let tip = out.cross(side).normalize() * 0.5;
        leaves.quad(at - tip, at - side, at + tip, at + side);
    }
    a.mesh("tree", [(bark, paints.bark), (leaves, paints.leaf)])
}

/// Along z.
fn car(a: &mut Assembly, paints: &Paints, paint: usize) -> MeshId {
    let (mut body, mut glass, mut dark) = (Shape::new(), Shape::new(), Shape::new());
    body.cuboid(DVec3::new(-0.9, 0.28, -2.2), DVec3::new(0.9, 0.85, 2.2));
    // A cabin that narrows to its roof.
    let ring = |y: f64, w: f64, z0: f64, z1: f64| {
        [DVec3::new(-w, y, z1), DVec3::new(w, y, z1), DVec3::new(w, y, z0), DVec3::new(-w, y, z0)]
    };
    let (low, high) = (ring(0.85, 0.86, -1.5, 1.1), ring(1.42, 0.68, -1.0, 0.5));
    for k in 0..4 {
        let n = (k + 1) % 4;
        glass.quad(low[k], low[n], high[n], high[k]);
    }
    body.quad(high[0], high[1], high[2], high[3]);
    for x in [-0.92, 0.72] {
        for z in [-1.4, 1.4] {
            dark.pipe(DVec3::new(x, 0.32, z), DVec3::new(x + 0.2, 0.32, z), 0.32, 12);
            dark.disc(DVec3::new(x, 0.32, z), DVec3::NEG_X, 0.32, 12);
            dark.disc(DVec3::new(x + 0.2, 0.32, z), DVec3::X, 0.32, 12);
        }
    }
    a.mesh("car", [(body, paint), (glass, paints.glass), (dark, paints.dark)])
}

/// Its arm towards +z.
fn street_lamp(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut steel, mut lamp) = (Shape::new(), Shape::new());
    steel.pipe(DVec3::ZERO, DVec3::Y * 6.0, 0.07, 8);
    steel.pipe(DVec3::Y * 5.95, DVec3::new(0.0, 6.2, 1.6), 0.05, 6);
    let low = DVec3::new(-0.12, 6.1, 1.3);
    let high = DVec3::new(0.12, 6.25, 2.0);
    steel.cuboid_faces(low, high, [true, true, false, true, true, true]);
    lamp.cuboid_faces(low, high, [false, false, true, false, false, false]);
    a.mesh("street lamp", [(steel, paints.steel), (lamp, paints.lamp)])
}

/// Ten triangles each, as many as are wanting.
fn roof_boxes(a: &mut Assembly, paints: &Paints, roofs: &[DVec3], recipe: &Recipe) {
    let missing = u64::from(recipe.triangles).saturating_sub(a.total().triangles);
    let mut rng = Rng::new(recipe.seed, 32);
    let mut boxes = Shape::new();
    for k in 0..missing / 10 {
        // Without a house, on the pavement.
        let roof = if roofs.is_empty() { DVec3::Y * 0.15 } else { roofs[k as usize % roofs.len()] };
        let size = DVec3::new(rng.range(0.3, 1.0), rng.range(0.5, 1.5), rng.range(0.3, 1.0));
        let at = roof + DVec3::new(rng.range(-7.5, 7.5), 0.0, rng.range(-7.5, 7.5));
        let low = at - DVec3::new(size.x, 0.0, size.z);
        boxes.cuboid_faces(low, at + size, [true, true, false, true, true, true]);
    }
    a.add("roof boxes", [(boxes, paints.steel)]);
}

fn views(a: &mut Assembly, blocks: usize) {
    let [px, pz] = pitch();
    // In the street to the right of the middle block, looking along it.
    let near = block(blocks / 2, blocks - 1, blocks);
    let x = near.x - px * 0.5;
    let z = near.z + pz * 0.5;
    a.camera("street", [x + 2.0, 2.0, z - 6.0], [x - 1.0, 11.0, z - 100.0], 62.0);
    let reach = px * blocks as f64;
    a.camera("aerial", [reach * 0.62, 60.0 + reach * 0.42, reach * 0.72], [0.0, 10.0, -reach * 0.02], 44.0);
    a.sun([-0.55, -0.72, -0.42], [3.5, 3.25, 2.75]);
    let scene = a.scene();
    scene.ambient = [0.26, 0.30, 0.37];
    scene.environment = Environment::Gradient {
        zenith: [0.16, 0.34, 0.72],
        horizon: [0.78, 0.86, 0.94],
        nadir: [0.30, 0.30, 0.30],
    };
}
