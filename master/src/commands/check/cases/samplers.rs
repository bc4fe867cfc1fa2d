//! Orders of convergence of samplers: how fast the mean of a pixel's samples comes near the pixel's own.
//!
//! A pixel's samples are n points of the unit square, stratified in n columns, n rows and a grid of cells that are as square as can be.
//!
//! * **An edge** crosses about sqrt(n) of the n cells, in each of which a sample is on one side or the other: a variance of 1/n^2 a cell
//!   and of n^(-3/2) in all, an error of n^(-3/4) (Mitchell 1996, "Consequences of stratified sampling in graphics").
//! * **A ramp** is a function of one coordinate, or a sum of two such, and each coordinate has a sample in each of n strata: errors of 1/n in each,
//!   independent, n^(-3/2) of the mean.
//! * **A product** of both coordinates has a part that no coordinate explains alone. Of a scrambled net the error is
//!   n^(-3/2) sqrt(log n) (Owen 1997). Correlated multi-jittered samples owe theirs, n^(-3/4), to being correlated: the head of
//!   `shared/whitted/src/sample.rs` derives it.

use crate::commands::check::backend::frame_of;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::exact;
use crate::commands::fit::Fit;
use rayon::prelude::*;
use tessera_geometry::DVec3;
use tessera_kdtree::soup::Random;
use tessera_master::PixelFormat;
use tessera_pack::{ImageInput, Material, Pack};
use tessera_whitted::stage::stages::add_ruler;
use tessera_whitted::stage::{Layers, Stage, View, decode, look, unlit};
use tessera_wire::Sampler;
use tessera_worker::Kernel;
use tessera_worker::gpu::probe::cpu_frame;

pub const CASES: &[Case] = &[
    Case {
        id: "sampler-edge",
        input: "a slanted edge through pixels of 8 to 512 samples",
        judge: "A: exact areas; order 3/4",
        run: Run::Once(edge),
    },
    Case {
        id: "sampler-ramp",
        input: "a ramp through them",
        judge: "A: its middle; order 3/2",
        run: Run::Once(ramp),
    },
    Case {
        id: "sampler-product",
        input: "a product of both coordinates in them",
        judge: "A: its middle; order 3/4 or 3/2",
        run: Run::Once(product),
    },
];

/// What is known of a sampler.
struct Law {
    sampler: Sampler,
    /// Numbers of samples for which its strata are whole: squares, and powers of two.
    samples: &'static [u32],
    /// Mean squared errors of an edge, a ramp and a product, up to a factor.
    squares: [fn(f64) -> f64; 3],
}

const LAWS: [Law; Sampler::ALL.len()] = [
    Law {
        sampler: Sampler::Jittered,
        samples: &[16, 25, 36, 49, 64, 100, 144, 196, 256],
        squares: [edge_square, ramp_square, |n| {
            // Of x y, k = sqrt n (the test of sample.rs derives it).
            let k = n.sqrt();
            (1.0 - 1.0 / k) * (1.0 + 1.0 / k) * (1.0 + 1.0 / k) * libm::pow(n, -1.5) / 72.0
                + product_ramps() * ramp_square(n)
        }],
    },
    Law {
        sampler: Sampler::LowDiscrepancy,
        samples: &[8, 16, 32, 64, 128, 256, 512],
        // Of x y, m = log2 n: Haar coefficients of levels k and l have squares of 4^-(k + l) / 16. Those with k + l <= m are without an error, with
        // k + l = m + 1 two samples that share a cell lie in opposite quarters of it and err twice as much as independent ones, and beyond they
        // are independent (Owen 1997): 4^-m (7 m / 12 + 1 / 9) / 16 n.
        squares: [edge_square, ramp_square, |n| {
            let m = libm::log2(n);
            (7.0 * m / 12.0 + 1.0 / 9.0) / 16.0 * libm::pow(n, -3.0) + product_ramps() * ramp_square(n)
        }],
    },
];

/// What laws leave out of their squares, as a share. An edge crosses c sqrt(n) cells and one more at most, c >= 1 as slanted as it is; the others are
/// whole sums.
const LEFT_OUT: [fn(f64) -> f64; 3] = [|n| 1.0 / n.sqrt(), |_| 0.0, |_| 0.0];

/// Orders of errors are whole numbers of quarters.
const APART: f64 = 0.25;

fn edge_square(n: f64) -> f64 {
    libm::pow(n, -1.5)
}

