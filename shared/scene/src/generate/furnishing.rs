//! What stands and hangs in the hall.

use super::assembly::{Assembly, MeshId};
use super::hall::Detail;
use super::rng::Rng;
use super::shapes::{Shape, placed, turn};
use glam::{DMat4, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Triangles of one leaf.
pub(super) const LEAF_TRIANGLES: u64 = 2;

/// The hall's materials.
pub(super) struct Stuff {
    pub(super) light: usize,
    pub(super) dark: usize,
    pub(super) rose: usize,
    pub(super) ashlar: usize,
    pub(super) bricks: usize,
    pub(super) wood: usize,
    pub(super) stars: usize,
    pub(super) stone: usize,
    pub(super) screen: usize,
    pub(super) leaf: usize,
    pub(super) banners: [usize; 2],
    pub(super) silver: usize,
    pub(super) gold: usize,
    pub(super) clear: usize,
    pub(super) green_glass: usize,
    pub(super) lacquer: usize,
    pub(super) glaze: usize,
    pub(super) soil: usize,
    pub(super) lead: usize,
    pub(super) flame: usize,
    pub(super) grass: usize,
    pub(super) cypress: usize,
    pub(super) panes: [usize; 6],
}

/// A profile of a turned solid, drawn from bottom to top.
struct Profile {
    points: Vec<DVec2>,
}

impl Profile {
    fn from(radius: f64, height: f64) -> Self {
        Self { points: vec![DVec2::new(radius, height)] }
    }

    /// Straight on, smoothly joined to what came before.
    fn line(mut self, radius: f64, height: f64) -> Self {
        self.points.push(DVec2::new(radius, height));
        self
    }

    /// An edge here.
    fn edge(mut self) -> Self {
        if let Some(&last) = self.points.last() {
            self.points.push(last);
        }
        self
    }

    /// A rounded bead that bulges by `bulge` on the way to `height`.
    fn bead(mut self, bulge: f64, height: f64, steps: usize) -> Self {
        let Some(&from) = self.points.last() else { return self };
        for k in 1..=steps {
            let (sin, cos) = turn(k, 2 * steps);
            let y = from.y + (height - from.y) * 0.5 * (1.0 - cos);
            self.points.push(DVec2::new(from.x + bulge * sin, y));
        }
        self
    }

    /// A smooth curve from the last point over the given ones (Catmull and Rom 1974), `steps` between each two.
    fn curve(mut self, over: &[[f64; 2]], steps: usize) -> Self {
        let Some(&from) = self.points.last() else { return self };
        let mut knots = vec![from, from];
        knots.extend(over.iter().map(|&p| DVec2::from_array(p)));
        knots.push(knots[knots.len() - 1]);
        for w in knots.windows(4) {
            for k in 1..=steps {
                let t = k as f64 / steps as f64;
                let (t2, t3) = (t * t, t * t * t);
                let p = w[1] * 2.0
                    + (w[2] - w[0]) * t
                    + (w[0] * 2.0 - w[1] * 5.0 + w[2] * 4.0 - w[3]) * t2
                    + (w[1] * 3.0 - w[0] - w[2] * 3.0 + w[3]) * t3;
                self.points.push(DVec2::new((p.x * 0.5).max(0.0), p.y * 0.5));
            }
        }
        self
    }
}

/// A column of rose marble on a pale base, with a bell capital under a square slab.
pub(super) fn column(a: &mut Assembly, stuff: &Stuff, detail: Detail, top: f64) -> MeshId {
    let sides = detail.steps(36.0, 4);
    let bead = detail.steps(6.0, 1);
    let mut stone = Shape::new();
    stone.cuboid_faces(
        DVec3::new(-0.55, 0.0, -0.55),
        DVec3::new(0.55, 0.22, 0.55),
        [true, true, false, true, true, true],
    );
    let base = Profile::from(0.50, 0.22)
        .bead(0.05, 0.38, bead)
        .edge()
        .line(0.44, 0.38)
        .edge()
        .bead(0.04, 0.48, bead)
        .edge()
        .line(0.405, 0.48);
    stone.lathe(DVec3::ZERO, &base.points, sides);
    let capital = Profile::from(0.345, top - 0.75)
        .bead(0.05, top - 0.66, bead)
        .edge()
        .curve(&[[0.37, top - 0.45], [0.46, top - 0.27], [0.60, top - 0.18]], detail.steps(4.0, 1))
        .edge()
        .line(0.60, top - 0.14);
    stone.lathe(DVec3::ZERO, &capital.points, sides);
    stone.cuboid_faces(
        DVec3::new(-0.62, top - 0.14, -0.62),
        DVec3::new(0.62, top, 0.62),
        [true, true, true, false, true, true],
    );
    let mut marble = Shape::textured(0.5);
    let shaft = Profile::from(0.405, 0.48)
        .curve(&[[0.40, 1.8], [0.38, 3.2], [0.345, top - 0.75]], detail.steps(4.0, 1));
    marble.lathe(DVec3::ZERO, &shaft.points, sides);
    a.mesh("column", [(stone, stuff.stone), (marble, stuff.rose)])
}

/// Gold rings with candles, hung from the vault along the nave, each with a point light.
pub(super) fn chandeliers(a: &mut Assembly, stuff: &Stuff, detail: Detail, back: f64) {
    const HEIGHT: f64 = 6.3;
    const RADIUS: f64 = 0.85;
    const CANDLES: usize = 8;
    let ring = detail.steps(48.0, 6);
    let mut gold = Shape::new();
    let circle = |radius: f64, y: f64, n: usize| -> Vec<DVec3> {
        (0..=n).map(|k| turn(k, n)).map(|(sin, cos)| DVec3::new(radius * cos, y, radius * sin)).collect()
    };
    gold.tube(&circle(RADIUS, 0.0, ring), 0.05, detail.steps(10.0, 3));
    let mut wax = Shape::new();
    let mut flame = Shape::new();
    if detail.is_full() {
        gold.tube(&circle(RADIUS * 0.55, 0.35, ring), 0.03, detail.steps(8.0, 3));
        gold.sphere(DVec3::Y * 1.0, 0.12, detail.steps(20.0, 5), detail.steps(12.0, 3));
        gold.pipe(DVec3::Y, DVec3::Y * 5.4, 0.02, detail.steps(6.0, 3));
        for k in 0..CANDLES {
            let (sin, cos) = turn(k, CANDLES);
            let out = DVec3::new(cos, 0.0, sin) * RADIUS;
            gold.pipe(out, DVec3::Y, 0.015, detail.steps(6.0, 3));
            let cup = Profile::from(0.02, 0.04).curve(&[[0.09, 0.07], [0.11, 0.14]], detail.steps(3.0, 1));
            gold.lathe(out, &cup.points, detail.steps(12.0, 4));
            wax.pipe(out + DVec3::Y * 0.06, out + DVec3::Y * 0.32, 0.035, detail.steps(10.0, 3));
            flame.sphere(out + DVec3::Y * 0.39, 0.065, detail.steps(10.0, 3), detail.steps(8.0, 2));
        }
    }
    let chandelier = a.mesh("chandelier", [(gold, stuff.gold), (wax, stuff.stone), (flame, stuff.flame)]);
    let mut z = 0.0;
    while z > back + 2.0 {
        a.place(chandelier, DMat4::from_translation(DVec3::new(0.0, HEIGHT, z)));
        // White at 4 m, the vault's and the floor's distance: 22 / (16 pi) = 0.44.
        a.point_light("chandelier", DVec3::new(0.0, HEIGHT - 0.25, z), [24.0, 19.0, 12.5]);
        z -= 8.0;
    }
}

/// Balls of glass, silver, gold and lacquer on the floor, and a green glass vase on a block.
pub(super) fn balls(a: &mut Assembly, stuff: &Stuff, detail: Detail) {
    let mut ball = |name: &str, x: f64, z: f64, radius: f64, material: usize| {
        let mut shape = Shape::new();
        let sides = detail.steps(72.0, 6);
        shape.sphere(DVec3::new(x, radius, z), radius, sides, detail.steps(36.0, 4));
        a.add(name, [(shape, material)]);
    };
    ball("mirror ball", -1.75, -0.6, 0.75, stuff.silver);
    ball("glass ball", 0.45, 0.75, 0.5, stuff.clear);
    if !detail.is_full() {
        return;
    }
    ball("gold ball", 1.35, -1.6, 0.42, stuff.gold);
    ball("red ball", -0.55, 1.25, 0.24, stuff.lacquer);
    ball("blue ball", -0.35, -2.6, 0.33, stuff.glaze);
    ball("small glass ball", 1.35, 1.45, 0.2, stuff.green_glass);

    // A hollow vase: outside up, over the lip, inside down.
    let mut block = Shape::textured(0.5);
    let (low, high) = (DVec3::new(2.15, 0.0, -0.95), DVec3::new(2.85, 0.9, -0.25));
    block.cuboid_faces(low, high, [true, true, false, true, true, true]);
    let steps = detail.steps(8.0, 2);
    let vase = Profile::from(0.0, 0.0)
        .line(0.16, 0.0)
        .edge()
        .curve(&[[0.19, 0.04], [0.27, 0.28], [0.20, 0.52], [0.11, 0.66], [0.17, 0.82]], steps)
        .curve(&[[0.165, 0.83], [0.155, 0.82]], detail.steps(3.0, 1))
        .curve(&[[0.095, 0.66], [0.18, 0.52], [0.25, 0.28], [0.16, 0.06], [0.0, 0.04]], steps);
    let mut shape = Shape::new();
    shape.lathe(DVec3::new(2.5, 0.9005, -0.6), &vase.points, detail.steps(56.0, 6));
    a.add("vase", [(block, stuff.rose), (shape, stuff.green_glass)]);
}

/// A potted plant on the nave's side of every column.
pub(super) fn plants(a: &mut Assembly, stuff: &Stuff, detail: Detail, seed: u64, back: f64) {
    if !detail.is_full() {
        return;
    }
    let mut rng = Rng::new(seed, 2);
    let sides = detail.steps(32.0, 5);
    let mut pot = Shape::new();
    let profile = Profile::from(0.20, 0.0)
        .curve(&[[0.27, 0.12], [0.30, 0.30], [0.27, 0.46]], detail.steps(4.0, 1))
        .edge()
        .bead(0.04, 0.54, detail.steps(5.0, 1))
        .edge()
        .line(0.23, 0.54)
        .edge()
        .line(0.23, 0.46);
    pot.lathe(DVec3::ZERO, &profile.points, sides);
    let mut soil = Shape::new();
    soil.disc(DVec3::Y * 0.47, DVec3::Y, 0.235, sides);

    // Arching leaves in whorls, each a strip that bends over.
    const LEAVES: usize = 34;
    let segments = detail.steps(5.0, 1);
    let plants: Vec<MeshId> = (0..3)
        .map(|_| {
            let mut leaves = Shape::textured(1.0);
            for k in 0..LEAVES {
                let around = TAU * (k as f64 * 0.381_966 + 0.05 * rng.unit());
                let lift = 0.35 + 1.05 * (k as f64 / LEAVES as f64) + rng.range(-0.1, 0.1);
                bent_leaf(&mut leaves, around, lift, rng.range(0.65, 1.0), segments);
            }
            let parts = [(pot.clone(), stuff.glaze), (soil.clone(), stuff.soil), (leaves, stuff.leaf)];
            a.mesh("plant", parts)
        })
        .collect();
    let mut z = 2.0;
    let mut k = 0;
    while z > back + 1.0 {
        for side in [-1.0, 1.0] {
            let at = DVec3::new(side * 3.1, 0.0, z - 0.15);
            let size = rng.range(0.9, 1.15);
            a.place(plants[k % 3], placed(at, rng.range(0.0, TAU), DVec3::splat(size)));
            k += 1;
        }
        z -= 4.0;
    }
}

/// A leaf that starts at the pot's rim height, rises by `lift` radians and bends down along its length.
fn bent_leaf(shape: &mut Shape, around: f64, lift: f64, length: f64, segments: usize) {
    let out = DVec3::new(libm::cos(around), 0.0, libm::sin(around));
    let across = DVec3::new(-out.z, 0.0, out.x) * (0.17 * length);
    let mut spine = vec![(DVec3::Y * 0.47 + out * 0.04, lift)];
    let step = length / segments as f64;
    for k in 0..segments {
        let (at, angle) = spine[k];
        let next = angle - 1.5 / segments as f64;
        let middle = 0.5 * (angle + next);
        spine.push((at + (out * libm::cos(middle) + DVec3::Y * libm::sin(middle)) * step, next));
    }
    shape.grid(1, segments, |i, j| {
        let (at, angle) = spine[j];
        let side = if i == 0 { -1.0 } else { 1.0 };
        let normal = DVec3::Y * libm::cos(angle) - out * libm::sin(angle);
        // The image's foot lies at the stalk.
        let uv = DVec2::new(i as f64, 1.0 - j as f64 / segments as f64);
        (at + across * side, normal, uv)
    });
}

/// A slender tree, `tall` metres.
pub(super) fn cypress(shape: &mut Shape, foot: DVec3, tall: f64, detail: Detail) {
    let profile = Profile::from(0.0, 0.0)
        .curve(&[[0.09, 0.04], [0.13, 0.22], [0.10, 0.62], [0.0, 1.0]], detail.steps(6.0, 1))
        .points
        .into_iter()
        .map(|p| p * tall)
        .collect::<Vec<_>>();
    shape.lathe(foot, &profile, detail.steps(20.0, 4));
}

/// Cloth that hangs from the arcades.
pub(super) fn banners(a: &mut Assembly, stuff: &Stuff, detail: Detail, back: f64) {
    if !detail.is_full() {
        return;
    }
    const WIDTH: f64 = 1.25;
    const DROP: f64 = 2.5;
    let (nu, nv) = (detail.steps(16.0, 2), detail.steps(20.0, 2));
    let meshes = stuff.banners.map(|material| {
        let mut cloth = Shape::textured(1.0);
        cloth.grid(nu, nv, |i, j| {
            let (u, v) = (i as f64 / nu as f64, j as f64 / nv as f64);
            // Folds that grow towards the hem; rows run upwards.
            let depth = 0.09 * (1.0 - v) + 0.015;
            let phase = u * 2.5 * TAU + 0.8 * v;
            let slope = depth * 2.5 * TAU / WIDTH * libm::cos(phase);
            let p = DVec3::new((u - 0.5) * WIDTH, (v - 1.0) * DROP, depth * libm::sin(phase));
            (p, DVec3::new(-slope, 0.0, 1.0).normalize(), DVec2::new(u, 1.0 - v))
        });
        let mut rod = Shape::new();
        let half = DVec3::X * (WIDTH * 0.5 + 0.08);
        rod.pipe(-half, half, 0.03, detail.steps(10.0, 3));
        a.mesh("banner", [(cloth, material), (rod, stuff.gold)])
    });
    let mut z = 4.0;
    let mut k = 0;
    while z > back {
        // Under the crown of every second arch, on both sides, facing the nave's length.
        for x in [-4.0, 4.0] {
            // The first pair would hang across the corners of the picture.
            if k % 2 == 1 && k > 1 {
                a.place(meshes[(k / 2) % 2], placed(DVec3::new(x, 6.2, z), 0.0, DVec3::ONE));
            }
        }
        z -= 4.0;
        k += 1;
    }
}

/// Leaves on the brick wall, in patches that climb from the foot.
pub(super) fn ivy(a: &mut Assembly, stuff: &Stuff, count: u64, seed: u64, back: f64) {
    const WALL: f64 = -7.2;
    let mut rng = Rng::new(seed, 3);
    let mut leaves = Shape::textured(1.0);
    let stems = 2 * ((6.0 - back) / 4.0) as usize;
    for k in 0..count {
        // A stem climbs, wavers and thins out.
        let stem = k as usize % stems;
        let foot = 6.0 - (stem as f64 + 0.5) * 2.0;
        let climbed = libm::sqrt(rng.unit());
        let y = 6.0 * (1.0 - climbed);
        let spread = 0.25 + 0.5 * (1.0 - y / 6.0);
        let waver = 0.5 * libm::sin(y * 1.3 + stem as f64);
        let z = foot + waver + spread * (rng.unit() + rng.unit() - 1.0);
        let at = DVec3::new(WALL + rng.range(0.02, 0.14), y, z);
        let roll = rng.range(-0.9, 0.9) + if rng.chance(0.5) { PI } else { 0.0 };
        let tilt = rng.range(-0.6, 0.6);
        let size = rng.range(0.07, 0.13);
        let up = DVec3::new(libm::sin(tilt), libm::cos(tilt), 0.0);
        let (sin, cos) = (libm::sin(roll), libm::cos(roll));
        let along = (up * cos + DVec3::Z * sin) * size;
        let across = (DVec3::Z * cos - up * sin) * (size * 0.9);
        leaves.picture(at + across - along, at - across - along, at - across + along, at + across + along);
    }
    a.add("ivy", [(leaves, stuff.leaf)]);
}
