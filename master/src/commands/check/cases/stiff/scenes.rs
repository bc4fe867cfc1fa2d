//! Scenes whose parts differ by five orders of magnitude: tiles by their cost, triangles by their size.

use std::time::{Duration, Instant};
use tessera_geometry::wide::{ALL_LANES, LANES};
use tessera_geometry::{DVec3, Hit, LocalCamera, Ray, Vec3};
use tessera_kdtree::{Kernel, brute_force_closest_hits};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_master::{Balance, FrameJob};
use tessera_pack::{
    Light, LightKind, Material, MaterialFlags, Pack, PackInput, PackOptions, Plain, build_pack,
};
use tessera_scene::{Mesh, Node, Primitive, Scene};
use tessera_whitted::{Features, FrameParams, PixelBlock, RayCounts, Renderer};

/// Tiles along each side of the picture of [`glass_corner`].
pub const CORNER_TILES: u32 = 16;

/// Depth of paths in that picture.
const DEPTH: u32 = 32;

/// An unlit white wall, and in front of its lower right tile sixteen panes, each half there and all of it mirror, lit by so many lamps: a
/// ray that meets a pane goes on and back with up to half its weight each, until a ray has less than the cut-off, and each time asks for every
/// lamp through the panes between.
///
/// # Errors
/// Those of packing.
pub fn glass_corner(lamps: u32) -> Result<Pack, String> {
    const PANES: u32 = 16;
    let mut input = PackInput::default();
    let mut quad = |from: [f64; 2], to: [f64; 2], z: f64| {
        let first = input.positions.len() as u32;
        let [(x0, y0), (x1, y1)] = [(from[0], from[1]), (to[0], to[1])];
        input.positions.extend([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]);
        input.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    };
    quad([-1.1, -1.1], [1.1, 1.1], 0.0);
    // The camera sees [-1, 1] of the wall, and panes before it up to a hundredth larger: they keep away from the tile's edges.
    let side = 2.0 / f64::from(CORNER_TILES);
    for pane in 0..PANES {
        let z = 0.1 + 0.8 * f64::from(pane) / f64::from(PANES);
        quad([1.0 - 0.9 * side, 0.1 * side - 1.0], [1.0 - 0.1 * side, 0.9 * side - 1.0], z);
    }
    input.material_runs = vec![(0, 0), (2, 1)];
    let wall = Material { flags: MaterialFlags::UNLIT | MaterialFlags::DOUBLE_SIDED, ..Material::default() };
    let pane = Material {
        base_color: [1.0, 1.0, 1.0, 0.5],
        metallic: 1.0,
        // Half a mirror, half a surface that lamps light.
        roughness: 0.1,
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..Material::default()
    };
    input.materials = vec![wall, pane];
    input.lights = (0..lamps)
        .map(|lamp| Light {
            position: [lamp as f32 / lamps as f32 - 0.5, -1.0, 3.0],
            kind: LightKind::Point as u32,
            direction: [0.0, 0.0, -1.0],
            range: f32::INFINITY,
            intensity: [1.0 / lamps as f32; 3],
            cos_inner: 1.0,
            cos_outer: 0.0,
            reserved: [0; 3],
        })
        .collect();
    let plain = Plain { positions: true, ..Plain::default() };
    let options = PackOptions { plain, ..PackOptions::default() };
    Ok(build_pack(input, &options).map_err(|e| e.to_string())?.0)
}

/// The picture of [`glass_corner`], in tiles of so many pixels a side; rays below the weight `cutoff` are not traced.
pub fn corner_job(pack: &Pack, tile: u32, cutoff: f32, balance: Balance) -> FrameJob {
    // From a hundred units away, so that the panes stay within their tile.
    let origin = pack.frame().to_local(DVec3::new(0.0, 0.0, 100.0));
    FrameJob {
        tile,
        sampling: tessera_wire::Sampling { cutoff, ..Default::default() },
        depth: DEPTH,
        balance,
        ..FrameJob::new(
            LocalCamera { origin, forward: -Vec3::Z, right: Vec3::X * 0.01, up: Vec3::Y * 0.01 },
            tile * CORNER_TILES,
            tile * CORNER_TILES,
        )
    }
}

