//! Lights, shadows, and rays that leave a surface.

use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::{exact, packs};
use std::f32::consts::PI;
use tessera_geometry::DVec3;
use tessera_pack::{Material, MaterialFlags};
use tessera_whitted::stage::stages::{closed_box, corridor, light_in_surface, signed_ball, views_in_box};
use tessera_whitted::stage::{BARE, Stage, chalk, directional_light, look, point_light};

pub const CASES: &[Case] = &[
    Case {
        id: "24",
        input: "normals that look inward",
        judge: "I: the same picture",
        run: Run::Each(inward),
    },
    Case {
        id: "36",
        input: "a light at the hit point, in and behind a surface",
        judge: "A: lit by its side, finite",
        run: Run::Each(light_in),
    },
    Case {
        id: "36-lamp",
        input: "a lamp exactly in a tilted ceiling",
        judge: "A: every pixel of the floor is lit",
        run: Run::Each(lamp),
    },
    Case {
        id: "36-veil",
        input: "three veils of one half between a light and a floor",
        judge: "A: an eighth of the light",
        run: Run::Each(veils),
    },
    Case {
        id: "37",
        input: "a camera inside a closed box, and on its wall",
        judge: "A: every pixel is hit and lit",
        run: Run::Each(inside_box),
    },
    Case {
        id: "37-edge",
        input: "the concave edges of a tilted room, seen to the last digit",
        judge: "A: every pixel is lit",
        run: Run::Each(edges),
    },
    Case {
        id: "40",
        input: "a corridor of eight million voxels",
        judge: "A: no acne, a shadow from its contact line",
        run: Run::Each(long_corridor),
    },
    Case {
        id: "40-wall",
        input: "light behind a thin wall, at its contact line",
        judge: "A: dark from two voxels on",
        run: Run::Each(thin_wall),
    },
    Case {
        id: "40-grazing",
        input: "tilted planes in grazing light",
        judge: "A: its irradiance in every pixel",
        run: Run::Each(grazing),
    },
];

fn inward(renders: &dyn Renders, _: Effort) -> Outcome {
    let view = look([0.2, 0.3, 3.0], [0.0; 3]).sized(64, 64);
    let picture = |sign| renders.layers(&exact(&signed_ball(sign))?, &view);
    let (outward, inward) = (picture(1.0)?, picture(-1.0)?);
    let differ = outward.iter().zip(&inward).filter(|(a, b)| a != b).count();
    let lit = outward.iter().filter(|p| p.color[0] > 0.1).count();
    Ok(Finding::all([
        Finding::none(differ, outward.len(), "pixels differ"),
        Finding::at_least("pixels lit", lit, 500),
    ]))
}

fn light_in(renders: &dyn Renders, _: Effort) -> Outcome {
    let (mut bad, mut pixels, mut lit) = (0, 0, 0);
    for pack in packs(&light_in_surface())? {
        for view in [look([0.25, 0.5, 2.0], [0.25, 0.5, 0.0]), look([0.0, 0.4, 3.0], [0.0; 3]).sized(40, 40)]
        {
            let layers = renders.layers(&pack, &view)?;
            pixels += layers.len();
            bad += layers.iter().filter(|p| !p.color.iter().all(|c| c.is_finite() && *c >= 0.0)).count();
        }
        // A light in the plane lights neither side: n.l is 0 but for rounding, behind it nothing.
    }
    for (z, is_lit) in [(-0.5f32, false), (0.5, true)] {
        let mut stage = light_in_surface();
        stage.input.lights = vec![point_light([0.25, 0.5, z], 1.0)];
        let pixel = renders.pixel(&exact(&stage)?, &look([0.0, 0.1, 2.0], [0.0, 0.1, 0.0]))?;
        lit += usize::from((pixel.color[0] > 0.0) != is_lit);
    }
    Ok(Finding::all([
        Finding::none(bad, pixels, "pixels not finite or negative"),
        Finding::none(lit, 2, "sides lit wrongly"),
    ]))
}

/// Three unit vectors, each square to the others, along no axis.
fn tilted() -> [DVec3; 3] {
    [DVec3::new(6.0, 2.0, -3.0), DVec3::new(-3.0, 6.0, -2.0), DVec3::new(2.0, 3.0, 6.0)].map(|v| v / 7.0)
}

