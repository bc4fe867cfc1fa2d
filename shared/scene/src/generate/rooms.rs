//! Storeys of furnished rooms along corridors, in place of Soda Hall: nearly every face is a quad with four vertices of its own,
//! large axis-aligned walls beside small furniture, a minority of finely divided round things, no textures, polished floors.
//!
//! One plan serves all storeys. Furniture is instanced; every room is filled up to its share of the triangles, and stacks of
//! books make up what is missing at the end.

use super::Recipe;
use super::assembly::{Assembly, MeshId, glowing, matte, mirror, pane, polished};
use super::fittings::{BOOK_TRIANGLES, Catalogue, Paints};
use super::rng::Rng;
use super::row::Reference;
use super::shapes::{Shape, turned};
use crate::{Environment, Scene};
use glam::{DMat4, DVec3};

/// Height of a storey.
const STOREY: f64 = 3.2;
/// Half the thickness of a floor slab.
const SLAB: f64 = 0.15;
/// Half the thickness of an inner wall.
const PARTITION: f64 = 0.08;
/// Width of a corridor.
const CORRIDOR: f64 = 2.2;
/// Edges of Soda Hall's box relative to the longest.
const BOX: [f64; 3] = [1.0, 317.0 / 358.0, 203.0 / 358.0];
/// A room's furniture comes to about so many triangles.
const ROOM_TRIANGLES: f64 = 5_500.0;

pub(super) fn generate(recipe: &Recipe) -> Scene {
    let plan = Plan::new(recipe.triangles);
    let mut a = Assembly::new("rooms");
    let paints = paints(&mut a);
    shell(&mut a, &plan, &paints);
    let catalogue = Catalogue::new(&mut a, &paints, recipe.seed);
    corridors(&mut a, &plan, &catalogue);
    furnish(&mut a, &plan, &catalogue, recipe);
    books(&mut a, &plan, &paints, recipe);
    views(&mut a, &plan);
    a.finish()
}

/// Where the walls are. The building's middle lies at x = z = 0, its foot at y = 0.
struct Plan {
    storeys: usize,
    columns: usize,
    rows: usize,
    width: f64,
    depth: f64,
}

/// The inside of a room, between finished walls.
#[derive(Clone, Copy)]
struct Room {
    /// Middle of the floor.
    centre: DVec3,
    /// Along x.
    width: f64,
    /// Along z.
    depth: f64,
    /// Quarter turns that bring the door from -z to where it is.
    quarters: usize,
    /// Whether the wall that faces the door is an outer one.
    window: bool,
}

impl Plan {
    fn new(triangles: u32) -> Self {
        let storeys = libm::cbrt(f64::from(triangles) / ROOM_TRIANGLES).round().clamp(1.0, 16.0);
        let width = storeys * STOREY / BOX[2];
        let depth = width * BOX[1];
        // Two rows along every corridor; a single storey is a single room.
        let rows = if storeys == 1.0 { 1 } else { 2 * ((depth / 12.0).round().max(1.0) as usize) };
        let columns = (width / 4.8).round().max(1.0) as usize;
        Self { storeys: storeys as usize, columns, rows, width, depth }
    }

    fn corridors(&self) -> usize {
        self.rows / 2
    }

    fn room_depth(&self) -> f64 {
        (self.depth - CORRIDOR * self.corridors() as f64) / self.rows as f64
    }

    /// The room of the ground storey in this row, from the front, and column.
    fn room(&self, row: usize, column: usize) -> Room {
        let (cell, depth) = (self.width / self.columns as f64, self.room_depth());
        // Going back: row, corridor, row, row, corridor, row ...
        let before = row as f64 * depth + row.div_ceil(2) as f64 * CORRIDOR;
        let z = self.depth * 0.5 - before - depth * 0.5;
        let x = -self.width * 0.5 + (column as f64 + 0.5) * cell;
        Room {
            centre: DVec3::new(x, SLAB, z),
            width: cell - 2.0 * PARTITION,
            depth: depth - 2.0 * PARTITION,
            quarters: 2 * (row % 2),
            window: row == 0 || row + 1 == self.rows,
        }
    }