/// Rays of the tiles of a picture: what they cost, on any machine.
#[derive(Clone, Copy, Debug)]
pub struct Costs {
    /// Of the dearest tile, the last.
    pub dearest: u64,
    /// Of all others together.
    pub others: u64,
}

impl Costs {
    /// How many times as many rays the dearest tile takes as another does on average.
    pub fn ratio(&self) -> f64 {
        self.dearest as f64 * f64::from(CORNER_TILES * CORNER_TILES - 1) / self.others as f64
    }
}

/// Renders every tile of [`corner_job`] once.
pub fn corner_costs(pack: &Pack, tile: u32, cutoff: f32) -> Costs {
    let job = corner_job(pack, tile, cutoff, Balance::Dynamic);
    let params = FrameParams {
        camera: job.camera,
        width: job.width,
        height: job.height,
        samples: job.samples,
        sampling: tessera_whitted::Sampling { cutoff, ..Default::default() },
        max_depth: job.depth,
        frame: job.seed,
        features: Features::default(),
        format: tessera_whitted::PixelFormat::Rgba8,
    };
    let renderer = Renderer::new(pack);
    let mut out = vec![0; (tile * tile * 4) as usize];
    let mut rays = (0..CORNER_TILES * CORNER_TILES).map(|number| {
        let (x, y) = (number % CORNER_TILES * tile, number / CORNER_TILES * tile);
        let block = PixelBlock { x, y, width: tile, height: tile };
        let RayCounts { primary, shadow, reflection, refraction } =
            renderer.render_block(&params, block, &mut out);
        primary + shadow + reflection + refraction
    });
    let others = rays.by_ref().take((CORNER_TILES * CORNER_TILES - 1) as usize).sum();
    Costs { dearest: rays.sum(), others }
}

/// One huge triangle, and above its middle a field of `2 * side * side` triangles whose legs are two of the finest voxels that the huge one
/// leaves: 2^22 of them are one of its legs. Beside the field stands a speck of ten voxels.
///
/// With `is_benign` the field alone, as large as the huge triangle.
pub fn field(side: u32, is_benign: bool) -> Scene {
    // 8192 cells of 1024 voxels along the huge triangle's leg of 1, less what the grid leaves at its ends.
    let voxel = (1.0 + 2.0 / 1_048_576.0) / 8_388_608.0;
    let leg = if is_benign { 1.0 / f64::from(side) } else { 2.0 * voxel };
    let height = |i: u32, j: u32| leg * (4.0 + f64::from((i * 7 + j * 13) % 3));
    let corner = if is_benign { 0.0 } else { 0.25 };
    let mut positions = Vec::new();
    for j in 0..=side {
        positions.extend(
            (0..=side)
                .map(|i| DVec3::new(corner + f64::from(i) * leg, corner + f64::from(j) * leg, height(i, j))),
        );
    }
    let row = side + 1;
    let quads = (0..side).flat_map(|j| (0..side).map(move |i| j * row + i));
    let triangles = quads.flat_map(|q| [[q, q + 1, q + row + 1], [q, q + row + 1, q + row]]).collect();
    let tiny = (positions, triangles);
    if is_benign {
        return scene_of([("field", tiny)]);
    }
    let huge = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let speck =
        |x: f64, y: f64, z: f64| DVec3::new(0.1, 0.1, 20.0 * voxel) + DVec3::new(x, y, z) * 10.0 * voxel;
    let speck = vec![speck(0.0, 0.0, 0.0), speck(1.0, 0.0, 0.0), speck(0.0, 1.0, 0.0), speck(0.0, 0.0, 1.0)];
    let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    scene_of([("huge", (huge, vec![[0, 1, 2]])), ("speck", (speck, faces)), ("field", tiny)])
}

type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

