//! The demo: a textured hall with columns, a polished floor, glass, mirrors and cut-out leaves.
//!
//! The nave runs along -z between two rows of columns under a starred vault. The sun falls through the screens and the coloured
//! windows of the right aisle; three chandeliers light the rest.

use super::Recipe;
use super::arches::{Opening, Stand, half_turn, vault};
use super::assembly::{Assembly, cut_out, glass, glowing, matte, mirror, pane, polished, textured};
use super::furnishing::{self, Stuff};
use super::rng::Rng;
use super::shapes::Shape;
use super::textures;
use crate::{Environment, Scene};
use glam::{DMat4, DVec2, DVec3};

/// Length of a bay along the nave.
const BAY: f64 = 4.0;
/// The first bay begins here, behind the camera.
const FRONT: f64 = 6.0;
/// Middle of the columns.
const COLUMN_X: f64 = 4.0;
/// Height of the columns, where the arcade begins.
const COLUMN_TOP: f64 = 5.0;
/// Thickness of the arcade.
const ARCADE: f64 = 0.7;
/// Where the vault springs.
const VAULT: f64 = 8.2;
/// Middle of the outer walls.
const WALL_X: f64 = 7.35;
/// Thickness of the outer walls.
const WALL: f64 = 0.3;
/// Height of the aisles.
const AISLE: f64 = 7.3;
/// Share of the triangles that is at most left to ivy, which takes what the cut of the curved parts leaves over.
const IVY_SHARE: f64 = 0.04;

pub(super) fn generate(recipe: &Recipe) -> Scene {
    let target = u64::from(recipe.triangles);
    // Find the finest cut that leaves a little for the ivy: the count grows with the cut.
    let bays = match target {
        0..2_500 => 1,
        2_500..6_000 => 2,
        6_000..30_000 => 4,
        _ => 8,
    };
    let most = target - (target as f64 * IVY_SHARE * 0.25) as u64;
    let (mut coarse, mut fine) = (0.05, 64.0);
    for _ in 0..24 {
        let middle = libm::sqrt(coarse * fine);
        let detail = Detail { bays, cut: middle };
        if build(recipe, detail, 0, None).total().triangles <= most {
            coarse = middle;
        } else {
            fine = middle;
        }
    }
    let detail = Detail { bays, cut: coarse };
    let without = build(recipe, detail, 0, None).total().triangles;
    let leaves = target.saturating_sub(without) / furnishing::LEAF_TRIANGLES;
    // Small scenes are made for tests, which need no fine images.
    let texels = if detail.is_full() { 512 } else { 64 };
    build(recipe, detail, leaves, Some(texels)).finish()
}

/// How finely everything is cut.
#[derive(Clone, Copy)]
pub(super) struct Detail {
    bays: usize,
    cut: f64,
}

impl Detail {
    /// `usual` steps at cut 1, never below `least`.
    pub(super) fn steps(self, usual: f64, least: usize) -> usize {
        ((usual * self.cut).round() as usize).max(least)
    }

    /// Whether small things are there at all.
    pub(super) fn is_full(self) -> bool {
        self.bays == 8
    }
}

fn build(recipe: &Recipe, detail: Detail, ivy: u64, texels: Option<u32>) -> Assembly {
    let mut a = Assembly::new("hall");
    let stuff = materials(&mut a, recipe.seed, texels);
    let length = BAY * detail.bays as f64;
    let back = FRONT - length;

    structure(&mut a, &stuff, detail);
    end_walls(&mut a, &stuff, detail, back);
    windows(&mut a, &stuff, detail, recipe.seed);
    floor(&mut a, &stuff, detail, back);
    furnishing::chandeliers(&mut a, &stuff, detail, back);
    furnishing::balls(&mut a, &stuff, detail);
    furnishing::plants(&mut a, &stuff, detail, recipe.seed, back);
    furnishing::banners(&mut a, &stuff, detail, back);
    furnishing::ivy(&mut a, &stuff, ivy, recipe.seed, back);
    outside(&mut a, &stuff, detail, back);
    lights(&mut a);
    a
}