    /// Middle of a corridor along z.
    fn corridor(&self, index: usize) -> f64 {
        let pair = 2.0 * self.room_depth() + CORRIDOR;
        self.depth * 0.5 - pair * index as f64 - self.room_depth() - CORRIDOR * 0.5
    }

    fn rooms(&self) -> impl Iterator<Item = (usize, Room)> {
        (0..self.storeys).flat_map(move |s| {
            (0..self.rows).flat_map(move |r| (0..self.columns).map(move |c| (s, self.room(r, c))))
        })
    }
}

impl Room {
    /// From the room's own space (middle of the floor, door at -z) to its storey's.
    fn place(&self, at: DVec3, quarters: usize) -> DMat4 {
        turned(self.centre, self.quarters) * turned(at, quarters)
    }
}

fn paints(a: &mut Assembly) -> Paints {
    Paints {
        wall: a.material(matte("wall", [0.80, 0.78, 0.73])),
        facade: a.material(matte("facade", [0.62, 0.52, 0.42])),
        ceiling: a.material(matte("ceiling", [0.86, 0.86, 0.84])),
        floor: a.material(polished(matte("room floor", [0.42, 0.27, 0.15]), 0.10)),
        corridor: a.material(polished(matte("corridor floor", [0.36, 0.38, 0.40]), 0.16)),
        window: a.material(pane("window", [0.92, 0.96, 0.95])),
        wood: a.material(matte("wood", [0.50, 0.33, 0.18])),
        dark: a.material(matte("dark", [0.05, 0.05, 0.06])),
        metal: a.material(mirror("metal", [0.75, 0.75, 0.77])),
        cloth: a.material(matte("cloth", [0.16, 0.24, 0.38])),
        leaf: a.material(matte("leaf", [0.14, 0.36, 0.09])),
        lamp: a.material(glowing("lamp", [1.0, 0.97, 0.9])),
        screen: a.material(glowing("screen", [0.20, 0.34, 0.55])),
        books: [
            [0.52, 0.10, 0.08],
            [0.10, 0.22, 0.42],
            [0.12, 0.34, 0.18],
            [0.70, 0.56, 0.22],
            [0.66, 0.62, 0.54],
            [0.30, 0.14, 0.32],
        ]
        .map(|c| a.material(matte("book", c))),
    }
}

/// A wall face from `foot` along `along`, front towards `along` x up, with a rectangular hole `[s0, s1, t0, t1]`.
fn face(shape: &mut Shape, foot: DVec3, along: DVec3, [w, h]: [f64; 2], hole: Option<[f64; 4]>) {
    let mut piece = |s0: f64, s1: f64, t0: f64, t1: f64| {
        let p = |s: f64, t: f64| foot + along * s + DVec3::Y * t;
        if s1 > s0 && t1 > t0 {
            shape.quad(p(s0, t0), p(s1, t0), p(s1, t1), p(s0, t1));
        }
    };
    match hole {
        None => piece(0.0, w, 0.0, h),
        Some([s0, s1, t0, t1]) => {
            piece(0.0, s0, 0.0, h);
            piece(s1, w, 0.0, h);
            piece(s0, s1, 0.0, t0);
            piece(s0, s1, t1, h);
        }
    }
}

/// The lining of a hole through a wall, from the face at `foot` back by `thickness`.
fn lining(shape: &mut Shape, foot: DVec3, along: DVec3, [s0, s1, t0, t1]: [f64; 4], thickness: f64) {
    let back = along.cross(DVec3::Y) * -thickness;
    let p = |s: f64, t: f64| foot + along * s + DVec3::Y * t;
    let (a, b, c, d) = (p(s0, t0), p(s1, t0), p(s1, t1), p(s0, t1));
    shape.quad(a, a + back, d + back, d);
    shape.quad(b + back, b, c, c + back);
    shape.quad(a + back, a, b, b + back);
    shape.quad(d, d + back, c + back, c);
}