/// Of x: a uniform place in each of n strata.
fn ramp_square(n: f64) -> f64 {
    libm::pow(n, -3.0) / 12.0
}

/// Side of a pixel of [`product`], in texture coordinates, and how far its middle is moved at most.
const PRODUCT_SIDE: f64 = 0.85 / 2.0;
const PRODUCT_MOVED: f64 = 0.05;

/// s + t - 2 s t is, about a pixel's middle, two ramps and a product: the mean squares of the ramps' factors, 1 - 2 s and 1 - 2 t over the pixel's side, of
/// which the middles are half a side from 1/2 and moved evenly, as a share of the product's, 2 over both sides.
fn product_ramps() -> f64 {
    let area = PRODUCT_SIDE * PRODUCT_SIDE;
    let factor = area + 4.0 * PRODUCT_MOVED * PRODUCT_MOVED / 3.0;
    2.0 * factor * area / (2.0 * area * 2.0 * area)
}

/// The slopes of the errors of every sampler. `place` makes view number `i` and its exact pixels from random numbers; those without a number do
/// not count.
fn slopes(
    pack: &Pack,
    which: usize,
    frames: u64,
    place: impl Fn(&mut Random) -> (View, Vec<Option<f64>>) + Sync,
) -> Outcome {
    let mut findings = Vec::new();
    for Law { sampler, samples, squares } in &LAWS {
        let mut points = Vec::new();
        for &samples in *samples {
            let squares: Result<Vec<(f64, usize)>, String> = (0..frames)
                .into_par_iter()
                .map(|i| {
                    // Other places and other samples for every number of them, so that errors are independent.
                    let seed = i << 16 | u64::from(samples);
                    let (view, wanted) = place(&mut Random(seed));
                    let mut frame = frame_of(pack, &View { samples, ..view }, PixelFormat::Layers, seed)?;
                    frame.sampling.sampler = *sampler;
                    let seen = decode(&cpu_frame(pack, Kernel::auto(), &frame).0);
                    Ok(seen.iter().zip(&wanted).fold((0.0, 0), add_square))
                })
                .collect();
            let (sum, count) = squares?.into_iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            points.push((f64::from(samples), (sum / count.max(1) as f64).sqrt()));
        }
        // Not every law is a power: its slope is the one that the same numbers of samples make of it, and errors are held to it by the slope of their
        // ratio, which is to be 0. What the law leaves out may turn that as it turns the law.
        let slope = |of: &dyn Fn(f64, f64) -> f64| {
            Fit::of(&points.iter().map(|&(n, error)| (n, of(n, error))).collect::<Vec<_>>()).ok_or("no slope")
        };
        let law = |n: f64| squares[which](n).sqrt();
        let theory = slope(&|n, _| law(n))?.slope;
        let ratio = slope(&|n, error| error / law(n))?;
        let allowance = slope(&|n, _| (1.0 + LEFT_OUT[which](n)).sqrt())?.slope.abs();
        let fit = Fit { slope: theory + ratio.slope, ..ratio };
        let (n, error) = points[points.len() - 1];
        findings.push(Finding::holds(
            format!("{}: slope {theory:.3}, {allowance:.3} allowed beside the confidence", sampler.name()),
            format!("{fit}, error {error:.1e} at {n} samples"),
            fit.tells(theory, allowance, APART),
        ));
    }
    Ok(Finding::all(findings))
}

fn add_square((sum, count): (f64, usize), (pixel, wanted): (&Layers, &Option<f64>)) -> (f64, usize) {
    match wanted {
        Some(wanted) => {
            let off = f64::from(pixel.color[0]) - wanted;
            (sum + off * off, count + 1)
        }
        None => (sum, count),
    }
}

/// Looks straight down on the plane z = 0 from 2 above `middle`, `turn` around the axis, at `half` of it on either side, with `side` pixels.
fn above(middle: [f64; 2], turn: f64, half: f64, side: u32) -> (View, impl Fn(f64, f64) -> [f64; 2]) {
    let mut view = look([middle[0], middle[1], 2.0], [middle[0], middle[1], 0.0]).sized(side, side);
    let (sine, cosine) = (libm::sin(turn), libm::cos(turn));
    view.pose.up = DVec3::new(-sine, cosine, 0.0);
    view.pose.fov_degrees = 2.0 * libm::atan(half / 2.0).to_degrees();
    // Columns and rows of the image, from its upper left, to the plane.
    let at = move |x: f64, y: f64| {
        let (a, b) = (half * (2.0 * x / f64::from(side) - 1.0), half * (1.0 - 2.0 * y / f64::from(side)));
        [middle[0] + a * cosine - b * sine, middle[1] + a * sine + b * cosine]
    };
    (view, at)
}

