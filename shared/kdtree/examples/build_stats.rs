//! Builds the kd-tree of a mesh with 0, 1 and 2 references on an inner node and prints its size and the time it took.
//!
//! ```text
//! cargo run --release -p tessera-kdtree --example build_stats -- bun_zipper.ply
//! cargo run --release -p tessera-kdtree --example build_stats -- 1000000 [balls|boxes|tubes]
//! ```
//!
//! A number generates that many triangles; a file must be an ascii PLY of triangles. Coordinates are scaled to a grid
//! of 2^19 voxels and snapped to voxel centres. Rays run from random points on a sphere around the scene to random points in it.

use std::time::Instant;
use tessera_geometry::{Aabb, Ray, Vec3};
use tessera_kdtree::{BuildOptions, Tree, Triangles, build};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (source, kind) = match arguments.as_slice() {
        [source] => (source.as_str(), "balls"),
        [source, kind] => (source.as_str(), kind.as_str()),
        _ => anyhow::bail!("give an ascii PLY file or a number of triangles, then balls, boxes or tubes"),
    };
    let triangles = match (source.parse(), kind) {
        (Ok(count), "balls") => balls(count),
        (Ok(count), "boxes") => boxes(count),
        (Ok(count), "tubes") => tubes(count),
        (Ok(_), other) => anyhow::bail!("there is no generator {other}: take balls, boxes or tubes"),
        (Err(_), _) => read_ply(&std::fs::read_to_string(source)?)?,
    };
    let mesh = Mesh(on_grid(triangles));
    let count = u32::try_from(mesh.0.len())?;
    println!("{source} {kind}: {count} triangles, {} threads", rayon::current_num_threads());
    println!(
        "refs  inner0  inner1  inner2  leaves  empty  leaf refs  depth  B/triangle  ratio  wall s  CPU s  us/ray"
    );

    let mut standard = None;
    for max_refs in 0..=2 {
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let options = BuildOptions { max_refs, ..BuildOptions::default() };
        let tree = build(count, |id| mesh.0[id as usize], &options)?;
        let (wall, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
        let s = tree.stats();
        let bytes = s.bytes as f64;
        let ratio = *standard.get_or_insert(bytes) / bytes;
        println!(
            "{max_refs:4} {:7} {:7} {:7} {:7} {:6} {:10} {:6} {:11.1} {ratio:6.2} {wall:7.2} {cpu:6.2} {:7.3}",
            s.inner0,
            s.inner1,
            s.inner2,
            s.leaves,
            s.empty_leaves,
            s.leaf_refs,
            s.depth,
            bytes / f64::from(count),
            trace(&tree, &mesh),
        );
    }
    Ok(())
}

struct Mesh(Vec<[Vec3; 3]>);

impl Triangles for Mesh {
    fn vertices(&self, id: u32) -> [Vec3; 3] {
        self.0[id as usize]
    }
}

/// CPU microseconds for a ray, one thread.
fn trace(tree: &Tree, mesh: &Mesh) -> f64 {
    const RAYS: u32 = 200_000;
    let mut random = Random(7);
    let extent = tree.bounds.extent();
    let cpu = cpu_seconds();
    let mut sum = 0.0;
    for _ in 0..RAYS {
        let origin = tree.bounds.min + extent * 0.5 + random.point().normalize() * extent.length() * 0.6;
        let target = tree.bounds.min + extent * (random.point() * 0.5 + 0.5);
        let direction = (target - origin).normalize();
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        sum += tree.view().closest_hit(mesh, &ray, |_| true).map_or(0.0, |hit| hit.t);
    }
    std::hint::black_box(sum);
    (cpu_seconds() - cpu) * 1e6 / f64::from(RAYS)
}

/// User and system time of this process; NaN where /proc does not tell.
fn cpu_seconds() -> f64 {
    const TICKS_PER_SECOND: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The command's name, in parentheses, may hold spaces.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).and_then(|f| f.parse().ok()).unwrap_or(f64::NAN);
    (ticks(11) + ticks(12)) / TICKS_PER_SECOND
}

fn on_grid(mut triangles: Vec<[Vec3; 3]>) -> Vec<[Vec3; 3]> {
    const VOXELS: f32 = (1 << 19) as f32;
    let bounds = Aabb::around(triangles.iter().flatten().copied());
    let scale = VOXELS / bounds.extent().max_element();
    let centre = (bounds.min + bounds.max) * 0.5;
    triangles.iter_mut().flatten().for_each(|v| *v = ((*v - centre) * scale).floor() + 0.5);
    triangles.retain(|[a, b, c]| (*b - *a).as_dvec3().cross((*c - *a).as_dvec3()) != glam::DVec3::ZERO);
    triangles
}