fn materials(a: &mut Assembly, seed: u64, texels: Option<u32>) -> Stuff {
    // While only counting, an image of one texel is enough.
    let texels = texels.unwrap_or(1);
    let mut image = |image| a.image(image);
    let light = image(textures::marble("light marble", texels, [0.90, 0.87, 0.81], [0.62, 0.57, 0.50], seed));
    let dark =
        image(textures::marble("dark marble", texels, [0.12, 0.17, 0.16], [0.55, 0.58, 0.52], seed ^ 11));
    let rose =
        image(textures::marble("rose marble", texels, [0.80, 0.62, 0.54], [0.95, 0.88, 0.82], seed ^ 12));
    let ashlar = image(textures::ashlar("ashlar", texels, [0.84, 0.78, 0.67], [0.62, 0.56, 0.47], seed ^ 13));
    let bricks = image(textures::bricks("bricks", texels, [0.66, 0.36, 0.26], [0.76, 0.71, 0.64], seed ^ 14));
    let wood = image(textures::planks("wood", texels, [0.52, 0.34, 0.19], seed ^ 15));
    let stars = image(textures::stars("stars", texels, [0.13, 0.24, 0.48], [0.95, 0.78, 0.36], seed ^ 16));
    let screen = image(textures::screen("screen", texels, [0.33, 0.27, 0.19], seed ^ 17));
    let leaf = image(textures::leaf("leaf", texels, [0.26, 0.50, 0.16], [0.60, 0.75, 0.36], seed ^ 18));
    let red =
        image(textures::banner("red banner", texels, [0.66, 0.10, 0.10], [0.93, 0.73, 0.30], seed ^ 19));
    let blue =
        image(textures::banner("blue banner", texels, [0.12, 0.20, 0.50], [0.93, 0.73, 0.30], seed ^ 20));
    Stuff {
        light: a.material(polished(textured("light marble", light), 0.06)),
        dark: a.material(polished(textured("dark marble", dark), 0.22)),
        rose: a.material(crate::Material {
            specular: [0.04; 3],
            roughness: 0.12,
            ..textured("rose marble", rose)
        }),
        ashlar: a.material(textured("ashlar", ashlar)),
        bricks: a.material(textured("bricks", bricks)),
        wood: a.material(crate::Material { specular: [0.03; 3], roughness: 0.4, ..textured("wood", wood) }),
        stars: a.material(textured("stars", stars)),
        stone: a.material(matte("pale stone", [0.72, 0.66, 0.55])),
        screen: a.material(cut_out("screen", screen)),
        leaf: a.material(cut_out("leaf", leaf)),
        banners: [a.material(textured("red banner", red)), a.material(textured("blue banner", blue))],
        silver: a.material(mirror("silver", [0.95, 0.95, 0.96])),
        gold: a.material(mirror("gold", [1.0, 0.78, 0.34])),
        clear: a.material(glass("glass", [0.97, 0.99, 0.98], 1.5)),
        green_glass: a.material(glass("green glass", [0.55, 0.92, 0.72], 1.5)),
        lacquer: a.material(polished(matte("red lacquer", [0.55, 0.03, 0.02]), 0.05)),
        glaze: a.material(polished(matte("blue glaze", [0.05, 0.13, 0.36]), 0.05)),
        soil: a.material(matte("soil", [0.07, 0.05, 0.03])),
        lead: a.material(matte("lead", [0.06, 0.06, 0.07])),
        flame: a.material(glowing("flame", [1.0, 0.86, 0.55])),
        grass: a.material(matte("grass", [0.16, 0.30, 0.07])),
        cypress: a.material(matte("cypress", [0.05, 0.13, 0.05])),
        panes: [
            [0.95, 0.22, 0.13],
            [0.98, 0.72, 0.16],
            [0.20, 0.42, 0.95],
            [0.18, 0.75, 0.42],
            [0.95, 0.93, 0.86],
            [0.62, 0.25, 0.80],
        ]
        .map(|c| a.material(pane("pane", c))),
    }
}