fn edge(effort: Effort) -> Outcome {
    // White where x > 0.
    let mut stage = Stage::default();
    stage.quad([0.0, -10.0, 0.0], [10.0, 0.0, 0.0], [0.0, 20.0, 0.0], unlit([1.0; 3]));
    stage.quad([0.0, -10.0, 0.0], [-10.0, 0.0, 0.0], [0.0, 20.0, 0.0], unlit([0.0; 3]));
    const SIDE: u32 = 8;
    slopes(&exact(&stage)?, 0, effort.pick(300, 1200), |random| {
        // Slanted: from 20 to 70 degrees to the pixels' sides.
        let turn = (20.0 + 50.0 * f64::from(random.unit())).to_radians();
        let middle = [0.2 * f64::from(random.unit()) - 0.1, 0.0];
        let (view, at) = above(middle, turn, 0.5, SIDE);
        let areas = (0..SIDE * SIDE).map(|i| {
            let (x, y) = (f64::from(i % SIDE), f64::from(i / SIDE));
            let corners = [at(x, y), at(x + 1.0, y), at(x + 1.0, y + 1.0), at(x, y + 1.0)];
            Some(share_right_of_0(corners)).filter(|share| (0.0..1.0).contains(share) && *share > 0.0)
        });
        (view, areas.collect())
    })
}

/// The share of a quadrangle with `x > 0`.
fn share_right_of_0(corners: [[f64; 2]; 4]) -> f64 {
    let area = |corners: &[[f64; 2]]| {
        let next = corners.iter().cycle().skip(1);
        0.5 * corners.iter().zip(next).map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum::<f64>().abs()
    };
    // Cut it at x = 0 (Sutherland and Hodgman 1974).
    let mut kept = Vec::new();
    for (i, p) in corners.iter().enumerate() {
        let q = corners[(i + 1) % 4];
        if p[0] > 0.0 {
            kept.push(*p);
        }
        if (p[0] > 0.0) != (q[0] > 0.0) {
            kept.push([0.0, p[1] + (q[1] - p[1]) * p[0] / (p[0] - q[0])]);
        }
    }
    area(&kept) / area(&corners)
}

fn ramp(effort: Effort) -> Outcome {
    let mut stage = Stage::default();
    add_ruler(&mut stage, 0.0);
    const SIDE: u32 = 4;
    slopes(&exact(&stage)?, 1, effort.pick(200, 800), |random| {
        let turn = std::f64::consts::TAU * f64::from(random.unit());
        let (view, at) = above([f64::from(random.unit()) - 0.5, 0.3], turn, 0.9, SIDE);
        // The mean of a linear function is that of its middle: red rises by a quarter a unit of x.
        let means = (0..SIDE * SIDE).map(|i| {
            let [x, _] = at(f64::from(i % SIDE) + 0.5, f64::from(i / SIDE) + 0.5);
            Some(0.5 + x / 4.0)
        });
        (view, means.collect())
    })
}

fn product(effort: Effort) -> Outcome {
    // Between the centres of four texels light is s + t - 2 s t.
    let mut stage = Stage::default();
    let texel = |red: u8| [red, 255, 0, 255];
    let rgba: Vec<u8> = [texel(0), texel(255), texel(255), texel(0)].concat();
    stage.input.textures =
        vec![ImageInput { width: 2, height: 2, rgba: rgba.into(), ..ImageInput::default() }];
    let material = Material { base_texture: 0, ..unlit([1.0; 3]) };
    stage.quad([-2.0, -2.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], material);
    const SIDE: u32 = 2;
    slopes(&exact(&stage)?, 2, effort.pick(400, 1600), |random| {
        // A unit of the plane is half a texture coordinate.
        let middle = [(); 2].map(|()| 2.0 * PRODUCT_MOVED * (2.0 * f64::from(random.unit()) - 1.0));
        let (view, at) = above(middle, 0.0, 2.0 * PRODUCT_SIDE, SIDE);
        // So is that of a bilinear one, over a square along its axes.
        let means = (0..SIDE * SIDE).map(|i| {
            let [s, t] = at(f64::from(i % SIDE) + 0.5, f64::from(i / SIDE) + 0.5).map(|x| (x + 1.0) / 2.0);
            Some(s + t - 2.0 * s * t)
        });
        (view, means.collect())
    })
}
