//! Scenes and rays that are unkind to builders and traversals, and a judge that has nothing in common with them: for tests and
//! `tessera check`, which must ask the same on every machine.

pub mod closed;
pub mod truth;

use crate::node::{Node, Slot};
use crate::{BuildOptions, Tree, Triangles, build};
use tessera_geometry::{Ray, Vec3};

/// A mesh of separate triangles.
#[derive(Clone, Debug, Default)]
pub struct Soup(pub Vec<[Vec3; 3]>);

impl Triangles for Soup {
    fn vertices(&self, id: u32) -> [Vec3; 3] {
        self.0[id as usize]
    }
}

impl Soup {
    /// Triangles.
    pub fn len(&self) -> u32 {
        self.0.len() as u32
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A tree with so many references on an inner node, 0, 1 or 2.
    ///
    /// # Panics
    /// As [`Soup::build_with`].
    pub fn build(&self, max_refs: u32) -> Tree {
        self.build_with(&BuildOptions { max_refs, ..BuildOptions::default() })
    }

    /// A tree.
    ///
    /// # Panics
    /// When the options are out of range or the tree does not fit its format.
    pub fn build_with(&self, options: &BuildOptions) -> Tree {
        build(self.len(), |id| self.0[id as usize], options).unwrap_or_else(|e| panic!("{e}"))
    }

    /// The smallest and the largest coordinates.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let points = || self.0.iter().flatten().copied();
        (points().fold(Vec3::INFINITY, Vec3::min), points().fold(Vec3::NEG_INFINITY, Vec3::max))
    }
}

/// SplitMix64 (Steele, Lea, Flood 2014): a seeded source that is the same everywhere.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// 64 of them.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// In 0..n; `n` is at least 1.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// In [low, high).
    pub fn point(&mut self, low: Vec3, high: Vec3) -> Vec3 {
        low + (high - low) * Vec3::new(self.unit(), self.unit(), self.unit())
    }

    /// A direction that is neither unit nor evenly spread, but never zero.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let d = self.point(Vec3::NEG_ONE, Vec3::ONE);
            if d.length_squared() > 0.01 {
                return d;
            }
        }
    }
}

/// The nearest voxel centre, as the decoder would give it.
pub fn voxel(p: Vec3) -> Vec3 {
    p.floor() + 0.5
}

/// Triangles on a latitude-longitude sphere, closed: all three of each triangle's edges are shared.
pub fn sphere(centre: Vec3, radius: Vec3, rings: usize) -> Vec<[Vec3; 3]> {
    let segments = 2 * rings;
    let at = |ring: usize, segment: usize| {
        let (polar, azimuth) = (
            std::f64::consts::PI * ring as f64 / rings as f64,
            std::f64::consts::TAU * (segment % segments) as f64 / segments as f64,
        );
        // Both poles are one point each, or rounding would open the mesh there.
        let r = if ring == 0 || ring == rings { 0.0 } else { libm::sin(polar) };
        let unit = Vec3::new(
            (r * libm::cos(azimuth)) as f32,
            (r * libm::sin(azimuth)) as f32,
            libm::cos(polar) as f32,
        );
        voxel(centre + radius * unit)
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for segment in 0..segments {
            let [a, b] = [at(ring, segment), at(ring, segment + 1)];
            let [c, d] = [at(ring + 1, segment), at(ring + 1, segment + 1)];
            if ring > 0 {
                triangles.push([a, c, b]);
            }
            if ring + 1 < rings {
                triangles.push([b, c, d]);
            }
        }
    }
    triangles
}

/// An axis-aligned quad at `at` along `axis`, between `low` and `high` on the other two.
pub fn quad(axis: usize, at: f32, low: [f32; 2], high: [f32; 2]) -> [[Vec3; 3]; 2] {
    let corner = |u: f32, v: f32| {
        let mut p = [0.0; 3];
        p[axis] = at;
        p[(axis + 1) % 3] = u;
        p[(axis + 2) % 3] = v;
        Vec3::from_array(p)
    };
    let [a, b] = [corner(low[0], low[1]), corner(high[0], low[1])];
    let [c, d] = [corner(low[0], high[1]), corner(high[0], high[1])];
    [[a, b, c], [b, d, c]]
}

/// Spheres over quads that lie in likely split planes, with some triangles twice.
pub fn spheres() -> Soup {
    let mut random = Random(11);
    let mut triangles = Vec::new();
    for _ in 0..12 {
        let centre = random.point(Vec3::splat(-3000.0), Vec3::splat(3000.0));
        triangles.extend(sphere(centre, Vec3::splat(200.0 + 400.0 * random.unit()), 10));
    }
    for i in 0..12 {
        let at = voxel(Vec3::splat(-3000.0 + 500.0 * i as f32)).x;
        triangles.extend(quad(i % 3, at, [-2000.5, -1500.5], [1800.5, 2200.5]));
    }
    let copies: Vec<_> = triangles.iter().step_by(37).copied().collect();
    triangles.extend(copies);
    Soup(triangles)
}