fn scene_of<const N: usize>(shapes: [(&str, Shape); N]) -> Scene {
    let mut scene = Scene { materials: vec![tessera_scene::Material::default()], ..Scene::default() };
    for (index, (name, (positions, triangles))) in shapes.into_iter().enumerate() {
        let primitives = vec![Primitive { positions, triangles, ..Primitive::default() }];
        scene.meshes.push(Mesh { name: name.into(), primitives });
        let transform = Default::default();
        scene.nodes.push(Node { name: name.into(), transform, mesh: Some(index), children: Vec::new() });
        scene.roots.push(index);
    }
    scene
}

/// What was seen of a field from above.
pub struct Sight {
    pub prepared: Prepared,
    /// Rays that were sent down into it.
    pub rays: usize,
    /// Rays that passed it.
    pub holes: usize,
    /// Rays that were held to a test of every triangle, and those that differ from it in any bit.
    pub judged: usize,
    pub differ: usize,
    /// Time of all rays.
    pub traced: Duration,
}

/// Packs a [`field`] and looks at it from above, eight rays at a time.
///
/// # Errors
/// Those of preparing, and a pack that has lost the field.
pub fn look_at(scene: Scene, rays: usize, judge: usize) -> Result<Sight, String> {
    // The field comes last in the scene.
    let others: usize =
        scene.meshes.iter().rev().skip(1).flat_map(|mesh| &mesh.primitives).map(|p| p.triangles.len()).sum();
    let options = PrepareOptions::default();
    let prepared = prepare_scene(scene, &options, Duration::ZERO).map_err(|e| e.to_string())?;
    let pack = &prepared.pack;
    let (mesh, tree) = (pack.mesh(), pack.tree());
    let is_field = |id: u32| pack.original_id(id) as usize >= others;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for id in (0..pack.triangle_count()).filter(|&id| is_field(id)) {
        for p in tessera_kdtree::Triangles::vertices(&mesh, id) {
            (low, high) = (low.min(p), high.max(p));
        }
    }
    let size = high - low;
    if !(size.x > 0.0 && size.y > 0.0) {
        return Err("nothing is left of the field".into());
    }
    // Points of an even spread (Roberts 2018, the R2 sequence), inside by a hundredth; from as high above as the field is wide.
    let ray = |index: usize| {
        let part = |step: f64| (0.5 + step * index as f64).fract() as f32 * 0.98 + 0.01;
        let (u, v) = (part(0.754_877_666_246_692_7), part(0.569_840_290_998_053_2));
        let origin = Vec3::new(low.x + u * size.x, low.y + v * size.y, high.z + size.x);
        // All but straight down: planes of the tree are not met at a right angle only.
        let direction = Vec3::new(1e-3, 2e-3, -1.0).normalize();
        Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    };
    let packets: Vec<[Ray; LANES]> =
        (0..rays.div_ceil(LANES)).map(|p| std::array::from_fn(|lane| ray(p * LANES + lane))).collect();
    let begun = Instant::now();
    let hits: Vec<[Option<Hit>; LANES]> =
        packets.iter().map(|packet| tree.closest_hits(Kernel::wide(), &mesh, packet, ALL_LANES)).collect();
    let traced = begun.elapsed();
    let holes = hits.iter().flatten().filter(|hit| hit.is_none_or(|hit| !is_field(hit.triangle))).count();
    let every = (packets.len() / judge.div_ceil(LANES).max(1)).max(1);
    let (mut judged, mut differ) = (0, 0);
    for (packet, hits) in packets.iter().zip(&hits).step_by(every) {
        let all = |_: usize, _: &Hit| true;
        let truth =
            brute_force_closest_hits(Kernel::wide(), pack.triangle_count(), &mesh, packet, ALL_LANES, all);
        judged += LANES;
        differ += truth.iter().zip(hits).filter(|(a, b)| a != b).count();
    }
    let rays = packets.len() * LANES;
    Ok(Sight { rays, holes, judged, differ, traced, prepared })
}