/// Columns, arcades, vault, aisles: one mesh each, placed bay by bay.
fn structure(a: &mut Assembly, stuff: &Stuff, detail: Detail) {
    let arc = detail.steps(28.0, 3);
    let column = furnishing::column(a, stuff, detail, COLUMN_TOP);
    let inner = COLUMN_X - ARCADE * 0.5;

    // One bay, its middle at z = 0: arcades and outer walls on both sides, vault and aisle ceilings.
    let mut walls = Shape::textured(0.5);
    let mut trim = Shape::new();
    let arcade = Opening {
        width: BAY,
        height: VAULT - COLUMN_TOP,
        thickness: ARCADE,
        half: 1.5,
        sill: 0.0,
        spring: 0.0,
    };
    for side in [-1.0, 1.0] {
        let stand = Stand {
            foot: DVec3::new(side * COLUMN_X, COLUMN_TOP, 0.0),
            along: DVec3::Z * side,
            front: DVec3::X * -side,
        };
        arcade.wall(&mut walls, stand, arc);
        // Undersides of the arcade beside the opening, then a moulding around the arch and a cornice under the vault.
        for (z0, z1) in [(-BAY * 0.5, -arcade.half), (arcade.half, BAY * 0.5)] {
            let x0 = side * COLUMN_X - ARCADE * 0.5;
            let p = |x: f64, z: f64| DVec3::new(x0 + x, COLUMN_TOP, z);
            walls.quad(p(0.0, z0), p(ARCADE, z0), p(ARCADE, z1), p(0.0, z1));
        }
        if detail.is_full() {
            trim.tube(&arcade.edge(stand, arc, 0.16, ARCADE * 0.5), 0.075, detail.steps(8.0, 4));
        }
        let (x0, x1) = (side * inner, side * (inner - 0.16));
        let z = BAY * 0.5;
        trim.cuboid_faces(
            DVec3::new(x0.min(x1), VAULT - 0.22, -z),
            DVec3::new(x0.max(x1), VAULT, z),
            [true, true, true, true, false, false],
        );
    }
    let mut sky = Shape::textured(0.4);
    vault(&mut sky, VAULT, inner, [BAY * 0.5, -BAY * 0.5], [arc, detail.steps(4.0, 1)]);
    let mut boards = Shape::textured(0.5);
    for side in [-1.0, 1.0] {
        let (x0, x1) = (side * COLUMN_X, side * WALL_X);
        let (x0, x1, z) = (x0.min(x1), x0.max(x1), BAY * 0.5);
        let p = |x: f64, z: f64| DVec3::new(x, AISLE, z);
        boards.quad(p(x0, -z), p(x1, -z), p(x1, z), p(x0, z));
        let beam = DVec3::new(x0, AISLE - 0.3, -0.15);
        boards.cuboid_faces(beam, DVec3::new(x1, AISLE, 0.15), [false, false, true, false, true, true]);
    }
    let bay =
        a.mesh("bay", [(walls, stuff.ashlar), (trim, stuff.stone), (sky, stuff.stars), (boards, stuff.wood)]);

    // The left outer wall has blind bays of brick.
    let mut left = Shape::textured(1.0);
    let x = -WALL_X + WALL * 0.5;
    let p = |y: f64, z: f64| DVec3::new(x, y, z);
    left.patches([p(0., BAY * 0.5), p(0., -BAY * 0.5), p(AISLE, -BAY * 0.5), p(AISLE, BAY * 0.5)], 2, 3);
    let mut dado = Shape::textured(0.6);
    let (low, high) = (DVec3::new(x, 0.0, -BAY * 0.5), DVec3::new(x + 0.06, 1.1, BAY * 0.5));
    dado.cuboid_faces(low, high, [false, true, false, true, false, false]);
    let left = a.mesh("left wall", [(left, stuff.bricks), (dado, stuff.wood)]);

    // A rib spans the vault above every pair of columns and comes down as a pilaster.
    let mut rib = Shape::new();
    let path: Vec<DVec3> = (0..=arc)
        .map(|k| {
            let (sin, cos) = half_turn(k, arc);
            DVec3::new(-inner * cos, VAULT + inner * sin, 0.0)
        })
        .collect();
    rib.tube(&path, 0.17, detail.steps(12.0, 4));
    for side in [-1.0, 1.0] {
        let (x0, x1) = (side * inner, side * (inner - 0.14));
        rib.cuboid_faces(
            DVec3::new(x0.min(x1), COLUMN_TOP, -0.22),
            DVec3::new(x0.max(x1), VAULT - 0.22, 0.22),
            [true, true, true, false, true, true],
        );
    }
    let rib = a.mesh("rib", [(rib, stuff.stone)]);

    for k in 0..detail.bays {
        let z = FRONT - BAY * (k as f64 + 0.5);
        a.place(bay, DMat4::from_translation(DVec3::Z * z));
        a.place(left, DMat4::from_translation(DVec3::Z * z));
    }
    for k in 0..=detail.bays {
        let z = FRONT - BAY * k as f64;
        a.place(rib, DMat4::from_translation(DVec3::Z * z));
        for side in [-1.0, 1.0] {
            a.place(column, DMat4::from_translation(DVec3::new(side * COLUMN_X, 0.0, z)));
        }
    }
}