/// Boxes of fans of long thin triangles, as in buildings that were cut badly.
pub fn fans() -> Soup {
    let mut random = Random(12);
    let mut triangles = Vec::new();
    for _ in 0..60 {
        let centre = random.point(Vec3::splat(-100_000.0), Vec3::splat(100_000.0));
        let (u, v) = (random.direction() * 20_000.0, random.direction() * 20_000.0);
        for i in 0..24 {
            let along = |k: usize| voxel(centre + u + v * (k as f32 / 24.0));
            triangles.push([voxel(centre), along(i), along(i + 1)]);
        }
    }
    Soup(triangles)
}

/// A closed height field: many small triangles of one size.
pub fn terrain() -> Soup {
    let height = |x: i32, y: i32| ((x * 7 + y * 13) % 29 + (x * x + y) % 17) as f32 * 3.0 + 0.5;
    let at = |x: i32, y: i32| Vec3::new(x as f32 * 64.0 + 0.5, y as f32 * 64.0 + 0.5, height(x, y));
    let mut triangles = Vec::new();
    for x in -24..24 {
        for y in -24..24 {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    Soup(triangles)
}

/// Thin tubes in all directions across the scene: long slivers.
pub fn tubes() -> Soup {
    let mut random = Random(13);
    let mut triangles = Vec::new();
    for _ in 0..70 {
        let [from, to] = [0, 1].map(|_| random.point(Vec3::splat(-30_000.0), Vec3::splat(30_000.0)));
        let axis = (to - from).normalize();
        let side = axis.any_orthonormal_vector() * 60.0;
        let other = axis.cross(side);
        let ring = |end: Vec3, k: usize| {
            let (s, c) = libm::sincosf(std::f32::consts::TAU * (k % 8) as f32 / 8.0);
            voxel(end + side * c + other * s)
        };
        for k in 0..8 {
            let [a, b, c, d] = [ring(from, k), ring(from, k + 1), ring(to, k), ring(to, k + 1)];
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    Soup(triangles)
}

/// Every scene that a property is tested on, by name.
pub fn scenes() -> Vec<(&'static str, Soup)> {
    vec![("spheres", spheres()), ("fans", fans()), ("terrain", terrain()), ("tubes", tubes())]
}

/// Split planes of `tree` as (axis, position).
pub fn planes(tree: &Tree) -> Vec<(usize, f32)> {
    split_planes(&tree.slots)
}

/// Split planes of a tree of these slots as (axis, position).
pub fn split_planes(slots: &[Slot]) -> Vec<(usize, f32)> {
    let mut planes = Vec::new();
    let mut slot = 0;
    while slot < slots.len() {
        let node = Node(slots[slot]);
        if node.is_leaf() {
            slot += 1;
        } else {
            planes.push((node.axis(), node.split()));
            slot += node.size() as usize;
        }
    }
    planes
}

/// How many kinds of rays [`unkind_ray`] deals out in turn.
pub const UNKIND: usize = 10;

/// Ray number `i` of a mix that is unkind to traversals: random, axis-parallel with zeros of both signs, starting exactly in
/// split planes, with one zero component, at vertices, along edges, through points of edges, with subnormal components, grazing a triangle
/// in its plane but for the last digits.
pub fn unkind_ray(i: usize, random: &mut Random, soup: &Soup, planes: &[(usize, f32)]) -> Ray {
    let (low, high) = soup.bounds();
    let reach = (high - low) * 0.2;
    let mut origin = random.point(low - reach, high + reach);
    let mut direction = random.direction();
    let zero = |random: &mut Random| if random.bits() & 1 == 0 { 0.0 } else { -0.0 };
    let triangle = soup.0[random.below(soup.0.len())];
    let kind = i % UNKIND;
    if matches!(kind, 1 | 2 | 4)
        && let Some(&(axis, at)) = planes.get(random.below(planes.len().max(1)))
    {
        origin[axis] = at;
    }
    match kind {
        2 | 3 => {
            let along = random.below(3);
            for axis in 0..3 {
                direction[axis] = if axis == along { 1.0f32.copysign(direction[axis]) } else { zero(random) };
            }
        }
        4 | 5 => direction[random.below(3)] = zero(random),
        6 => direction = triangle[random.below(3)] - origin,
        7 if random.bits() & 1 == 0 => {
            direction = triangle[0] + (triangle[1] - triangle[0]) * random.unit() - origin;
        }
        7 => {
            direction = triangle[1] - triangle[0];
            origin = triangle[0] - direction * random.unit();
        }
        8 => direction[random.below(3)] = [1e-40, -1e-40, f32::MIN_POSITIVE][random.below(3)],
        9 => {
            let (u, v) = (triangle[1] - triangle[0], triangle[2] - triangle[0]);
            direction = u * (random.unit() - 0.5) + v * (random.unit() - 0.5);
            let within = random.unit();
            origin = triangle[0] + u * within + v * (random.unit() * (1.0 - within))
                - direction * 8.0 * random.unit();
            let axis = random.below(3);
            direction[axis] =
                if random.bits() & 1 == 0 { direction[axis].next_up() } else { direction[axis] };
        }
        _ => {}
    }
    if i.is_multiple_of(3) {
        direction = direction.normalize();
    }
    Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
}