fn lamp(renders: &dyn Renders, effort: Effort) -> Outcome {
    let [x, y, z] = tilted();
    let mut stage = Stage::default();
    let quad = |stage: &mut Stage, o: DVec3, u: DVec3, v: DVec3| {
        stage.quad(o.to_array(), u.to_array(), v.to_array(), chalk());
    };
    quad(&mut stage, x * -5.0 + z * -5.0, z * 10.0, x * 10.0);
    quad(&mut stage, x * -5.0 + z * -5.0 + y * 4.0, x * 10.0, z * 10.0);
    let place = y * 4.0 + x * 0.3 + z * 0.7;
    stage.light(point_light(place.as_vec3().to_array(), 50.0));
    stage.input.light_positions = vec![place.to_array()];
    let side = effort.pick(64, 200);
    let (mut dark, mut floor) = (0, 0);
    for pack in packs(&stage)? {
        let mut view = look((y * 3.0 + x * 0.1).to_array(), [0.0; 3]).sized(side, side);
        view.pose.up = x;
        let seen = renders.layers(&pack, &view)?;
        floor += seen.iter().filter(|p| p.id < 2).count();
        dark += seen.iter().filter(|p| p.id < 2 && p.color[0] <= 0.0).count();
    }
    Ok(Finding::none(dark, floor, "pixels of the floor are dark"))
}

