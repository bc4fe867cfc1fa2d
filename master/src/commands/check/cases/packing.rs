//! What becomes of a scene on its way into a pack.

use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::{dropped, packed, quantized, soup_of};
use tessera_geometry::DVec3;
use tessera_kdtree::soup::Random;
use tessera_master::PixelFormat;
use tessera_pack::{ImageInput, Material, Pack, PackInput, Wrap};
use tessera_quantize::grid::{MAX_CELLS, MAX_INTERVALS};
use tessera_quantize::{Grid, NO_NORMAL, NormalTable};
use tessera_whitted::stage::stages::mirror_floor;
use tessera_whitted::stage::{chalk, look};

pub const CASES: &[Case] = &[
    Case {
        id: "16",
        input: "a scene moved by 10^7, exactly",
        judge: "I: the same pack",
        run: Run::Once(moved),
    },
    Case {
        id: "16-decode",
        input: "100,000 vertices, packed and decoded",
        judge: "D: f64, half a voxel along each axis",
        run: Run::Once(decoded),
    },
    Case {
        id: "17",
        input: "f32 coordinates of unit size at 10^7",
        judge: "C: a warning",
        run: Run::Once(coarse),
    },
    Case {
        id: "18",
        input: "a scene of size 10^-6 and 10^12, exactly",
        judge: "I: the same pack",
        run: Run::Once(scaled),
    },
    Case {
        id: "20",
        input: "vertices that are not finite",
        judge: "C, I: counts; the same pack without them",
        run: Run::Once(not_finite),
    },
    Case {
        id: "22",
        input: "normals of every direction, and of none",
        judge: "D: f64, 0.5625 degrees",
        run: Run::Once(normals),
    },
    Case {
        id: "23",
        input: "normals along an axis, a mirror floor",
        judge: "A, I: exact; the same picture without",
        run: Run::Each(axes),
    },
    Case {
        id: "25",
        input: "texture coordinates from -3.7 to 12.2",
        judge: "D: f64, 2^-16 and a whole shift",
        run: Run::Once(uvs),
    },
    Case {
        id: "27",
        input: "65,536 and 65,537 cells",
        judge: "I: fits; the next coarser grid fits",
        run: Run::Once(cells),
    },
];

