//! A box with a red and a green wall, a mirror ball and a glass ball, after the room at Cornell.

use super::Recipe;
use super::assembly::{Assembly, glass, glowing, matte, mirror};
use super::shapes::Shape;
use crate::Scene;
use glam::DVec3;

/// Half the room's side in metres.
const HALF: f64 = 1.0;
/// Triangles of the lamp in the ceiling.
const LAMP: u64 = 2;

/// The seed moves nothing: there is no chance in this scene.
pub(super) fn generate(recipe: &Recipe) -> Scene {
    let cut = Cut::nearest(u64::from(recipe.triangles));
    let mut a = Assembly::new("cornell");
    let white = a.material(matte("white", [0.73, 0.71, 0.68]));
    let red = a.material(matte("red", [0.63, 0.06, 0.05]));
    let green = a.material(matte("green", [0.14, 0.45, 0.09]));
    let lamp = a.material(glowing("lamp", [1.0, 0.95, 0.85]));
    let silver = a.material(mirror("mirror", [0.95, 0.95, 0.96]));
    let clear = a.material(glass("glass", [0.98, 0.99, 1.0], 1.5));

    let h = HALF;
    let at = |x: f64, y: f64, z: f64| DVec3::new(x * h, y * h, z * h);
    let wall = |corners: [DVec3; 4]| {
        let mut wall = Shape::new();
        wall.patches(corners, cut.wall, cut.wall);
        wall
    };
    let floor = wall([at(-1., 0., 1.), at(1., 0., 1.), at(1., 0., -1.), at(-1., 0., -1.)]);
    let ceiling = wall([at(-1., 2., -1.), at(1., 2., -1.), at(1., 2., 1.), at(-1., 2., 1.)]);
    let back = wall([at(-1., 0., -1.), at(1., 0., -1.), at(1., 2., -1.), at(-1., 2., -1.)]);
    let left = wall([at(-1., 0., 1.), at(-1., 0., -1.), at(-1., 2., -1.), at(-1., 2., 1.)]);
    let right = wall([at(1., 0., -1.), at(1., 0., 1.), at(1., 2., 1.), at(1., 2., -1.)]);
    let mut shade = Shape::new();
    let y = 2.0 - 1e-3;
    shade.quad(at(-0.26, y, -0.3), at(0.26, y, -0.3), at(0.26, y, 0.2), at(-0.26, y, 0.2));
    a.add(
        "room",
        [(floor, white), (ceiling, white), (back, white), (left, red), (right, green), (shade, lamp)],
    );

    let radius = 0.36;
    let mut ball = Shape::new();
    ball.sphere(at(-0.44, radius, -0.42), radius, cut.sides, cut.rings);
    a.add("mirror ball", [(ball, silver)]);
    let mut ball = Shape::new();
    ball.sphere(at(0.42, radius, 0.18), radius, cut.sides, cut.rings);
    a.add("glass ball", [(ball, clear)]);

    // White reflects 0.73 I / (pi d^2): about 0.4 on the floor and the upper walls. Upwards the lamp's own shade
    // keeps the light from the ceiling.
    a.spot_light("lamp", at(0.0, 1.8, -0.05), DVec3::NEG_Y, [0.45, 1.56], [5.4, 5.0, 4.35]);
    a.scene().ambient = [0.20, 0.20, 0.22];
    a.camera("front", [0.0, 1.0, 3.55], [0.0, 0.96, 0.0], 38.0);
    a.camera("corner", [-0.85, 1.7, 2.6], [0.1, 0.5, -0.2], 42.0);
    a.finish()
}

/// How finely everything is cut.
#[derive(Clone, Copy)]
struct Cut {
    /// Patches along a wall's side.
    wall: usize,
    /// Of the balls.
    sides: usize,
    /// Of the balls.
    rings: usize,
}

impl Cut {
    fn triangles(self) -> u64 {
        let walls = 5 * 2 * (self.wall * self.wall) as u64;
        walls + LAMP + 2 * 2 * (self.sides * (self.rings - 1)) as u64
    }

    /// The cut that comes nearest to `target`, the balls taking nearly all.
    fn nearest(target: u64) -> Self {
        let mut best = Self { wall: 1, sides: 6, rings: 4 };
        // Of 4 sides (rings - 1) with sides = 2 rings: rings^2 = target / 8.
        let middle = libm::sqrt(target as f64 / 8.0) as usize;
        for wall in 1..=6 {
            for rings in (middle.saturating_sub(8)).max(4)..=middle + 2 {
                let left = target.saturating_sub(5 * 2 * (wall * wall) as u64 + LAMP);
                let sides = ((left as f64 / (4 * (rings - 1)) as f64).round() as usize).max(6);
                let cut = Self { wall, sides, rings };
                if cut.triangles().abs_diff(target) < best.triangles().abs_diff(target) {
                    best = cut;
                }
            }
        }
        best
    }
}
