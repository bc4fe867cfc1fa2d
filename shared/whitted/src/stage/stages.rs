//! Scenes of hard inputs, for every backend that must render them. Their numbers are those of `tests/HARD_INPUTS.md`.

use super::*;
use std::f32::consts::PI;

fn point(x: f64, y: f64, z: f64) -> (DVec3, Extra) {
    (DVec3::new(x, y, z), BARE)
}

/// 1, 3, 5: scenes without area, by name.
pub fn without_area() -> [(&'static str, Stage); 4] {
    let degenerate = |corners: [[f64; 3]; 3], times: usize| {
        let mut stage = Stage::default();
        for i in 0..times {
            let shift = DVec3::splat(i as f64);
            stage.triangle(corners.map(|c| (DVec3::from(c) + shift, BARE)), chalk());
        }
        stage.light(point_light([0.0, 2.0, 2.0], 9.0));
        stage
    };
    let mut one_vertex = degenerate([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 1);
    one_vertex.input.triangles = vec![[1, 1, 1]];
    [
        ("nothing", Stage::default()),
        ("all vertices equal", degenerate([[0.0; 3]; 3], 1)),
        ("a line of triangles", degenerate([[0.0; 3], [0.25; 3], [1.0; 3]], 9)),
        ("one vertex", one_vertex),
    ]
}

/// 2: one triangle, 320 x 320 pixels that look at it, and how many of them its area and its perimeter take.
pub fn one_triangle() -> (Stage, View, [f64; 2]) {
    let corners = [[-0.9, -0.7], [1.1, -0.2], [0.1, 0.8]];
    let mut stage = Stage::default();
    stage.triangle(corners.map(|[x, y]| point(x, y, 0.0)), chalk());
    // The pixels look at 2 x 3 x tan 25 degrees.
    let scale = 160.0 / (3.0 * libm::tan(25f64.to_radians()));
    let [a, b, c] = corners.map(|[x, y]| DVec3::new(x, y, 0.0) * scale);
    let area = (b - a).cross(c - a).length() / 2.0;
    let perimeter = a.distance(b) + b.distance(c) + c.distance(a);
    (stage, look([0.0, 0.0, 3.0], [0.0; 3]).sized(320, 320), [area, perimeter])
}

/// 4: 64 squares in the plane z = 0.
pub fn flat() -> Stage {
    let mut stage = Stage::default();
    for i in 0..64 {
        let (x, y) = (f64::from(i % 8) - 4.0, f64::from(i / 8) - 4.0);
        stage.quad([x, y, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], unlit([0.5; 3]));
    }
    stage
}

/// 4: views of [`flat`] in its own plane.
pub fn views_in_plane(pack: &Pack) -> [View; 2] {
    // A voxel's centre in a quantised scene, so that no ray crosses it.
    let height = pack.frame().to_world(pack.mesh().position(0)).z;
    [[-9.0, 0.5, height], [0.25, 0.5, height]].map(|eye| {
        let mut view = look(eye, [9.0, 0.7, height]).sized(65, 65);
        view.pose.up = DVec3::Z;
        view
    })
}

/// 6: twelve blocks, with triangles without area among them or not.
pub fn blocks(with_faults: bool) -> Stage {
    let mut stage = Stage::default();
    for i in 0..12 {
        let x = f64::from(i) * 0.25 - 1.5;
        stage.cuboid([x, -1.0, -0.5], [x + 0.2, 0.1 * f64::from(i), 0.5], chalk());
        if with_faults {
            stage.triangle(
                [point(x, 0.0, 0.0), point(x + 0.125, 0.0, 0.0), point(x + 0.2, 0.0, 0.0)],
                chalk(),
            );
            stage.triangle([point(x, -1.0, 0.5); 3], chalk());
        }
    }
    stage.light(point_light([1.0, 3.0, 2.0], 20.0));
    stage
}

/// 10: colours of the three floors of [`floors`].
pub const FLOOR_COLORS: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// 10: three floors in one plane, cut differently; each later one is larger.
pub fn floors() -> Stage {
    let mut stage = Stage::default();
    stage.quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], unlit(FLOOR_COLORS[0]));
    for i in 0..5 {
        let x = f64::from(i) - 2.5;
        stage.quad([x, 0.0, -2.0], [0.0, 0.0, 4.0], [1.0, 0.0, 0.0], unlit(FLOOR_COLORS[1]));
    }
    stage.quad([3.0, 0.0, -3.0], [-6.0, 0.0, 0.0], [0.0, 0.0, 6.0], unlit(FLOOR_COLORS[2]));
    stage
}