fn veils(renders: &dyn Renders, _: Effort) -> Outcome {
    let veil = Material {
        base_color: [0.0, 0.0, 0.0, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    let mut stage = Stage::default();
    stage.quad([-4.0, 0.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], chalk());
    for height in [1.0, 1.5, 2.0] {
        stage.quad([-1.0, height, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], veil);
    }
    stage.light(directional_light([0.0, -1.0, 0.0], PI));
    // From beside them, so that only the light passes.
    let pixel = renders.pixel(&exact(&stage)?, &look([3.0, 0.5, 0.2], [0.3, 0.0, 0.2]))?;
    let off = pixel.color.iter().map(|c| f64::from((c - 0.125).abs())).fold(0.0, f64::max);
    // A dozen products of powers of two with pi and its inverse, each rounded once: 1e-6 of an eighth.
    Ok(Finding::within("light off 1/8", off, 1e-6))
}

fn inside_box(renders: &dyn Renders, _: Effort) -> Outcome {
    let pack = exact(&closed_box())?;
    let (mut bad, mut pixels) = (0, 0);
    for view in views_in_box() {
        let layers = renders.layers(&pack, &view)?;
        pixels += layers.len();
        bad += layers.iter().filter(|p| p.alpha != 1.0 || !p.depth.is_finite() || p.color[0] <= 0.0).count();
    }
    // On a wall it looks into the room.
    let wall = renders.pixel(&pack, &look([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]))?;
    Ok(Finding::all([
        Finding::none(bad, pixels, "pixels not hit or dark"),
        // The camera's place, the wall's and the distance are rounded once each on the CPU, 3e-7 of 5 every time; a GPU may round ten times that.
        Finding::within("depth from the wall off 5", f64::from((wall.depth - 5.0).abs()), 1e-5),
    ]))
}

fn edges(renders: &dyn Renders, effort: Effort) -> Outcome {
    // A cube from -1 to 1 in a tilted frame, seen from inside, a lamp near its middle: each of its twelve edges is met at 45 degrees or so.
    let [x, y, z] = tilted();
    let mut stage = Stage::default();
    stage.cuboid([-1.0; 3], [1.0; 3], chalk());
    for p in &mut stage.input.positions {
        *p = (x * p[0] + y * p[1] + z * p[2]).to_array();
    }
    stage.light(point_light([0.05, -0.02, 0.03], 5.0));
    let pack = exact(&stage)?;
    let side = effort.pick(24, 64);
    let (mut dark, mut pixels) = (0, 0);
    let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let frames = [(x, y, z), (y, z, x), (z, x, y)];
    let edges = frames.into_iter().flat_map(|frame| corners.map(|corner| (frame, corner)));
    for (i, ((u, v, w), (a, b))) in edges.enumerate() {
        // At another place of each, from one end to the other.
        let along = 0.9 * (f64::from(i as u32) / 5.5 - 1.0);
        let target = u * a + v * b + w * along;
        let mut view = look((u * (0.2 * a) + v * (0.1 * b)).to_array(), target.to_array()).sized(side, side);
        view.pose.up = w;
        // A picture of a few dozen roundoffs on either side of the edge.
        view.pose.fov_degrees = 2e-4;
        let layers = renders.layers(&pack, &view)?;
        pixels += layers.len();
        dark += layers.iter().filter(|p| p.alpha != 1.0 || p.color[0] <= 0.0).count();
    }
    Ok(Finding::none(dark, pixels, "pixels are dark or leak"))
}

fn long_corridor(renders: &dyn Renders, effort: Effort) -> Outcome {
    let (mut wrong, mut asked, mut acne, mut floor) = (0, 0, 0, 0);
    for pack in packs(&corridor())? {
        let voxel = pack.frame().step;
        let is_lit = |x: f64| -> Result<bool, String> {
            let pixel = renders.pixel(&pack, &look([x, 1e6 * voxel, 0.0], [x, 0.0, 0.0]))?;
            Ok(pixel.color[0] > 0.0)
        };
        for voxels in [2.0, 3.0, 10.0, 1000.0] {
            for (x, lit) in [
                (1000.0 - voxels * voxel, false),
                (998.0 + voxels * voxel, false),
                (998.0 - voxels * voxel, true),
            ] {
                wrong += usize::from(is_lit(x)? != lit);
                asked += 1;
            }
        }
        let side = effort.pick(80, 200);
        let pixels = renders.layers(&pack, &look([0.5, 1.5, 0.0], [1000.0, 0.0, 0.0]).sized(side, side))?;
        let on_floor = pixels.iter().filter(|p| p.id < 2 && p.depth < 990.0);
        for pixel in on_floor {
            floor += 1;
            acne += usize::from(pixel.color.iter().any(|c| (c - 0.5f32.sqrt()).abs() > 1e-5));
        }
    }
    Ok(Finding::all([
        Finding::none(wrong, asked, "places wrongly lit or dark"),
        Finding::none(acne, floor, "pixels of the floor with acne"),
    ]))
}

fn thin_wall(renders: &dyn Renders, _: Effort) -> Outcome {
    // As the corridor, with a sheet across it instead of a block: light that passes its foot is not caught by a back.
    let mut stage = Stage::default();
    stage.quad([0.0, 0.0, -2.0], [0.0, 0.0, 4.0], [1024.0, 0.0, 0.0], chalk());
    stage.quad([1000.0, 0.0, -1.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0], chalk());
    stage.light(directional_light([-1.0, -1.0, 0.0], PI));
    let (mut lit, mut asked) = (0, 0);
    for pack in packs(&stage)? {
        let voxel = pack.frame().step;
        // A hit's error along x is gamma(7) of the 4.1 million voxels from the middle, 1.75, which is the clearance; light at 45 degrees crosses
        // 1.2 voxels of floor on that way. Half a voxel more is the packing's.
        for voxels in [2.0, 3.0, 5.0, 10.0, 30.0, 1000.0] {
            let x = 1000.0 - voxels * voxel;
            let pixel = renders.pixel(&pack, &look([x, 1e5 * voxel, 0.0], [x, 0.0, 0.0]))?;
            lit += usize::from(pixel.color[0] > 0.0);
            asked += 1;
        }
    }
    Ok(Finding::none(lit, asked, "places lit before the contact line"))
}

fn grazing(renders: &dyn Renders, effort: Effort) -> Outcome {
    // Two planes of which no coordinate is exact: a square, and a triangle away from the middle of its scene, which others in two corners span.
    // Nothing but the offset keeps its points, whose corners weigh each other off, from lying behind it.
    let mut square = Stage::default();
    let (u, v) = (DVec3::new(0.31, 0.83, -0.46).normalize(), DVec3::new(0.77, -0.12, 0.3));
    let v = (v - u * v.dot(u)).normalize();
    let corner = DVec3::new(100.0, 200.0, -50.0);
    square.quad(corner.to_array(), (u * 1000.0).to_array(), (v * 1000.0).to_array(), chalk());
    let mut triangle = Stage::default();
    let corners = [[0.462, -0.430, 0.593], [0.768, 0.025, -0.207], [0.541, -0.253, 0.593]].map(DVec3::from);
    let at = |p: DVec3| (p, BARE);
    triangle.triangle(corners.map(at), chalk());
    for side in [-1.0, 1.0] {
        let end = DVec3::splat(side);
        triangle
            .triangle([end, end - DVec3::X * (0.01 * side), end - DVec3::Y * (0.01 * side)].map(at), chalk());
    }
    let scenes = [
        (square, [corner, corner + u * 1000.0, corner + v * 1000.0], corner + (u + v) * 500.0, 300.0),
        (triangle, corners, (corners[0] + corners[1] + corners[2]) / 3.0, 0.08),
    ];
    let side = effort.pick(120, 300);
    let (mut wrong, mut pixels) = (0, 0);
    for (mut stage, [a, b, c], middle, height) in scenes {
        // Lit at 0.6 degrees.
        let (u, normal) = ((b - a).normalize(), (b - a).cross(c - a).normalize());
        let towards = (u + normal.cross(u) * 0.2).normalize() + normal * 0.01;
        stage.light(directional_light((-towards).as_vec3().to_array(), 100.0));
        let mut view = look((middle + normal * height).to_array(), middle.to_array()).sized(side, side);
        view.pose.up = u;
        let wanted = (100.0 * towards.normalize().dot(normal)) as f32 / PI;
        let layers = renders.layers(&exact(&stage)?, &view)?;
        let seen = layers.iter().filter(|p| p.id < 2 && p.alpha == 1.0);
        wrong += seen.clone().filter(|p| (p.color[0] - wanted).abs() >= 1e-3 * wanted).count();
        pixels += seen.count();
    }
    Ok(Finding::all([
        Finding::none(wrong, pixels, "pixels of another irradiance"),
        Finding::at_least("pixels of the planes", pixels, (side * side) as usize),
    ]))
}
