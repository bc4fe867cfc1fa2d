//! Furniture of the rooms. A piece stands at the origin with its back to the wall at z = 0 and faces +z.

use super::assembly::{Assembly, MeshId};
use super::rng::Rng;
use super::shapes::{Shape, perpendicular};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Triangles of a book: five faces, for the sixth is never seen.
pub(super) const BOOK_TRIANGLES: u64 = 10;

/// The rooms' materials.
pub(super) struct Paints {
    pub(super) wall: usize,
    pub(super) facade: usize,
    pub(super) ceiling: usize,
    pub(super) floor: usize,
    pub(super) corridor: usize,
    pub(super) window: usize,
    pub(super) wood: usize,
    pub(super) dark: usize,
    pub(super) metal: usize,
    pub(super) cloth: usize,
    pub(super) leaf: usize,
    pub(super) lamp: usize,
    pub(super) screen: usize,
    pub(super) books: [usize; 6],
}

/// One mesh of every piece.
pub(super) struct Catalogue {
    pub(super) desk: MeshId,
    pub(super) chair: MeshId,
    pub(super) table: MeshId,
    pub(super) shelf: [MeshId; 4],
    pub(super) picture: [MeshId; 2],
    pub(super) radiator: MeshId,
    pub(super) blind: MeshId,
    pub(super) ceiling_lamp: MeshId,
    pub(super) pot: MeshId,
    pub(super) floor_lamp: MeshId,
    pub(super) globe: MeshId,
}

impl Catalogue {
    pub(super) fn new(a: &mut Assembly, paints: &Paints, seed: u64) -> Self {
        let mut rng = Rng::new(seed, 12);
        Self {
            desk: desk(a, paints),
            chair: chair(a, paints),
            table: table(a, paints),
            shelf: [(); 4].map(|()| shelf(a, paints, &mut rng)),
            picture: [0, 3].map(|color| picture(a, paints, color)),
            radiator: radiator(a, paints),
            blind: blind(a, paints),
            ceiling_lamp: ceiling_lamp(a, paints),
            pot: pot(a, paints, &mut rng),
            floor_lamp: floor_lamp(a, paints),
            globe: globe(a, paints),
        }
    }
}

/// A box by its low corner and size.
fn part(shape: &mut Shape, low: [f64; 3], size: [f64; 3]) {
    let low = DVec3::from_array(low);
    shape.cuboid(low, low + DVec3::from_array(size));
}

/// Top, sides, drawers, a screen and a keyboard with every key.
fn desk(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut wood, mut dark, mut metal, mut screen) =
        (Shape::new(), Shape::new(), Shape::new(), Shape::new());
    part(&mut wood, [-0.80, 0.71, 0.0], [1.60, 0.03, 0.75]);
    part(&mut wood, [-0.79, 0.0, 0.02], [0.03, 0.71, 0.70]);
    part(&mut wood, [0.30, 0.05, 0.05], [0.45, 0.66, 0.65]);
    for k in 0..3 {
        let y = 0.08 + 0.21 * f64::from(k);
        part(&mut wood, [0.31, y, 0.70], [0.43, 0.19, 0.015]);
        part(&mut metal, [0.46, y + 0.09, 0.715], [0.13, 0.012, 0.02]);
    }
    part(&mut dark, [-0.45, 0.745, 0.18], [0.22, 0.012, 0.18]);
    part(&mut dark, [-0.37, 0.75, 0.22], [0.06, 0.12, 0.03]);
    part(&mut dark, [-0.62, 0.85, 0.22], [0.56, 0.35, 0.03]);
    let y = |t: f64| 0.865 + 0.32 * t;
    let p = |x: f64, t: f64| DVec3::new(x, y(t), 0.2505);
    screen.quad(p(-0.605, 0.0), p(-0.075, 0.0), p(-0.075, 1.0), p(-0.605, 1.0));
    part(&mut dark, [-0.56, 0.74, 0.44], [0.44, 0.015, 0.16]);
    let no_bottom = [true, true, false, true, true, true];
    for row in 0..5 {
        for column in 0..14 {
            let low = DVec3::new(-0.55 + 0.030 * f64::from(column), 0.755, 0.45 + 0.029 * f64::from(row));
            metal.cuboid_faces(low, low + DVec3::new(0.024, 0.008, 0.023), no_bottom);
        }
    }
    a.mesh(
        "desk",
        [(wood, paints.wood), (dark, paints.dark), (metal, paints.facade), (screen, paints.screen)],
    )
}