/// Walls, floors, ceilings and windows of one storey, placed for each; ground and roof.
fn shell(a: &mut Assembly, plan: &Plan, paints: &Paints) {
    let (mut walls, mut facade, mut floor) = (Shape::new(), Shape::new(), Shape::new());
    let (mut ceiling, mut corridor, mut glass) = (Shape::new(), Shape::new(), Shape::new());
    let clear = STOREY - 2.0 * SLAB;
    let (w, d) = (plan.width, plan.depth);
    let cell = w / plan.columns as f64;
    for row in 0..plan.rows {
        for column in 0..plan.columns {
            let room = plan.room(row, column);
            let turn = turned(DVec3::ZERO, room.quarters);
            // Corners in the room's own space, turned and shifted.
            let at = |x: f64, z: f64| room.centre + turn.transform_vector3(DVec3::new(x, 0.0, z));
            let way = |x: f64, z: f64| turn.transform_vector3(DVec3::new(x, 0.0, z));
            let (x, z) = (room.width * 0.5, room.depth * 0.5);
            let up = DVec3::Y * clear;
            floor.quad(at(-x, z), at(x, z), at(x, -z), at(-x, -z));
            ceiling.quad(at(-x, -z) + up, at(x, -z) + up, at(x, z) + up, at(-x, z) + up);
            face(&mut walls, at(-x, z), way(0.0, -1.0), [room.depth, clear], None);
            face(&mut walls, at(x, -z), way(0.0, 1.0), [room.depth, clear], None);
            let door = [room.width * 0.62, room.width * 0.62 + 0.95, 0.0, 2.1];
            let door = (plan.corridors() > 0).then_some(door);
            face(&mut walls, at(-x, -z), way(1.0, 0.0), [room.width, clear], door);
            if let Some(door) = door {
                lining(&mut walls, at(-x, -z), way(1.0, 0.0), door, 2.0 * PARTITION);
                // The wall's other side, towards the corridor, is as wide as the cell.
                let [s0, s1, t0, t1] = door;
                let (s0, s1) = (s0 + PARTITION, s1 + PARTITION);
                let outer = at(cell * 0.5, -z - 2.0 * PARTITION);
                face(&mut walls, outer, way(-1.0, 0.0), [cell, clear], Some([cell - s1, cell - s0, t0, t1]));
                // The threshold continues the corridor's floor.
                let p = |s: f64, z: f64| at(s - cell * 0.5, z);
                corridor.quad(p(s0, -z), p(s1, -z), p(s1, -z - 2.0 * PARTITION), p(s0, -z - 2.0 * PARTITION));
            }
            let hole = [room.width * 0.18, room.width * 0.82, 0.9, 2.4];
            let hole = (room.window).then_some(hole);
            face(&mut walls, at(x, z), way(-1.0, 0.0), [room.width, clear], hole);
            if let Some(hole @ [s0, s1, t0, t1]) = hole {
                lining(&mut walls, at(x, z), way(-1.0, 0.0), hole, PARTITION);
                let p = |s: f64, t: f64| at(x - s, z + 0.5 * PARTITION) + DVec3::Y * t;
                glass.quad(p(s0, t0), p(s1, t0), p(s1, t1), p(s0, t1));
                let foot = at(-cell * 0.5, z + PARTITION) - DVec3::Y * SLAB;
                let mirrored = [cell - s1 - PARTITION, cell - s0 - PARTITION, t0 + SLAB, t1 + SLAB];
                face(&mut facade, foot, way(1.0, 0.0), [cell, STOREY], Some(mirrored));
            }
            if plan.rows == 1 {
                let foot = at(cell * 0.5, -z - PARTITION) - DVec3::Y * SLAB;
                face(&mut facade, foot, way(-1.0, 0.0), [cell, STOREY], None);
            }
        }
    }
    for index in 0..plan.corridors() {
        let z = plan.corridor(index);
        // From wall to wall: a room's wall faces the corridor one partition inside the corridor's strip.
        let h = CORRIDOR * 0.5 - PARTITION;
        let p = |x: f64, z: f64, y: f64| DVec3::new(x, y, z);
        let (x, low, high) = (w * 0.5 - PARTITION, SLAB, STOREY - SLAB);
        corridor.quad(p(-x, z + h, low), p(x, z + h, low), p(x, z - h, low), p(-x, z - h, low));
        ceiling.quad(p(-x, z - h, high), p(x, z - h, high), p(x, z + h, high), p(-x, z + h, high));
        // Tall windows at both ends.
        let hole = [0.5, 2.0 * h - 0.5, 0.4, 2.5];
        for side in [-1.0, 1.0] {
            let along = DVec3::Z * side;
            let foot = p(x * side, z - h * side, low);
            face(&mut walls, foot, along, [2.0 * h, clear], Some(hole));
            lining(&mut walls, foot, along, hole, PARTITION);
            let [s0, s1, t0, t1] = hole;
            let q = |s: f64, t: f64| foot + along * s + DVec3::new(0.5 * PARTITION * side, t, 0.0);
            glass.quad(q(s0, t0), q(s1, t0), q(s1, t1), q(s0, t1));
        }
    }
    // Gables, with holes where corridors end, and the strips of the roof slab.
    for side in [-1.0, 1.0] {
        let x = w * 0.5 * side;
        let along = DVec3::Z * -side;
        let mut ends: Vec<f64> = (0..plan.corridors()).map(|k| plan.corridor(k) * -side).collect();
        ends.sort_by(f64::total_cmp);
        let mut from = -d * 0.5;
        let mut strip = |s0: f64, s1: f64, hole: Option<[f64; 4]>| {
            let foot = DVec3::new(x, 0.0, -side * s0);
            face(&mut facade, foot, along, [s1 - s0, STOREY], hole);
        };
        for end in ends {
            let (s0, s1) = (end - CORRIDOR * 0.5, end + CORRIDOR * 0.5);
            strip(from, s0, None);
            let hole = [0.5 + PARTITION, CORRIDOR - 0.5 - PARTITION, 0.4 + SLAB, 2.5 + SLAB];
            strip(s0, s1, Some(hole));
            from = s1;
        }
        strip(from, d * 0.5, None);
    }
    let storey = a.mesh(
        "storey",
        [
            (walls, paints.wall),
            (facade, paints.facade),
            (floor, paints.floor),
            (ceiling, paints.ceiling),
            (corridor, paints.corridor),
            (glass, paints.window),
        ],
    );
    for s in 0..plan.storeys {
        a.place(storey, DMat4::from_translation(DVec3::Y * (s as f64 * STOREY)));
    }
    let mut roof = Shape::new();
    let top = plan.storeys as f64 * STOREY;
    let p = |x: f64, z: f64, y: f64| DVec3::new(x * w * 0.5, y, z * d * 0.5);
    roof.quad(p(-1., 1., top), p(1., 1., top), p(1., -1., top), p(-1., -1., top));
    roof.quad(p(-1., -1., 0.), p(1., -1., 0.), p(1., 1., 0.), p(-1., 1., 0.));
    a.add("roof", [(roof, paints.facade)]);
}