fn read_ply(text: &str) -> anyhow::Result<Vec<[Vec3; 3]>> {
    let (header, body) = text.split_once("end_header\n").ok_or_else(|| anyhow::anyhow!("no PLY header"))?;
    let elements = |name: &str| {
        let line = header.lines().find_map(|l| l.strip_prefix("element ")?.strip_prefix(name));
        anyhow::Ok(line.ok_or_else(|| anyhow::anyhow!("no element {name}"))?.trim().parse::<usize>()?)
    };
    let (vertices, faces) = (elements("vertex")?, elements("face")?);
    let mut lines = body.lines();
    let mut positions = Vec::new();
    for line in lines.by_ref().take(vertices) {
        let mut numbers = line.split_whitespace().map(str::parse);
        let mut next = || numbers.next().ok_or_else(|| anyhow::anyhow!("a vertex line is too short: {line}"));
        positions.push(Vec3::new(next()??, next()??, next()??));
    }
    let mut triangles = Vec::new();
    for line in lines.take(faces) {
        let numbers = line.split_whitespace().map(str::parse).collect::<Result<Vec<usize>, _>>()?;
        let [3, corners @ ..] = numbers.as_slice() else { anyhow::bail!("not a triangle: {line}") };
        let at = |k: usize| corners.get(k).and_then(|&i| positions.get(i)).copied();
        let (Some(a), Some(b), Some(c)) = (at(0), at(1), at(2)) else { anyhow::bail!("bad index: {line}") };
        triangles.push([a, b, c]);
    }
    Ok(triangles)
}

/// Finely divided balls of all sizes: triangles much smaller than the objects.
fn balls(count: usize) -> Vec<[Vec3; 3]> {
    let mut random = Random(1);
    let mut triangles = Vec::with_capacity(count);
    let rings = ((count / 60) as f32).sqrt().max(4.0) as usize / 2;
    while triangles.len() < count {
        let (centre, radius) = (random.point(), 0.02 + 0.2 * random.unit() * random.unit());
        let at = |ring: usize, segment: usize| {
            let (polar, azimuth) = (
                std::f32::consts::PI * ring as f32 / rings as f32,
                std::f32::consts::PI * segment as f32 / rings as f32,
            );
            let (r, z) = libm::sincosf(polar);
            let (y, x) = libm::sincosf(azimuth);
            centre + Vec3::new(r * x, r * y, z) * radius
        };
        for ring in 0..rings {
            for segment in 0..2 * rings {
                let [a, b] = [at(ring, segment), at(ring, segment + 1)];
                let [c, d] = [at(ring + 1, segment), at(ring + 1, segment + 1)];
                triangles.extend([[a, c, b], [b, c, d]]);
            }
        }
    }
    triangles.truncate(count);
    triangles
}

/// Turned boxes with a heavy tail of sizes, each face two triangles: large triangles through small ones.
fn boxes(count: usize) -> Vec<[Vec3; 3]> {
    let mut random = Random(2);
    let mut triangles = Vec::with_capacity(count);
    while triangles.len() < count {
        let centre = random.point();
        let size = 0.3 * random.unit() * random.unit() * random.unit() * random.unit() + 0.002;
        let z = random.point().normalize();
        let x = z.any_orthonormal_vector();
        let axes = [x * size, z.cross(x) * size * random.unit(), z * size * 3.0 * random.unit()];
        for k in 0..3 {
            let [n, u, v] = [axes[k], axes[(k + 1) % 3], axes[(k + 2) % 3]];
            for n in [n, -n] {
                let [a, b, c, d] = [n - u - v, n + u - v, n - u + v, n + u + v].map(|p| centre + p);
                triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }
    triangles.truncate(count);
    triangles
}

/// Thin pipes from anywhere to anywhere: long slivers.
fn tubes(count: usize) -> Vec<[Vec3; 3]> {
    let mut random = Random(3);
    let mut triangles = Vec::with_capacity(count);
    while triangles.len() < count {
        let from = random.point();
        let to = from + random.point() * 0.5 * random.unit();
        let axis = (to - from).normalize();
        let side = axis.any_orthonormal_vector() * 0.001;
        let other = axis.cross(side);
        let ring = |end: Vec3, k: usize| {
            let (s, c) = libm::sincosf(std::f32::consts::TAU * k as f32 / 12.0);
            end + side * c + other * s
        };
        for k in 0..12 {
            let [a, b, c, d] = [ring(from, k), ring(from, k + 1), ring(to, k), ring(to, k + 1)];
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    triangles.truncate(count);
    triangles
}

/// SplitMix64 (Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    /// In [0, 1).
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// In [-1, 1) on each axis.
    fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }
}