/// Faces +z, its middle at the origin.
fn chair(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut wood, mut cloth) = (Shape::new(), Shape::new());
    for x in [-0.21, 0.17] {
        for z in [-0.21, 0.17] {
            let height = if z < 0.0 { 0.92 } else { 0.43 };
            part(&mut wood, [x, 0.0, z], [0.04, height, 0.04]);
        }
    }
    for k in 0..4 {
        part(&mut wood, [-0.17, 0.56 + 0.09 * f64::from(k), -0.20], [0.34, 0.05, 0.02]);
    }
    part(&mut cloth, [-0.22, 0.43, -0.20], [0.44, 0.05, 0.42]);
    a.mesh("chair", [(wood, paints.wood), (cloth, paints.cloth)])
}

/// Its middle at the origin.
fn table(a: &mut Assembly, paints: &Paints) -> MeshId {
    let mut wood = Shape::new();
    part(&mut wood, [-0.45, 0.72, -0.80], [0.90, 0.03, 1.60]);
    for x in [-0.40, 0.34] {
        for z in [-0.74, 0.68] {
            part(&mut wood, [x, 0.0, z], [0.06, 0.72, 0.06]);
        }
    }
    a.mesh("table", [(wood, paints.wood)])
}

/// Six boards of books, no two alike.
fn shelf(a: &mut Assembly, paints: &Paints, rng: &mut Rng) -> MeshId {
    let mut wood = Shape::new();
    let mut books: [Shape; 6] = Default::default();
    part(&mut wood, [-0.50, 0.0, 0.0], [0.02, 2.1, 0.30]);
    part(&mut wood, [0.48, 0.0, 0.0], [0.02, 2.1, 0.30]);
    part(&mut wood, [-0.48, 0.0, 0.0], [0.96, 2.1, 0.01]);
    for board in 0..7 {
        let y = 0.06 + 0.335 * f64::from(board);
        part(&mut wood, [-0.48, y, 0.01], [0.96, 0.02, 0.29]);
        if board == 6 {
            continue;
        }
        let mut x = -0.475;
        loop {
            let thick = rng.range(0.028, 0.085);
            if x + thick > 0.475 {
                break;
            }
            let low = DVec3::new(x, y + 0.0205, 0.03);
            let size = DVec3::new(thick - 0.001, rng.range(0.18, 0.29), rng.range(0.16, 0.24));
            let no_back = [true, true, true, true, false, true];
            books[rng.below(6)].cuboid_faces(low, low + size, no_back);
            x += thick + if rng.chance(0.06) { rng.range(0.05, 0.2) } else { 0.0 };
        }
    }
    a.mesh("shelf", books.into_iter().zip(paints.books).chain([(wood, paints.wood)]))
}

/// A frame on the wall around its middle.
fn picture(a: &mut Assembly, paints: &Paints, color: usize) -> MeshId {
    let (mut frame, mut field, mut figure) = (Shape::new(), Shape::new(), Shape::new());
    let (w, h) = (0.6, 0.42);
    part(&mut frame, [-w, -h, 0.0], [2.0 * w, 0.04, 0.03]);
    part(&mut frame, [-w, h - 0.04, 0.0], [2.0 * w, 0.04, 0.03]);
    part(&mut frame, [-w, -h + 0.04, 0.0], [0.04, 2.0 * h - 0.08, 0.03]);
    part(&mut frame, [w - 0.04, -h + 0.04, 0.0], [0.04, 2.0 * h - 0.08, 0.03]);
    let p = |x: f64, y: f64, z: f64| DVec3::new(x * w, y * h, z);
    field.quad(p(-1., -1., 0.01), p(1., -1., 0.01), p(1., 1., 0.01), p(-1., 1., 0.01));
    for k in 0..5 {
        let x = -0.7 + 0.3 * f64::from(k);
        let y = 0.2 + 0.15 * f64::from((k * 2) % 5);
        figure.quad(p(x, -0.6, 0.012), p(x + 0.22, -0.6, 0.012), p(x + 0.22, y, 0.012), p(x, y, 0.012));
    }
    let figures = [(field, paints.books[4]), (figure, paints.books[color])];
    a.mesh("picture", [(frame, paints.dark)].into_iter().chain(figures))
}