/// A cloud of triangles over a unit cube, with coordinates that are multiples of 2^-20.
fn cloud(triangles: usize) -> PackInput {
    let mut random = Random(7);
    let mut coordinate = || f64::from((random.unit() * 1_048_576.0) as u32) / 1_048_576.0;
    PackInput {
        positions: (0..3 * triangles).map(|_| [coordinate(), coordinate(), coordinate()]).collect(),
        triangles: (0..triangles as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        materials: vec![chalk()],
        material_runs: vec![(0, 0)],
        ..PackInput::default()
    }
}

/// A pack's bytes but for its hash and its place and size in the world.
fn all_but_the_place(pack: &Pack) -> Result<Vec<u8>, String> {
    let head = bytemuck::bytes_of(pack.head());
    let found = pack.bytes().windows(head.len()).position(|window| window == head);
    let at = found.ok_or("a pack without its head")?;
    Ok([&pack.bytes()[..32], &pack.bytes()[64..at], &pack.bytes()[at + 32..]].concat())
}

/// Bytes of the pack that differ when all coordinates are changed by each of `changes`.
fn changed(changes: &[fn(f64) -> f64]) -> Outcome {
    let input = cloud(2000);
    let here = all_but_the_place(&packed(input.clone())?.0)?;
    let (mut differ, mut all) = (0, 0);
    for change in changes {
        let mut input = input.clone();
        input.positions.iter_mut().flatten().for_each(|x| *x = change(*x));
        let there = all_but_the_place(&packed(input)?.0)?;
        differ += here.iter().zip(&there).filter(|(a, b)| a != b).count() + here.len().abs_diff(there.len());
        all += here.len();
    }
    Ok(Finding::none(differ, all, "bytes differ"))
}

fn moved(_: Effort) -> Outcome {
    changed(&[|x| x + 1e7, |x| x - 1e7])
}

fn scaled(_: Effort) -> Outcome {
    changed(&[|x| x / 1_048_576.0, |x| x * 1_099_511_627_776.0])
}

fn decoded(_: Effort) -> Outcome {
    let input = cloud(33_334);
    let (pack, _) = packed(input.clone())?;
    let (frame, mesh) = (pack.frame(), pack.mesh());
    let mut worst = 0.0f64;
    for id in 0..pack.triangle_count() {
        let own = input.triangles[pack.original_id(id) as usize];
        for (v, w) in mesh.indices(id).into_iter().zip(own) {
            let off = frame.to_world(mesh.position(v)) - DVec3::from_array(input.positions[w as usize]);
            worst = worst.max(off.abs().max_element() / frame.step);
        }
    }
    // Half a voxel, and the roundings of the quotient that is floored and of the way back: 2^-40 voxels cover both at 2^23 of them.
    Ok(Finding::within("voxels off along an axis", worst, 0.5 + 1e-9))
}

fn coarse(_: Effort) -> Outcome {
    let warnings = |offset: f32| -> Result<usize, String> {
        let corner = |x: f32, y: f32| [f64::from(offset + x), f64::from(y), 0.0];
        let positions = vec![corner(0.0, 0.0), corner(2.0, 0.0), corner(0.0, 2.0)];
        let input = PackInput { positions, triangles: vec![[0, 1, 2]], ..cloud(0) };
        Ok(packed(input)?.1.warnings.len())
    };
    Ok(Finding::all([
        Finding::equal("warnings at 0", warnings(0.0)?, 0),
        Finding::equal("warnings at 10^7", warnings(1e7)?, 1),
    ]))
}

fn not_finite(_: Effort) -> Outcome {
    let good = cloud(500);
    let mut bad = good.clone();
    let first = bad.positions.len() as u32;
    bad.positions.extend([[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0], [1e300; 3]]);
    bad.triangles.extend([[0, 1, first], [first + 1, 1, 2], [0, 1, first + 9]]);
    let ((good, _), (pack, stats)) = (packed(good)?, packed(bad)?);
    // (A pack also says how many triangles its scene had.)
    let is_same = soup_of(&pack).0 == soup_of(&good).0 && pack.tree().slots == good.tree().slots;
    let counts = [dropped(&stats, "vertex_not_finite"), dropped(&stats, "index_out_of_range")];
    Ok(Finding::all([
        Finding::holds(
            "2 and 1 triangles dropped",
            format!("{} and {}", counts[0], counts[1]),
            counts == [2, 1],
        ),
        Finding::holds(
            "triangles and tree as without them",
            if is_same { "the same" } else { "others" },
            is_same,
        ),
    ]))
}

fn normals(effort: Effort) -> Outcome {
    let table = NormalTable::get();
    let mut random = Random(3);
    let (mut worst, mut lost) = (0.0f64, 0);
    let count = effort.pick(200_000, 2_000_000);
    for _ in 0..count {
        // Any length: 2^-20 to 2^20.
        let n = random.direction() * libm::exp2f(40.0 * random.unit() - 20.0);
        match table.decode(table.encode(n.to_array())) {
            Some(decoded) => {
                let (a, b) = (n.as_dvec3().normalize(), DVec3::from_array(decoded.map(f64::from)));
                worst = worst.max(libm::atan2(a.cross(b).length(), a.dot(b)).to_degrees());
            }
            None => lost += 1,
        }
    }
    let none = [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0]];
    let coded = none.iter().filter(|n| table.encode(**n) != NO_NORMAL).count();
    // The bound of the table (quantize/src/normal.rs) and the rounding of its entries to f32.
    Ok(Finding::all([
        Finding::within("degrees off", worst, 0.562_45 + 1e-5),
        Finding::none(lost, count, "directions without a code"),
        Finding::none(coded, none.len(), "codes without a direction"),
    ]))
}