/// Lamps and boards along the corridors, where there are enough triangles for more than walls.
fn corridors(a: &mut Assembly, plan: &Plan, catalogue: &Catalogue) {
    if plan.storeys < 3 {
        return;
    }
    let cell = plan.width / plan.columns as f64;
    for storey in 0..plan.storeys {
        let floor = storey as f64 * STOREY + SLAB;
        for index in 0..plan.corridors() {
            let z = plan.corridor(index);
            for k in 0..plan.columns {
                let x = -plan.width * 0.5 + (k as f64 + 0.5) * cell;
                let lamp = DVec3::new(x, floor + STOREY - 2.0 * SLAB, z);
                a.place(catalogue.ceiling_lamp, turned(lamp, 0));
                // Left of the doors of both sides.
                let half = CORRIDOR * 0.5 - PARTITION;
                let board = |dx: f64, dz: f64| DVec3::new(x + dx, floor + 1.6, z + dz);
                a.place(catalogue.picture[k % 2], turned(board(-0.8, half), 2));
                a.place(catalogue.picture[(k + 1) % 2], turned(board(0.8, -half), 0));
            }
        }
    }
}

/// Fills every room up to its share.
fn furnish(a: &mut Assembly, plan: &Plan, catalogue: &Catalogue, recipe: &Recipe) {
    let mut rng = Rng::new(recipe.seed, 10);
    let target = u64::from(recipe.triangles);
    let ratio = Reference::SODA_HALL.vertices_per_triangle();
    let mut left = (plan.storeys * plan.rows * plan.columns) as u64;
    for (storey, room) in plan.rooms() {
        let share = target.saturating_sub(a.total().triangles) / left;
        let limit = a.total().triangles + share;
        left -= 1;
        let base = DMat4::from_translation(DVec3::Y * (storey as f64 * STOREY));
        let put = |a: &mut Assembly, mesh: MeshId, at: DVec3, quarters: usize| {
            let fits = a.total().triangles + a.count(mesh).triangles <= limit;
            if fits {
                a.place(mesh, base * room.place(at, quarters));
            }
            fits
        };
        let (x, z) = (room.width * 0.5, room.depth * 0.5);
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        put(a, catalogue.ceiling_lamp, at(0.0, STOREY - 2.0 * SLAB, 0.0), 0);
        // A desk at the left wall under a picture, its chair before it; a shelf left of the door.
        let has_desk = put(a, catalogue.desk, at(-x, 0.0, z * 0.35), 1);
        put(a, catalogue.chair, at(-x + 1.05, 0.0, z * 0.35 + rng.range(-0.2, 0.2)), 3);
        // Round things only while faces with vertices of their own are in excess.
        let corners =
            [at(-x + 0.45, 0.0, z - 0.45), at(-x + 1.1, 0.0, z - 0.3), at(-x + 0.35, 0.741, z * 0.35 - 0.55)];
        for (corner, mesh) in corners.into_iter().zip([catalogue.pot, catalogue.floor_lamp, catalogue.globe])
        {
            let total = a.total();
            let wanted = total.vertices as f64 > ratio * total.triangles as f64;
            if has_desk && wanted && rng.chance(0.8) {
                put(a, mesh, corner, 0);
            }
        }
        let shelf = |a: &mut Assembly, rng: &mut Rng, place: DVec3, quarters: usize| {
            put(a, catalogue.shelf[rng.below(catalogue.shelf.len())], place, quarters)
        };
        let beside_door = ((room.width * 0.6 - 0.3) / 1.05) as usize;
        for k in 0..beside_door {
            shelf(a, &mut rng, at(-x + 0.75 + 1.05 * k as f64, 0.0, -z), 0);
        }
        put(a, catalogue.picture[rng.below(2)], at(-x, 1.75, z * 0.3), 1);
        // A table with chairs in the middle, or a second desk.
        if rng.chance(0.6) {
            if put(a, catalogue.table, at(0.25, 0.0, 0.1), 0) {
                for (dx, dz, quarters) in
                    [(-0.75, -0.35, 1), (-0.75, 0.4, 1), (0.75, 0.35, 3), (0.75, -0.4, 3)]
                {
                    put(a, catalogue.chair, at(0.25 + dx, 0.0, 0.1 + dz), quarters);
                }
            }
        } else {
            put(a, catalogue.desk, at(-x, 0.0, -z * 0.35), 1);
            put(a, catalogue.chair, at(-x + 1.1, 0.0, -z * 0.35), 3);
        }
        if room.window {
            put(a, catalogue.radiator, at(0.0, 0.0, z), 2);
            if rng.chance(0.6) {
                put(a, catalogue.blind, at(0.0, 2.4, z - 0.05), 2);
            }
        }
        // Shelves along the right wall.
        for k in 0..((room.depth - 0.8) / 1.05) as usize {
            if rng.chance(0.8) {
                shelf(a, &mut rng, at(x, 0.0, z - 0.75 - 1.05 * k as f64), 3);
            }
        }
    }
}

