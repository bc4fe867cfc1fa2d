//! A GPU finds what the CPU finds, at the smallest scale: single rays against one closed mesh, in every form of kernel and pack.
//!
//! `TESSERA_GPU=require` fails without a GPU, `allow` (as without it) skips and says so, `off` skips and says so.

use tessera_geometry::{Hit, Ray, Vec3, wgsl};
use tessera_kdtree::soup::truth::judge;
use tessera_kdtree::soup::{Random, Soup, sphere, spheres, split_planes, unkind_ray};
use tessera_kdtree::{BuildOptions, Triangles};
use tessera_pack::device::VertexLayout;
use tessera_pack::{Material, Pack, PackInput, PackOptions, Plain, build_pack};
use tessera_whitted::variant::Variant;
use tessera_worker::gpu::probe::{GpuProbe, ProbedScene};
use tessera_worker::gpu::{GpuError, GpuOptions, TestPolicy, TraversalForm};

/// Rays for each kernel.
const RAYS: usize = 20_000;

/// Radius of the closed mesh before it is packed, and of a ball that is inside it whatever its facets.
const RADIUS: f32 = 20_000.0;
const INNER: f32 = 0.9;

/// The relative error allowed to a distance without `f64` where it is compared with another one (locate_f32.wgsl).
const MARGIN: f32 = 1.0 / 65_536.0;

/// A pack of a closed mesh with spheres and overlapping quads inside.
struct Subject {
    pack: Pack,
    soup: Soup,
    planes: Vec<(usize, f32)>,
}