fn axes(renders: &dyn Renders, _: Effort) -> Outcome {
    let table = NormalTable::get();
    let all = [[1.0f32, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let all = all.into_iter().flat_map(|n| [n, n.map(|x| 0.0 - x)]);
    let off = all.filter(|n| table.decode(table.encode(*n)) != Some(*n)).count();
    // Without a normal the geometric one is used, which is exact here.
    let view = look([1.0, 1.5, 4.0], [0.0, 0.1, 0.0]).sized(80, 60);
    let picture = |with| renders.bytes(&quantized(&mirror_floor(with))?, &view, PixelFormat::Layers);
    let (with, without) = (picture(true)?, picture(false)?);
    let differ = with.chunks_exact(36).zip(without.chunks_exact(36)).filter(|(a, b)| a != b).count();
    Ok(Finding::all([
        Finding::none(off, 6, "axes are not exact"),
        Finding::none(differ, with.len() / 36, "pixels differ from those of the geometric normal"),
    ]))
}

fn uvs(_: Effort) -> Outcome {
    // A strip from -3.7 to 12.2 in steps that are no numbers of 2^-15, and a triangle that spans too much.
    let strip = |wrap: Wrap| -> Result<(f64, usize, usize), String> {
        let steps = 540u32;
        let at = |i: u32| -3.7 + 15.9 * f64::from(i) / f64::from(steps - 1);
        let mut input = cloud(0);
        for i in 0..steps {
            input.positions.extend([[at(i), 0.0, 0.0], [at(i), 1.0, 0.0]]);
            input.uvs.extend([[at(i) as f32, 0.123], [at(i) as f32, 0.987]]);
        }
        input.triangles = (0..2 * steps - 2).map(|i| [i, i + 1, i + 2]).collect();
        input.triangles.push([0, 1, 2 * steps - 1]);
        input.textures = vec![ImageInput {
            width: 1,
            height: 1,
            rgba: [255; 4].into(),
            wrap_s: wrap,
            wrap_t: wrap,
            ..ImageInput::default()
        }];
        input.materials = vec![Material { base_texture: 0, ..chalk() }];
        let (pack, _) = packed(input.clone())?;
        let mesh = pack.mesh();
        let period = if wrap == Wrap::Mirror { 2.0 } else { 1.0 };
        let (mut worst, mut torn, mut judged) = (0.0f64, 0, 0);
        for id in 0..pack.triangle_count() {
            let own = input.triangles[pack.original_id(id) as usize];
            let mut shifts = Vec::new();
            for (v, w) in mesh.indices(id).into_iter().zip(own) {
                let (is, was) = (mesh.uv(v).as_dvec2().to_array(), input.uvs[w as usize].map(f64::from));
                let shift = [0, 1].map(|k| ((was[k] - is[k]) / period).round() * period);
                worst = (0..2).fold(worst, |worst, k| worst.max((was[k] - is[k] - shift[k]).abs()));
                shifts.push(shift);
            }
            torn += usize::from(shifts.windows(2).any(|pair| pair[0] != pair[1]));
            judged += 1;
        }
        Ok((worst, torn, judged))
    };
    let mut findings = Vec::new();
    for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
        let (worst, torn, judged) = strip(wrap)?;
        findings.push(Finding::within(&format!("{wrap:?}: 2^-16 units off"), worst * 65_536.0, 1.0));
        findings.push(Finding::none(torn, judged, "triangles whose corners are shifted differently"));
    }
    Ok(Finding::all(findings))
}

fn cells(_: Effort) -> Outcome {
    // Whole coordinates, 64 x 32 to a layer: 65,536 of them fill 32 layers, and keep cells of their own at every finer grid.
    let lattice = |count: usize| -> Vec<[f64; 3]> {
        (0..count).map(|i| [i % 64, i / 64 % 32, i / 2048].map(|c| c as f64)).collect()
    };
    let full = Grid::lay(&lattice(MAX_CELLS), MAX_INTERVALS).map_err(|e| e.to_string())?;
    let points = lattice(MAX_CELLS + 1);
    let over = Grid::lay(&points, MAX_INTERVALS).map_err(|e| e.to_string())?;
    let lost = points.iter().filter(|p| over.cell_index(over.voxel(**p)).is_none()).count();
    let last = full.table.last().and_then(|cell| full.cell_index(cell.map(|c| c * 1024)));
    Ok(Finding::all([
        Finding::equal("intervals for 65,536 cells", full.intervals, MAX_INTERVALS),
        Finding::holds("the last index is 65535", format!("{last:?}"), last == Some(u16::MAX)),
        Finding::holds("a coarser grid for one more", over.intervals.to_string(), over.intervals < 64),
        Finding::none(lost, points.len(), "vertices without a cell"),
    ]))
}