/// 23: a mirror floor, whose normals lie along an axis or are left out, under a block.
pub fn mirror_floor(with_normals: bool) -> Stage {
    let mut stage = Stage::default();
    stage.quad([-4.0, 0.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], mirror(0.9));
    let floor = stage.input.normals.len();
    stage.cuboid([-0.5, 0.25, -0.5], [0.5, 1.0, 0.5], chalk());
    stage.light(point_light([2.0, 3.0, 2.0], 30.0));
    if with_normals {
        stage.input.normals[..floor].fill([0.0, 1.0, 0.0]);
    }
    stage
}

/// 24: a lit ball whose normals look outward or, with a `sign` of -1, inward.
pub fn signed_ball(sign: f32) -> Stage {
    let mut stage = Stage::default();
    stage.ball([0.0; 3], 1.0, 16, chalk());
    stage.input.normals.iter_mut().flatten().for_each(|x| *x *= sign);
    stage.light(point_light([1.0, 2.0, 4.0], 40.0));
    stage
}

/// 30: two mirrors that face each other, of reflectance `k` and emission 0.5.
pub fn facing_mirrors(k: f32) -> Stage {
    let shining = Material { emissive: [0.5; 3], ..mirror(k) };
    let mut stage = Stage::default();
    stage.quad([-1.0, -1.0, -2.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], shining);
    stage.quad([-1.0, -1.0, 2.0], [0.0, 2.0, 0.0], [2.0, 0.0, 0.0], shining);
    stage
}

/// 31: a cube of glass in radiance 1.
pub fn glass_cube() -> Stage {
    let mut stage = Stage::default();
    stage.cuboid([-1.0; 3], [1.0; 3], glass(1.5));
    stage.surround();
    stage
}

/// 32: a textured room with bodies of glass of index 1 in it or without.
pub fn index_1(with_glass: bool) -> Stage {
    let mut stage = Stage::default();
    stage.input.textures = vec![ImageInput {
        width: 8,
        height: 8,
        rgba: (0..256).map(|i| (i * 37 % 256) as u8).collect(),
        ..ImageInput::default()
    }];
    stage.cuboid([-3.0; 3], [-2.0; 3], chalk());
    stage.quad([-3.0, -3.0, -2.0], [6.0, 0.0, 0.0], [0.0, 5.0, 0.0], Material { base_texture: 0, ..chalk() });
    stage.quad([0.5, -2.0, -1.5], [1.0, 0.0, 0.5], [0.0, 3.0, 0.0], mirror(0.9));
    stage.light(point_light([0.0, 3.0, 3.0], 40.0));
    if with_glass {
        stage.ball([0.0, 0.0, 0.0], 1.2, 12, glass(1.0));
        stage.cuboid([-2.5, -2.5, 0.5], [0.5, 1.0, 0.9], glass(1.0));
    } else {
        // Keeps the bounds, and so the voxels, of both scenes equal.
        stage.quad([3.0, 3.0, 2.9], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0], chalk());
    }
    stage.quad([3.0, 3.0, 2.9], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0], chalk());
    stage
}

/// 33, 34, 37: an unlit ruler in the plane `z`, from `x = -2` to 2.
pub fn add_ruler(stage: &mut Stage, z: f64) {
    stage.input.textures = vec![ruler()];
    let material = Material { base_texture: 0, ..unlit([1.0; 3]) };
    stage.quad([-4.0, -2.0, z], [8.0, 0.0, 0.0], [0.0, 4.0, 0.0], material);
}

/// Where a pixel's ray has met the ruler.
///
/// # Panics
/// When it has not.
pub fn ruler_at(pixel: &Layers) -> f64 {
    let [r, g, _] = pixel.color;
    assert!(g > 0.1 && r > 0.0 && r < g, "off the ruler: {r} of {g}");
    4.0 * (f64::from(r) / f64::from(g)) - 2.0
}