/// Fins under the window.
fn radiator(a: &mut Assembly, paints: &Paints) -> MeshId {
    let mut fins = Shape::new();
    for k in 0..20 {
        part(&mut fins, [-0.6 + 0.06 * f64::from(k), 0.15, 0.03], [0.045, 0.6, 0.09]);
    }
    part(&mut fins, [-0.62, 0.2, 0.06], [1.24, 0.03, 0.03]);
    a.mesh("radiator", [(fins, paints.ceiling)])
}

/// Tilted slats that hang from the origin.
fn blind(a: &mut Assembly, paints: &Paints) -> MeshId {
    let mut slats = Shape::new();
    for k in 0..26 {
        let y = -0.03 - 0.035 * f64::from(k);
        let p = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        slats.quad(p(-1.4, y, 0.03), p(1.4, y, 0.03), p(1.4, y + 0.02, 0.005), p(-1.4, y + 0.02, 0.005));
    }
    part(&mut slats, [-1.42, -0.03, 0.0], [2.84, 0.04, 0.04]);
    a.mesh("blind", [(slats, paints.ceiling)])
}

/// A box of light with a grid of vanes, hung from the origin.
fn ceiling_lamp(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut vanes, mut light) = (Shape::new(), Shape::new());
    let p = |x: f64, z: f64| DVec3::new(x, -0.03, z);
    light.quad(p(-0.6, -0.15), p(0.6, -0.15), p(0.6, 0.15), p(-0.6, 0.15));
    for k in 0..=12 {
        part(&mut vanes, [-0.605 + 0.1 * f64::from(k), -0.09, -0.15], [0.01, 0.06, 0.3]);
    }
    part(&mut vanes, [-0.61, -0.1, -0.16], [1.22, 0.1, 0.01]);
    part(&mut vanes, [-0.61, -0.1, 0.15], [1.22, 0.1, 0.01]);
    a.mesh("ceiling lamp", [(vanes, paints.metal), (light, paints.lamp)])
}

/// A plant in a turned pot: the leaves are quads, the pot is round.
fn pot(a: &mut Assembly, paints: &Paints, rng: &mut Rng) -> MeshId {
    let (mut pot, mut leaves) = (Shape::new(), Shape::new());
    let profile = [(0.14, 0.0), (0.18, 0.1), (0.20, 0.22), (0.19, 0.32), (0.17, 0.36), (0.0, 0.33)];
    pot.lathe(DVec3::ZERO, &profile.map(DVec2::from), 24);
    for k in 0..60 {
        let angle = TAU * 0.381_966 * f64::from(k);
        let lift = rng.range(0.25, 1.35);
        let out = DVec3::new(
            libm::cos(angle) * libm::cos(lift),
            libm::sin(lift),
            libm::sin(angle) * libm::cos(lift),
        );
        let foot = DVec3::Y * 0.33;
        let (tip, side) = (foot + out * rng.range(0.22, 0.42), perpendicular(out) * 0.04);
        let middle = foot.lerp(tip, 0.55);
        leaves.quad(foot, middle - side, tip, middle + side);
    }
    a.mesh("plant", [(pot, paints.books[0]), (leaves, paints.leaf)])
}

/// A pole with a shade.
fn floor_lamp(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut metal, mut shade) = (Shape::new(), Shape::new());
    let foot = [(0.15, 0.0), (0.15, 0.02), (0.13, 0.03), (0.015, 0.04), (0.012, 1.45)];
    metal.lathe(DVec3::ZERO, &foot.map(DVec2::from), 20);
    let cone = [(0.24, 1.35), (0.20, 1.48), (0.15, 1.62)];
    shade.lathe(DVec3::ZERO, &cone.map(DVec2::from), 28);
    a.mesh("floor lamp", [(metal, paints.metal), (shade, paints.books[3])])
}

/// A globe on a foot, to stand on a table.
fn globe(a: &mut Assembly, paints: &Paints) -> MeshId {
    let (mut metal, mut ball) = (Shape::new(), Shape::new());
    let foot = [(0.09, 0.0), (0.08, 0.02), (0.015, 0.03), (0.012, 0.09)];
    metal.lathe(DVec3::ZERO, &foot.map(DVec2::from), 16);
    ball.sphere(DVec3::Y * 0.23, 0.15, 26, 14);
    a.mesh("globe", [(metal, paints.metal), (ball, paints.books[1])])
}