/// The wall behind the camera, and the far one with a great window to the garden.
fn end_walls(a: &mut Assembly, stuff: &Stuff, detail: Detail, back: f64) {
    const HEIGHT: f64 = 12.4;
    let (w, z) = (WALL_X + WALL, FRONT);
    let mut front = Shape::textured(0.5);
    let p = |x: f64, y: f64| DVec3::new(x, y, z);
    front.quad(p(w, 0.0), p(-w, 0.0), p(-w, HEIGHT), p(w, HEIGHT));
    let mut door = Shape::textured(0.5);
    door.cuboid_faces(
        DVec3::new(-1.4, 0.0, z - 0.1),
        DVec3::new(1.4, 3.4, z),
        [true, true, false, true, true, false],
    );
    a.add("front wall", [(front, stuff.ashlar), (door, stuff.wood)]);

    let window =
        Opening { width: 2.0 * w, height: HEIGHT, thickness: 0.6, half: 2.4, sill: 0.9, spring: 5.2 };
    let stand = Stand { foot: DVec3::Z * back, along: DVec3::X, front: DVec3::Z };
    let mut wall = Shape::textured(0.5);
    let arc = detail.steps(40.0, 6);
    window.wall(&mut wall, stand, arc);
    // Two mullions, two transoms, and a fan of coloured glass in the arch.
    let mut bars = Shape::new();
    for x in [-0.8, 0.8] {
        bars.cuboid(
            DVec3::new(x - 0.09, window.sill, back - 0.1),
            DVec3::new(x + 0.09, window.spring, back + 0.1),
        );
    }
    for y in [3.1, window.spring] {
        bars.cuboid(
            DVec3::new(-window.half, y - 0.08, back - 0.08),
            DVec3::new(window.half, y + 0.08, back + 0.08),
        );
    }
    let mut trim = Shape::new();
    if detail.is_full() {
        trim.tube(&window.edge(stand, arc, 0.25, 0.3), 0.14, detail.steps(10.0, 4));
    }
    let mut parts = vec![(wall, stuff.ashlar), (bars, stuff.stone), (trim, stuff.stone)];
    const SECTORS: usize = 9;
    let centre = DVec3::new(0.0, window.spring, back);
    for (ring, radii) in [[0.0, 0.8], [0.8, 1.6], [1.6, window.half]].into_iter().enumerate() {
        for k in 0..SECTORS {
            let ends = [k, k + 1].map(|k| {
                let (sin, cos) = half_turn(k, SECTORS);
                DVec3::new(-cos, sin, 0.0)
            });
            let mut sector = Shape::new();
            let p = |end: usize, r: f64| centre + ends[end] * r;
            if ring == 0 {
                let corner = [p(0, 0.0), p(1, radii[1]), p(0, radii[1])];
                let [a, b, c] = corner.map(|q| sector.vertex(q, DVec3::Z, DVec2::ZERO));
                sector.triangles.push([a, b, c]);
            } else {
                sector.quad(p(1, radii[0]), p(1, radii[1]), p(0, radii[1]), p(0, radii[0]));
            }
            parts.push((sector, stuff.panes[(k * 2 + ring * 3) % stuff.panes.len()]));
        }
    }
    a.add("far wall", parts);
}

/// The right outer wall: pierced screens and coloured glass in turn.
fn windows(a: &mut Assembly, stuff: &Stuff, detail: Detail, seed: u64) {
    let opening = Opening { width: BAY, height: AISLE, thickness: WALL, half: 1.05, sill: 1.1, spring: 4.2 };
    let stand = Stand { foot: DVec3::X * WALL_X, along: DVec3::Z, front: DVec3::NEG_X };
    let mut wall = Shape::textured(0.5);
    opening.wall(&mut wall, stand, detail.steps(20.0, 3));
    let wall = a.mesh("window wall", [(wall, stuff.ashlar)]);

    // The screen fills the opening's bounding rectangle; its corners are buried in the wall.
    let mut screen = Shape::textured(1.43);
    let top = opening.spring + opening.half;
    let p = |y: f64, z: f64| DVec3::new(WALL_X, y, z);
    let (z, sill) = (opening.half, opening.sill);
    let cells = if detail.is_full() { (3, 6) } else { (1, 2) };
    screen.patches([p(sill, -z), p(sill, z), p(top, z), p(top, -z)], cells.0, cells.1);
    let screen = a.mesh("screen", [(screen, stuff.screen)]);

    const ACROSS: usize = 4;
    const UP: usize = 8;
    let mut rng = Rng::new(seed, 1);
    for k in 0..detail.bays {
        let at = DMat4::from_translation(DVec3::Z * (FRONT - BAY * (k as f64 + 0.5)));
        a.place(wall, at);
        if k % 2 == 0 || !detail.is_full() {
            a.place(screen, at);
            continue;
        }
        let mut panes: [Shape; 6] = Default::default();
        let mut lead = Shape::new();
        let (w, h) = (2.0 * z / ACROSS as f64, (top - sill) / UP as f64);
        for j in 0..UP {
            for i in 0..=ACROSS / 2 - 1 {
                // Mirrored halves.
                let which = rng.below(panes.len());
                for i in [i, ACROSS - 1 - i] {
                    let (z0, y0) = (i as f64 * w - z, sill + j as f64 * h);
                    panes[which].quad(p(y0, z0), p(y0, z0 + w), p(y0 + h, z0 + w), p(y0 + h, z0));
                }
            }
            let y = sill + j as f64 * h;
            lead.cuboid(DVec3::new(WALL_X - 0.03, y - 0.02, -z), DVec3::new(WALL_X + 0.03, y + 0.02, z));
        }
        for i in 1..ACROSS {
            let z0 = i as f64 * w - z;
            lead.cuboid(
                DVec3::new(WALL_X - 0.03, sill, z0 - 0.02),
                DVec3::new(WALL_X + 0.03, top, z0 + 0.02),
            );
        }
        let parts = panes.into_iter().zip(stuff.panes).chain([(lead, stuff.lead)]);
        let window = a.mesh("coloured window", parts);
        a.place(window, at);
    }
}