/// Stacks of books along the walls of the rooms, as many as are wanting.
fn books(a: &mut Assembly, plan: &Plan, paints: &Paints, recipe: &Recipe) {
    const IN_STACK: u64 = 24;
    let missing = u64::from(recipe.triangles).saturating_sub(a.total().triangles);
    let mut count = missing / BOOK_TRIANGLES;
    let rooms = (plan.storeys * plan.rows * plan.columns) as u64;
    let in_room = count.div_ceil(rooms).max(IN_STACK);
    let mut rng = Rng::new(recipe.seed, 11);
    let mut stacks: [Shape; 6] = Default::default();
    for (storey, room) in plan.rooms() {
        let here = count.min(in_room);
        count -= here;
        for k in 0..here {
            let (stack, height) = (k / IN_STACK, k % IN_STACK);
            // Along the wall of the door, left of it, then in further rows.
            let across = (room.width * 0.5 / 0.32) as u64;
            let (i, j) = (stack % across, stack / across);
            let at = DVec3::new(
                -room.width * 0.5 + 0.2 + 0.32 * i as f64 + rng.range(-0.02, 0.02),
                0.045 * height as f64 + storey as f64 * STOREY,
                -room.depth * 0.5 + 0.2 + 0.3 * j as f64 + rng.range(-0.02, 0.02),
            );
            let mut book = Shape::new();
            let (w, d) = (rng.range(0.09, 0.13), rng.range(0.07, 0.10));
            let faces = [true, true, false, true, true, true];
            book.cuboid_faces(DVec3::new(-w, 0.0, -d), DVec3::new(w, 0.043, d), faces);
            stacks[rng.below(6)].append(&book, &room.place(at, 0));
        }
        if count == 0 {
            break;
        }
    }
    a.add("stacks of books", stacks.into_iter().zip(paints.books));
}