impl Subject {
    fn new(plain: bool, max_intervals: u32, max_refs: u32) -> Self {
        let mut triangles = sphere(Vec3::ZERO, Vec3::splat(RADIUS), 24);
        triangles.extend(spheres().0);
        let input = PackInput {
            positions: triangles.iter().flatten().map(|v| v.as_dvec3().to_array()).collect(),
            triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        };
        let options = PackOptions {
            plain: Plain { positions: plain, ..Plain::default() },
            tree: BuildOptions { max_refs, tau_tests: 0.0, ..BuildOptions::default() },
            max_intervals,
            ..PackOptions::default()
        };
        let (pack, _) = build_pack(input, &options).expect("a pack");
        assert_eq!(Variant::of(&pack).refs, max_refs > 0);
        let mesh = pack.mesh();
        let soup = Soup((0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect());
        let planes = split_planes(pack.tree().slots);
        Self { pack, soup, planes }
    }

    fn closest(&self, ray: &Ray) -> Option<Hit> {
        self.pack.tree().closest_hit(&self.pack.mesh(), ray, |_| true)
    }

    /// Unkind rays over 16 decades of their directions' lengths; of every eight, one begins or ends where it hits, and one
    /// cannot be traced.
    fn rays(&self, random: &mut Random) -> Vec<Ray> {
        let mut rays: Vec<_> = (0..RAYS)
            .map(|i| {
                let mut ray = unkind_ray(i, random, &self.soup, &self.planes);
                ray.direction *= libm::powf(10.0, random.below(17) as f32 - 8.0);
                ray
            })
            .collect();
        for (i, ray) in rays.iter_mut().enumerate() {
            match i % 8 {
                3 => *ray = self.bounded(*ray, random),
                5 => *ray = broken(*ray, random),
                _ => {}
            }
        }
        rays
    }

    /// `ray` with an end at what it hits, or beside it by one number.
    fn bounded(&self, ray: Ray, random: &mut Random) -> Ray {
        let Some(Hit { t, .. }) = self.closest(&ray) else { return ray };
        match random.below(5) {
            0 => Ray { t_max: t, ..ray },
            1 => Ray { t_max: t.next_up(), ..ray },
            2 => Ray { t_min: t, ..ray },
            3 => Ray { t_min: t.next_down(), ..ray },
            _ => Ray { t_min: t * 0.5, t_max: t * 2.0, ..ray },
        }
    }

    /// Whether a ray begins inside the closed mesh and goes on until it must meet it.
    fn must_hit(&self, ray: &Ray) -> bool {
        let radius = self.soup.bounds().1.max_element();
        ray.is_traceable()
            && ray.origin.length() < INNER * radius
            && ray.t_min == 0.0
            && ray.t_max.is_infinite()
    }
}

/// A ray that is not traceable.
fn broken(mut ray: Ray, random: &mut Random) -> Ray {
    let axis = random.below(3);
    match random.below(10) {
        0 => ray.origin[axis] = f32::NAN,
        1 => ray.origin[axis] = f32::INFINITY,
        2 => ray.direction[axis] = f32::NAN,
        3 => ray.direction[axis] = f32::NEG_INFINITY,
        4 => ray.direction = Vec3::ZERO,
        5 => ray.direction = ray.direction.normalize() * Ray::DIRECTION_MAX * 4.0,
        6 => ray.direction = ray.direction.normalize() * Ray::DIRECTION_MIN * 0.25,
        7 => (ray.t_min, ray.t_max) = (2.0, 1.0),
        8 => ray.t_min = [-1.0, f32::NAN, f32::INFINITY][random.below(3)],
        _ => ray.t_max = [0.0, -1.0, f32::NAN][random.below(3)],
    }
    assert!(!ray.is_traceable());
    ray
}

/// A GPU with these options, if there is one and tests are to use it.
fn open(options: GpuOptions) -> Option<GpuProbe> {
    let policy = TestPolicy::from_env().expect("TESSERA_GPU");
    policy.open(options).expect("a GPU, since TESSERA_GPU=require")
}

/// How many bytes a binding may hold, so that `pack` needs several and no more than the device has; `None` where it has too few.
fn split_of(gpu: &GpuProbe, pack: &Pack) -> Option<u64> {
    let (_, bindings) = gpu.adapter().limits.iter().find(|(name, _)| *name == "storage_buffers")?;
    // Six are not the pack's; a quarter of it makes ten at most, since pieces are powers of two.
    (*bindings >= 16).then_some(pack.bytes().len() as u64 / 4)
}

/// Holds every form of kernel to the CPU.
fn check(subject: &Subject, name: &str) {
    let rays = subject.rays(&mut Random(7));
    let expected: Vec<_> = rays.iter().map(|ray| subject.closest(ray)).collect();
    for (form, f64, is_split) in [
        (TraversalForm::PrivateStack, true, false),
        (TraversalForm::ShortStack, true, true),
        (TraversalForm::ShortStack, false, false),
        (TraversalForm::PrivateStack, false, true),
    ] {
        let options = GpuOptions { form, f64, ..GpuOptions::default() };
        let Some(gpu) = open(options) else { return };
        let options = GpuOptions {
            binding_bytes_max: is_split.then(|| split_of(&gpu, &subject.pack)).flatten(),
            ..options
        };
        let Some(gpu) = open(options) else { return };
        let scene = gpu.load(&subject.pack).expect("room for a small scene");
        let found = scene.hits(&rays, false).expect("an answer");
        let label = format!("{name}, {options:?}, f64 used: {}", gpu.uses_f64());
        if gpu.uses_f64() {
            same(&expected, &found, &label);
        } else {
            alike(subject, &rays, &expected, &found, &label);
        }
        any(&scene, &rays, &found, &label);
    }
}

/// With `f64`: the same triangle and the same bits.
fn same(expected: &[Option<Hit>], found: &[Option<Hit>], label: &str) {
    let bits = |hit: &Option<Hit>| hit.map(|h| (h.triangle, [h.t, h.b1, h.b2].map(f32::to_bits)));
    let differ: Vec<_> = (0..expected.len()).filter(|&i| bits(&expected[i]) != bits(&found[i])).collect();
    println!("{label}: {} of {} hits differ", differ.len(), expected.iter().flatten().count());
    if let Some(&i) = differ.first() {
        panic!("{label}: {} rays differ; ray {i}: {:?} and not {:?}", differ.len(), found[i], expected[i]);
    }
}

/// Without: the same triangle, or one that rounding may put before it; and from inside the mesh always one.
fn alike(subject: &Subject, rays: &[Ray], expected: &[Option<Hit>], found: &[Option<Hit>], label: &str) {
    let (mut others, mut worst) = (0, 0.0f64);
    for (ray, (expected, found)) in rays.iter().zip(expected.iter().zip(found)) {
        assert!(found.is_some() || !subject.must_hit(ray), "{label}: {ray:?} leaves the closed mesh");
        let triangle = |hit: &Hit| subject.soup.0[hit.triangle as usize];
        let near =
            |a: f32, b: f32, slack: f64| f64::from((a - b).abs()) <= slack + f64::from(MARGIN * a.max(b));
        // A hit at an end of the ray, or one that may pass beside the triangle, may count or not.
        let may_count = |hit: &Hit| {
            let (truth, slack) = (judge(ray, triangle(hit)), slack(ray, triangle(hit)));
            let is_doubtful = truth.to_edges <= f64::from(wgsl::LATERAL_ERROR);
            is_doubtful || near(hit.t, ray.t_min, slack) || near(hit.t, ray.t_max, slack)
        };
        let is_explained = match (expected, found) {
            (None, None) => continue,
            (Some(a), Some(b)) if a.triangle == b.triangle => {
                let share = f64::from((a.t - b.t).abs()) / slack(ray, triangle(a));
                assert!(
                    share <= 1.0,
                    "{label}: {ray:?} finds {found:?} and not {expected:?}, {share} of the bound"
                );
                worst = worst.max(share);
                continue;
            }
            (Some(a), Some(b)) => {
                near(a.t, b.t, slack(ray, triangle(a)) + slack(ray, triangle(b)))
                    || may_count(if a.t < b.t { a } else { b })
            }
            (Some(hit), None) | (None, Some(hit)) => may_count(hit),
        };
        assert!(ray.is_traceable() && is_explained, "{label}: {ray:?} finds {found:?} and not {expected:?}");
        others += 1;
    }
    println!(
        "{label}: {others} rays meet another triangle, distances are off by {worst:.2} of the bound at most"
    );
}

/// How far off the distance of a triangle may be without `f64`, in multiples of the ray's direction.
///
/// With `r` the largest coordinate of a corner relative to the origin, the corners are off by a roundoff `u r` along each axis. The plane through
/// them, where it passes the triangle, is no farther off than they are, `sqrt(3) u r`; the normal's components by two differences, a
/// fused cross product (2) and its rounding, and `n a` by a product and two sums more: in all fewer than 16 roundoffs of `sqrt(3) r`, less than 32 of
/// `r`. Along a ray that meets the plane at a cosine `c`, that is `32 u r / c`. A plane that is seen more edge-on than twice LEAST_STEEPNESS
/// (2^-12), or than its normal may be tilted by the corners' errors, says nothing: the distance is then held to those of the corners.
fn slack(ray: &Ray, corners: [Vec3; 3]) -> f64 {
    let [a, b, c] = corners.map(|v| v.as_dvec3() - ray.origin.as_dvec3());
    let d = ray.direction.as_dvec3();
    let roundoff = libm::exp2(-24.0) * a.abs().max(b.abs()).max(c.abs()).max_element();
    let normal = (b - a).cross(c - a);
    let cosine = normal.dot(d).abs() / (normal.length() * d.length());
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    let tilt = 4.0 * roundoff * longest / normal.length();
    if cosine > 2.0 * (libm::exp2(-12.0) + tilt) {
        return 32.0 * roundoff / (cosine * d.length());
    }
    let axis = (0..3).max_by(|&i, &j| d[i].abs().total_cmp(&d[j].abs())).unwrap_or(0);
    let along = [a, b, c].map(|p| p[axis] / d[axis]);
    let range = along.iter().fold(f64::MIN, |m, &t| m.max(t)) - along.iter().fold(f64::MAX, |m, &t| m.min(t));
    range + 32.0 * roundoff / d[axis].abs()
}

/// Where any hit will do, there is one just when there is a nearest.
fn any(scene: &ProbedScene, rays: &[Ray], closest: &[Option<Hit>], label: &str) {
    let found = scene.hits(rays, true).expect("an answer");
    for (ray, (found, closest)) in rays.iter().zip(found.iter().zip(closest)) {
        assert_eq!(found.is_some(), closest.is_some(), "{label}: any hit of {ray:?}: {found:?}, {closest:?}");
    }
}

#[test]
fn packed_narrow_cells_with_two_references() {
    let subject = Subject::new(false, 1024, 2);
    assert!(!VertexLayout::of(&subject.pack).wide_cells);
    check(&subject, "narrow");
}

#[test]
fn packed_wide_cells_with_one_reference() {
    let subject = Subject::new(false, 8192, 1);
    assert!(VertexLayout::of(&subject.pack).wide_cells);
    check(&subject, "wide");
}

#[test]
fn plain_vertices_without_references() {
    let subject = Subject::new(true, 8192, 0);
    assert!(VertexLayout::of(&subject.pack).plain_positions);
    check(&subject, "plain");
}

#[test]
fn what_cannot_be_held_is_refused_with_numbers() {
    let subject = Subject::new(false, 8192, 2);
    let options = GpuOptions { binding_bytes_max: Some(64), ..GpuOptions::default() };
    let Some(gpu) = open(options) else { return };
    let Err(error) = gpu.load(&subject.pack) else {
        panic!("{} bytes in bindings of 64", subject.pack.bytes().len())
    };
    let GpuError::CannotHold { needs, has, .. } = error else { panic!("{error}") };
    assert!(needs > has && has > 0 && has % 64 == 0, "{error}");
    let message = error.to_string();
    assert!(message.contains(&needs.to_string()) && message.contains(&has.to_string()), "{message}");
}
