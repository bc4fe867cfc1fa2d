//! Mirrors and glass against optics.

use super::convergence::through_ball;
use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::exact;
use tessera_pack::{Material, MaterialFlags};
use tessera_whitted::stage::stages::{
    add_ruler, facing_mirrors, glass_ball, glass_cube, index_1, plate, ruler_at,
};
use tessera_whitted::stage::{Stage, View, glass, look, mirror, unlit};

pub const CASES: &[Case] = &[
    Case {
        id: "30",
        input: "two mirrors that face each other",
        judge: "A: a geometric series",
        run: Run::Each(mirrors),
    },
    Case {
        id: "31",
        input: "light caught in a cube of glass; the critical angle",
        judge: "A: black, at most 1, finite",
        run: Run::Each(caught),
    },
    Case {
        id: "32",
        input: "bodies of glass of index 1",
        judge: "I: the picture without them",
        run: Run::Each(index_one),
    },
    Case {
        id: "33",
        input: "a glass plate at 0 to 70 degrees",
        judge: "A: Snell's shift",
        run: Run::Each(shift),
    },
    Case {
        id: "33-fresnel",
        input: "a pane at 0 to 85 degrees",
        judge: "A: Fresnel's reflectance",
        run: Run::Each(fresnel),
    },
    Case {
        id: "34",
        input: "a glass ball before its focus",
        judge: "A: f64 rays through a sphere",
        run: Run::Each(ball),
    },
    Case {
        id: "37-glass",
        input: "a camera inside glass",
        judge: "A: Snell's law outward",
        run: Run::Each(inside_glass),
    },
    Case {
        id: "24-mirror",
        input: "a mirror whose normals twist under its facets",
        judge: "A: it sees the surroundings alone",
        run: Run::Each(twisted),
    },
];