fn views(a: &mut Assembly, plan: &Plan) {
    let room = plan.room(0, plan.columns / 2);
    let (c, x, z) = (room.centre, room.width * 0.5, room.depth * 0.5);
    let eye = c + DVec3::new(x - 0.55, 1.68, z - 0.2);
    let target = c + DVec3::new(-x * 0.62, 0.78, -z * 0.62);
    a.camera("room", eye.to_array(), target.to_array(), 68.0);
    // Two lamps where the cameras are; elsewhere the sun and the sky must do.
    a.point_light("room lamp", c + DVec3::Y * 2.55, [5.2, 4.8, 4.2]);
    if plan.corridors() > 0 {
        let corridor = plan.corridor(0);
        let end = plan.width * 0.5 - 0.6;
        let at = |x: f64, y: f64| [x, SLAB + y, corridor + 0.35];
        a.camera("corridor", at(-end, 1.6), [end, SLAB + 1.1, corridor - 0.3], 60.0);
        for x in [-0.5, 0.15] {
            let lamp = DVec3::new(x * plan.width, SLAB + 2.6, corridor);
            a.point_light("corridor lamp", lamp, [4.2, 4.2, 4.4]);
        }
    }
    let (w, h) = (plan.width, plan.storeys as f64 * STOREY);
    a.camera("outside", [w * 1.05, h * 1.15, w * 1.45], [0.0, h * 0.42, 0.0], 40.0);
    a.sun([-0.42, -0.62, -0.72], [3.4, 3.1, 2.6]);
    let scene = a.scene();
    scene.ambient = [0.34, 0.35, 0.37];
    scene.environment = Environment::Gradient {
        zenith: [0.22, 0.42, 0.80],
        horizon: [0.80, 0.87, 0.94],
        nadir: [0.30, 0.29, 0.27],
    };
}
