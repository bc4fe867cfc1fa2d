//! Cameras that are hard to look through.

use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::exact;
use tessera_geometry::{CameraPose, DVec3};
use tessera_whitted::stage::look;
use tessera_whitted::stage::stages::bazaar;

pub const CASES: &[Case] = &[
    Case {
        id: "38",
        input: "fields of view of 0.0001 and 179.9 degrees",
        judge: "I: finite light, unit directions",
        run: Run::Each(lenses),
    },
    Case {
        id: "38-pose",
        input: "poses along their up, of no direction, not finite, too far",
        judge: "I: refused",
        run: Run::Once(poses),
    },
];

fn lenses(renders: &dyn Renders, effort: Effort) -> Outcome {
    let pack = exact(&bazaar())?;
    let side = effort.pick(32, 96);
    let (mut bad, mut pixels, mut longest) = (0, 0, 0.0f64);
    for fov_degrees in [0.0001, 1.0, 120.0, 179.9] {
        let mut view = look([0.3, 0.6, 5.0], [0.0; 3]).sized(side, side);
        view.pose.fov_degrees = fov_degrees;
        let layers = renders.layers(&pack, &view)?;
        pixels += layers.len();
        bad += layers.iter().filter(|p| !p.color.iter().all(|c| c.is_finite() && *c >= 0.0)).count();
        let camera = view.pose.to_local(&pack.frame(), side, side).map_err(|e| e.to_string())?;
        for i in 0..side * side {
            let ray = camera.ray((i % side) as f32 + 0.5, (i / side) as f32 + 0.5, side, side);
            longest = longest.max((ray.direction.as_dvec3().length() - 1.0).abs());
        }
    }
    Ok(Finding::all([
        Finding::none(bad, pixels, "pixels not finite or negative"),
        // Three squares, two sums, a root and a quotient: five roundoffs.
        Finding::within("directions off unit length", longest, 5.0 / 16_777_216.0),
    ]))
}

fn poses(_: Effort) -> Outcome {
    let pack = exact(&bazaar())?;
    let good = look([0.3, 0.6, 5.0], [0.0; 3]).pose;
    let with = |change: fn(&mut CameraPose)| {
        let mut pose = good;
        change(&mut pose);
        pose.to_local(&pack.frame(), 8, 8).is_err()
    };
    let refused = [
        with(|p| p.up = p.target - p.eye),
        with(|p| p.up = DVec3::ZERO),
        with(|p| p.target = p.eye),
        with(|p| p.eye.x = f64::NAN),
        with(|p| p.target.y = f64::INFINITY),
        with(|p| p.fov_degrees = f64::NAN),
        with(|p| p.fov_degrees = 0.0),
        with(|p| p.fov_degrees = 180.0),
        with(|p| p.eye = DVec3::splat(1e30)),
        good.to_local(&pack.frame(), 0, 8).is_err(),
    ];
    let taken = refused.iter().filter(|refused| !**refused).count();
    Ok(Finding::all([
        Finding::none(taken, refused.len(), "poses without meaning taken"),
        Finding::holds("a good one is taken", (!with(|_| ())).to_string(), !with(|_| ())),
    ]))
}