/// 33: a plate of `thickness` and index `ior` before a ruler, and a ray to it at `angle` from its normal.
pub fn plate(thickness: f64, ior: f32, angle: f64) -> (Stage, View) {
    let direction = DVec3::new(libm::sin(angle), 0.0, -libm::cos(angle));
    let eye = DVec3::new(0.013, 0.07, 0.5) - direction * 0.3;
    let mut stage = Stage::default();
    add_ruler(&mut stage, -0.1);
    stage.cuboid([-8.0, -1.0, 0.0], [8.0, 1.0, thickness], glass(ior));
    // Two refractions, no room for the images of inner reflections.
    (stage, View { max_depth: 2, ..look(eye.to_array(), (eye + direction).to_array()) })
}

/// 34: a glass ball of radius 1 before a ruler in its focus.
pub fn glass_ball(rings: u32) -> Stage {
    let mut stage = Stage::default();
    add_ruler(&mut stage, -1.5);
    stage.ball([0.0; 3], 1.0, rings, glass(1.5));
    stage
}

/// 36: a glossy square with a light in it.
pub fn light_in_surface() -> Stage {
    let mut stage = Stage::default();
    stage.quad(
        [-1.0, -1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        Material { roughness: 0.2, ..Material::default() },
    );
    stage.light(point_light([0.25, 0.5, 0.0], 1.0));
    stage
}

/// 37: a closed room with a lamp.
pub fn closed_box() -> Stage {
    let mut stage = Stage::default();
    stage.cuboid([-1.0, -2.0, -3.0], [4.0, 3.0, 2.0], chalk());
    stage.light(point_light([0.5, 0.4, -0.3], 1.0));
    stage
}

/// 37: wide views of [`closed_box`] from inside.
pub fn views_in_box() -> [View; 4] {
    [[1.0, 0.0, 0.0], [-1.0, 0.3, 0.2], [0.0, -1.0, 0.0], [4.0, 3.0, 2.0]].map(|target| {
        let mut view = look([0.0, 0.0, 0.0], target).sized(80, 60);
        view.pose.fov_degrees = 120.0;
        view
    })
}

/// 40: a corridor 1024 long along x with a block across it, on its floor, at 1000.
pub fn corridor() -> Stage {
    let mut stage = Stage::default();
    stage.quad([0.0, 0.0, -2.0], [0.0, 0.0, 4.0], [1024.0, 0.0, 0.0], chalk());
    stage.quad([0.0, 0.0, -2.0], [1024.0, 0.0, 0.0], [0.0, 3.0, 0.0], chalk());
    stage.quad([0.0, 0.0, 2.0], [0.0, 3.0, 0.0], [1024.0, 0.0, 0.0], chalk());
    stage.cuboid([1000.0, 0.0, -1.0], [1002.0, 2.0, 1.0], chalk());
    stage.light(directional_light([-1.0, -1.0, 0.0], PI));
    stage
}

/// Everything that sends rays: a mirror floor, a glass ball, a pane, a veil, a sheet with holes, a one-sided card, three lights.
pub fn bazaar() -> Stage {
    let mut stage = Stage::default();
    stage.input.textures = vec![ImageInput {
        width: 8,
        height: 8,
        rgba: (0..256).map(|i| (i * 37 % 256) as u8).collect(),
        ..ImageInput::default()
    }];
    let veil = Material {
        base_color: [0.2, 0.5, 0.9, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    let masked = Material { base_texture: 0, flags: MaterialFlags::ALPHA_MASK, ..chalk() };
    let pane = Material { flags: MaterialFlags::THIN_WALLED, ..glass(1.5) };
    stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], mirror(0.7));
    stage.ball([-1.0, 0.0, 0.0], 0.9, 8, glass(1.5));
    stage.quad([0.2, -0.9, 0.5], [1.0, 0.0, 0.2], [0.0, 1.5, 0.0], pane);
    stage.quad([0.6, -0.5, 0.9], [1.0, 0.0, -0.2], [0.0, 1.5, 0.0], veil);
    stage.quad([-2.0, 0.8, -1.0], [4.0, 0.0, 0.0], [0.0, 0.3, 2.0], masked);
    stage.quad([1.4, -0.8, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], one_sided(chalk()));
    stage.cuboid([-3.5, -1.0, -3.0], [3.5, 1.0, -2.5], chalk());
    stage.light(point_light([1.0, 2.5, 2.0], 20.0));
    stage.light(directional_light([0.2, -1.0, -0.3], 1.0));
    stage.light(point_light([-3.0, 0.2, 2.0], 6.0));
    stage.surround();
    stage
}