/// Square tiles in two marbles, both polished.
fn floor(a: &mut Assembly, stuff: &Stuff, detail: Detail, back: f64) {
    let side = if detail.bays == 1 { 2 } else { 1 };
    let (mut light, mut dark) = (Shape::textured(0.5), Shape::textured(0.5));
    // Whole tiles from the middle out, the last ones under the walls.
    let half_width = ((WALL_X + WALL) / side as f64).ceil() as i64;
    for z in back as i64 / side..FRONT as i64 / side {
        for x in -half_width..half_width {
            let shape = if (x + z).rem_euclid(2) == 0 { &mut light } else { &mut dark };
            let p = |dx: i64, dz: i64| DVec3::new(((x + dx) * side) as f64, 0.0, ((z + dz) * side) as f64);
            shape.quad(p(0, 1), p(1, 1), p(1, 0), p(0, 0));
        }
    }
    a.add("floor", [(light, stuff.light), (dark, stuff.dark)]);
}

/// A garden before the far window: lawn that rises to hills, and cypresses.
fn outside(a: &mut Assembly, stuff: &Stuff, detail: Detail, back: f64) {
    const FAR: f64 = 70.0;
    let height = |x: f64, away: f64| {
        let t = away / FAR;
        let waves = 0.7 + 0.3 * libm::sin(0.11 * x + 0.6) + 0.16 * libm::sin(0.23 * x + 0.05 * away);
        t * t * 8.5 * waves - 0.05
    };
    let at = |x: f64, away: f64| DVec3::new(x, height(x, away), back - 0.5 - away);
    let mut lawn = Shape::new();
    let (nu, nv) = (detail.steps(36.0, 1), detail.steps(24.0, 1));
    lawn.grid(nu, nv, |i, j| {
        let (x, away) = (80.0 * (i as f64 / nu as f64 - 0.5), FAR * j as f64 / nv as f64);
        let (dx, dz) = (at(x + 0.1, away) - at(x, away), at(x, away + 0.1) - at(x, away));
        (at(x, away), dx.cross(dz).normalize(), DVec2::ZERO)
    });
    let mut trees = Shape::new();
    if detail.is_full() {
        let places = [
            (-3.6, 9.0, 5.2),
            (3.1, 12.0, 5.8),
            (-1.7, 26.0, 6.5),
            (6.0, 30.0, 7.0),
            (-8.0, 34.0, 7.5),
            (1.4, 44.0, 6.5),
            (9.5, 50.0, 7.5),
            (-5.2, 56.0, 7.0),
        ];
        for (x, away, tall) in places {
            furnishing::cypress(&mut trees, at(x, away), tall, detail);
        }
    }
    a.add("garden", [(lawn, stuff.grass), (trees, stuff.cypress)]);
}

fn lights(a: &mut Assembly) {
    a.sun([-0.80, -0.50, -0.33], [7.4, 6.7, 5.5]);
    let scene = a.scene();
    scene.ambient = [0.20, 0.20, 0.23];
    scene.environment = Environment::Gradient {
        zenith: [0.07, 0.20, 0.60],
        horizon: [0.66, 0.80, 0.93],
        nadir: [0.30, 0.32, 0.28],
    };
    a.camera("nave", [-0.9, 1.7, 5.3], [0.35, 2.75, -8.0], 60.0);
    a.camera("aisle", [5.7, 1.7, 4.6], [2.2, 1.9, -8.0], 60.0);
    a.camera("floor", [-2.2, 0.55, 3.2], [1.0, 1.0, -2.5], 50.0);
}