fn mirrors(renders: &dyn Renders, _: Effort) -> Outcome {
    let k = 0.75f32;
    let pack = exact(&facing_mirrors(k))?;
    let mut worst = 0.0f64;
    for max_depth in [0, 1, 2, 7, 15, 32] {
        let view = View { max_depth, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
        let pixel = renders.pixel(&pack, &view)?;
        // 0.75^21 is above 1/512, the weight below which no ray is traced, 0.75^22 below.
        let images = max_depth.min(21);
        let wanted: f64 = (0..=images).map(|i| 0.5 * libm::pow(0.75, f64::from(i))).sum();
        worst = pixel.color.iter().fold(worst, |worst, c| worst.max((f64::from(*c) - wanted).abs()));
    }
    // 22 products and sums of numbers below 2.
    Ok(Finding::within("light off the series", worst, 1e-5))
}

fn caught(renders: &dyn Renders, _: Effort) -> Outcome {
    let pack = exact(&glass_cube())?;
    let (mut wrong, mut asked) = (0, 0);
    for max_depth in [0, 1, 5, 32] {
        let view = View { max_depth, ..look([0.1, 0.0, 0.0], [1.1, 1.0, 0.0]) };
        let pixel = renders.pixel(&pack, &view)?;
        asked += 1;
        wrong += usize::from((pixel.color, pixel.alpha) != ([0.0; 3], 1.0));
    }
    let critical = look([0.1, 0.0, 0.0], [1.1, 0.7, 0.1]).sized(48, 48);
    let pixels = renders.layers(&pack, &critical)?;
    // The surroundings are 1; a path passes 32 surfaces at most, on each a dozen operations that are off by 2.5 u where a GPU is (CPU: one).
    let most = 1.0 + (32.0 * 12.0 * 2.5) / 16_777_216.0;
    let beyond = pixels.iter().filter(|p| !p.color.iter().all(|c| (0.0..=most).contains(c))).count();
    Ok(Finding::all([
        Finding::none(wrong, asked, "depths at which caught light gets out"),
        Finding::none(beyond, pixels.len(), "pixels beyond [0, 1]"),
    ]))
}

fn index_one(renders: &dyn Renders, _: Effort) -> Outcome {
    let view = look([0.0, 0.0, 6.0], [0.0; 3]).sized(48, 48);
    let picture = |with| renders.layers(&exact(&index_1(with))?, &view);
    let (with, without) = (picture(true)?, picture(false)?);
    let differ = with.iter().zip(&without).filter(|(a, b)| (a.color, a.alpha) != (b.color, b.alpha)).count();
    let behind = with.iter().zip(&without).filter(|(a, b)| a.depth != b.depth).count();
    Ok(Finding::all([
        Finding::none(differ, with.len(), "pixels differ"),
        Finding::at_least("pixels behind glass", behind, 300),
    ]))
}

fn shift(renders: &dyn Renders, _: Effort) -> Outcome {
    let (thickness, n) = (0.4, 1.5);
    let mut worst = 0.0f64;
    for degrees in [0.0f64, 20.0, 60.0, 70.0] {
        let angle = degrees.to_radians();
        let read = |ior: f32| -> Result<f64, String> {
            let (stage, view) = plate(thickness, ior, angle);
            Ok(ruler_at(&renders.pixel(&exact(&stage)?, &view)?))
        };
        let sine = libm::sin(angle);
        let wanted = thickness * sine * (1.0 - libm::cos(angle) / (n * n - sine * sine).sqrt());
        // The ruler is met at an angle: a shift across the ray moves its end by 1 / cos.
        worst = worst.max(((read(1.0)? - read(1.5)?) * libm::cos(angle) - wanted).abs());
    }
    Ok(Finding::within("shift off", worst, 1e-5))
}

fn fresnel(renders: &dyn Renders, _: Effort) -> Outcome {
    // Through a pane, which does not bend, at something white: what is not reflected.
    let pane = Material { flags: MaterialFlags::THIN_WALLED | MaterialFlags::DOUBLE_SIDED, ..glass(1.5) };
    let mut worst = 0.0f64;
    for degrees in [0.0f64, 30.0, 56.3, 70.0, 85.0] {
        let (sine, cosine) = (libm::sin(degrees.to_radians()), libm::cos(degrees.to_radians()));
        let mut stage = Stage::default();
        stage.quad([-20.0, -20.0, 0.0], [40.0, 0.0, 0.0], [0.0, 40.0, 0.0], pane);
        stage.quad([-40.0, -40.0, -1.0], [80.0, 0.0, 0.0], [0.0, 80.0, 0.0], unlit([1.0; 3]));
        let pixel = renders.pixel(&exact(&stage)?, &look([-sine, 0.1, cosine], [0.0, 0.1, 0.0]))?;
        let inside = (1.0 - sine * sine / 2.25).sqrt();
        let across = (cosine - 1.5 * inside) / (cosine + 1.5 * inside);
        let along = (1.5 * cosine - inside) / (1.5 * cosine + inside);
        let wanted = 1.0 - 0.5 * (across * across + along * along);
        worst = worst.max((f64::from(pixel.color[0]) - wanted).abs());
    }
    // At 85 degrees a roundoff of the cosine counts for 6 of the reflectance.
    Ok(Finding::within("light off", worst, 1e-5))
}

fn ball(renders: &dyn Renders, _: Effort) -> Outcome {
    let pack = exact(&glass_ball(60))?;
    let mut worst = 0.0f64;
    for h in [0.02, 0.05, 0.11] {
        let view = View { max_depth: 2, ..look([h, 0.003, 3.0], [h, 0.003, 0.0]) };
        let at = ruler_at(&renders.pixel(&pack, &view)?);
        worst = worst.max((at - through_ball([h, 0.003])?).abs());
    }
    // Facets of pi / 60 lie 3.4e-4 inside the ball. Entry and exit are each off by that at most, along the ray and, where normals are interpolated, by
    // as much in the normal's direction; a third of either bends the ray, over the 2 lengths of glass and 1.5 behind it: below 2e-3.
    Ok(Finding::within("place behind the ball off", worst, 2e-3))
}

fn inside_glass(renders: &dyn Renders, _: Effort) -> Outcome {
    let mut stage = Stage::default();
    add_ruler(&mut stage, -3.0);
    stage.cuboid([-1.0; 3], [1.0; 3], glass(1.5));
    // From inside at sin = 0.3 the ray leaves at sin = 0.45.
    let angle = libm::asin(0.3);
    let eye = [-0.2, 0.05, 0.0];
    let target = [eye[0] + libm::sin(angle), eye[1], -libm::cos(angle)];
    let wanted = eye[0] + libm::tan(angle) + 2.0 * libm::tan(libm::asin(0.45));
    let view = View { max_depth: 1, ..look(eye, target) };
    let at = ruler_at(&renders.pixel(&exact(&stage)?, &view)?);
    Ok(Finding::within("place off", (at - wanted).abs(), 1e-5))
}

fn twisted(renders: &dyn Renders, _: Effort) -> Outcome {
    // A coarse ball with normals that disagree wildly with its facets.
    let mut stage = Stage::default();
    stage.ball([0.0; 3], 1.0, 6, mirror(1.0));
    for (i, normal) in stage.input.normals.iter_mut().enumerate() {
        let twist =
            tessera_geometry::Vec3::new((i % 7) as f32 - 3.0, (i % 5) as f32 - 2.0, (i % 3) as f32 - 1.0);
        *normal = (tessera_geometry::Vec3::from(*normal) + twist * 0.4).normalize().to_array();
    }
    stage.surround();
    let pixels = renders.layers(&exact(&stage)?, &look([0.3, 0.4, 2.6], [0.0; 3]).sized(64, 64))?;
    let dark = pixels.iter().filter(|p| p.color.iter().any(|c| (c - 1.0).abs() > 1e-5)).count();
    Ok(Finding::none(dark, pixels.len(), "pixels look under the surface"))
}
