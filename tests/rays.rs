//! The tree of a prepared pack finds what a test of every triangle finds: real and generated scenes, quantised and plain, with 0, 1 and 2
//! references, ray by ray and eight at once, rays of every kind. 10^4 rays a scene, a fifth of that with plain vertices; for ten times as
//! many, and generators of 300,000 triangles:
//!
//! ```text
//! TESSERA_RAYS=100000 cargo test --release --test tests -- rays:: --nocapture
//! ```

use crate::kinds::{Random, Soup, split_planes, truth, unkind_ray};
use crate::support::{root, scene_folder};
use std::path::Path;
use std::time::Duration;
use tessera_geometry::triangle::{RayShear, intersect};
use tessera_geometry::wide::LANES;
use tessera_geometry::{CameraPose, Hit, LocalCamera, Ray, Vec3};
use tessera_kdtree::{BuildOptions, Kernel, Tree, TreeView, Triangles, brute_force_closest_hits, build};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_pack::{LightKind, Pack, Plain};
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_scene::{LoadOptions, Scene, Without};

/// Rays a scene unless `TESSERA_RAYS` says otherwise.
const RAYS: usize = 10_000;

/// Of so many packets one ray is also held to [`truth`], which takes long.
const JUDGED: usize = 13;

/// How many rays a scene gets.
pub fn ray_count() -> usize {
    match std::env::var("TESSERA_RAYS") {
        Ok(count) => count.parse().expect("TESSERA_RAYS is a whole number"),
        Err(_) => RAYS,
    }
}

/// A pack and what rays are made from.
pub struct Subject<'a> {
    pub pack: &'a Pack,
    camera: LocalCamera,
    /// Its triangles, decoded once.
    pub soup: Soup,
    pub planes: Vec<(usize, f32)>,
}

impl<'a> Subject<'a> {
    fn new(prepared: &'a Prepared) -> Self {
        Self::of(&prepared.pack, &prepared.cameras[0].pose)
    }

    pub fn of(pack: &'a Pack, pose: &CameraPose) -> Self {
        let mesh = pack.mesh();
        Self {
            pack,
            camera: pose.to_local(&pack.frame(), 1024, 1024).expect("a usable pose"),
            soup: Soup((0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect()),
            planes: split_planes(pack.tree().slots),
        }
    }

    /// Packet number `i`: of neighbouring pixels, from what they see towards a light or anywhere, or unkind.
    pub fn packet(&self, i: usize, random: &mut Random) -> [Ray; LANES] {
        let kind = i % 8;
        if kind > 4 {
            return std::array::from_fn(|_| {
                unkind_ray(i / 8 * 3 + kind - 5, random, &self.soup, &self.planes)
            });
        }
        let corner = [random.unit(), random.unit()].map(|x| (x * 1020.0).floor() + 0.5);
        let light = random.below(self.pack.lights().len().max(1));
        std::array::from_fn(|lane| {
            let [x, y] = [corner[0] + (lane % 4) as f32, corner[1] + (lane / 4) as f32];
            let eye = self.camera.ray(x, y, 1024, 1024);
            match kind {
                0 | 1 => eye,
                // Origins lie in the surface: its own triangle is met just before, just behind, or at 0.
                2 => self.seen_by(&eye).and_then(|at| self.towards(light, at)).unwrap_or(eye),
                _ => self.seen_by(&eye).map_or(eye, |origin| Ray {
                    origin,
                    direction: random.direction(),
                    t_min: 0.0,
                    t_max: f32::INFINITY,
                }),
            }
        })
    }

    fn seen_by(&self, eye: &Ray) -> Option<Vec3> {
        let Hit { triangle, b1, b2, .. } = self.pack.tree().closest_hit(&self.pack.mesh(), eye, |_| true)?;
        let [a, b, c] = self.soup.0[triangle as usize];
        Some(a * (1.0 - b1 - b2) + b * b1 + c * b2)
    }

    /// The shadow ray to a light, if there is one.
    fn towards(&self, light: usize, origin: Vec3) -> Option<Ray> {
        let light = self.pack.lights().get(light)?;
        if light.kind == LightKind::Directional as u32 {
            let direction = -Vec3::from_array(light.direction);
            return Some(Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY });
        }
        let direction = Vec3::from_array(light.position) - origin;
        Some(Ray { origin, direction, t_min: 0.0, t_max: 1.0 - 1.0 / 1_048_576.0 })
    }
}

/// Holds the trees of a scene to brute force.
fn check(scene: &Scene) {
    for positions in [false, true] {
        let options = PrepareOptions {
            without: Without { textures: true, ..Without::default() },
            plain: Plain { positions, ..Plain::default() },
            ..PrepareOptions::default()
        };
        let prepared = prepare_scene(scene.clone(), &options, Duration::ZERO).expect("it packs");
        let name = format!("{}{}", prepared.name, if positions { ", plain" } else { "" });
        let rays = if positions { ray_count() / 5 } else { ray_count() };
        check_prepared(&name, &Subject::new(&prepared), rays.div_ceil(LANES));
    }
}

fn check_prepared(name: &str, subject: &Subject, packets: usize) {
    let Subject { pack, soup, .. } = subject;
    let trees: [Tree; 2] = [0, 1].map(|max_refs| {
        let options = BuildOptions { max_refs, ..BuildOptions::default() };
        build(soup.len(), |id| soup.0[id as usize], &options).expect("good options")
    });
    let mut random = Random(7);
    let (mut hits, mut judged, mut differing) = (0, 0, 0);
    for i in 0..packets {
        let rays = subject.packet(i, &mut random);
        let expected = brute_force_closest_hits(Kernel::wide(), soup.len(), soup, &rays, 0xFF, |_, _| true);
        hits += expected.iter().flatten().count();
        for (refs, found) in [
            ("no references", search(trees[0].view(), soup, &rays)),
            ("one reference", search(trees[1].view(), soup, &rays)),
            ("as packed", search(pack.tree(), &pack.mesh(), &rays)),
        ] {
            for lane in 0..LANES {
                let what = || format!("{name}, {refs}, packet {i}, {:?}", rays[lane]);
                assert_eq!(bits(found[lane]), bits(expected[lane]), "{}", what());
            }
        }
        if i % JUDGED == 0 {
            judged += 1;
            differing += usize::from(!is_true(name, subject, &rays[i % LANES]));
        }
    }
    let rays = packets * LANES;
    assert!(hits > rays / 8, "{name}: only {hits} of {rays} rays hit anything");
    println!(
        "{name}: {} triangles, {rays} rays, {hits} hit; {differing} of {judged} differ from f64, within rounding",
        soup.len()
    );
}

/// The closest hits; ray by ray and eight at once must agree about them, and about whether there is any.
pub fn search(tree: TreeView, triangles: &impl Triangles, rays: &[Ray; LANES]) -> [Option<Hit>; LANES] {
    let wide = tree.closest_hits(Kernel::wide(), triangles, rays, 0xFF);
    let any = tree.any_hits(Kernel::wide(), triangles, rays, 0xFF);
    for (lane, ray) in rays.iter().enumerate() {
        let single = tree.closest_hit(triangles, ray, |_| true);
        assert_eq!(bits(wide[lane]), bits(single), "eight at once: {ray:?}");
        let any = [any >> lane & 1 == 1, tree.any_hit(triangles, ray, |_| true)];
        assert_eq!(any, [single.is_some(); 2], "any hit: {ray:?}");
    }
    wide
}

/// What must agree: triangle, distance, weights.
fn bits(hit: Option<Hit>) -> Option<(u32, [u32; 3])> {
    hit.map(|h| (h.triangle, [h.t, h.b1, h.b2].map(f32::to_bits)))
}

/// Whether the ray finds what an independent test of every triangle finds in `f64`; if not, it must be for rounding at an edge.
fn is_true(name: &str, Subject { pack, soup, .. }: &Subject, ray: &Ray) -> bool {
    // Whether the surface at the origin lies before or behind it is for rounding to say: begin off it.
    let extent = (pack.tree().bounds.extent() / 1024.0).max_element();
    let ray = Ray { t_min: extent / ray.direction.length(), ..*ray };
    let found = ray.is_traceable().then(|| pack.tree().closest_hit(&pack.mesh(), &ray, |_| true)).flatten();
    let nearest = (0..soup.len())
        .filter_map(|id| Some((truth::judge(&ray, soup.0[id as usize]).t?, id)))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let found = found.map(|hit| (f64::from(hit.t), hit.triangle));

    // One place, perhaps of another triangle of it, is one answer.
    if let (Some((t, _)), Some((wanted, _))) = (found, nearest)
        && (t - wanted).abs() <= wanted * f64::from(f32::EPSILON)
    {
        return true;
    }
    let is_decided_by_rounding = |&(_, id): &(f64, u32)| {
        let vertices = soup.0[id as usize];
        let verdict = truth::judge(&ray, vertices);
        let ours = intersect(&ray, &RayShear::new(&ray), vertices, ray.t_max);
        verdict.is_within_rounding() && verdict.t.map(|t| t as f32) != ours.map(|c| c.t)
    };
    let is_same = found.is_none() && nearest.is_none();
    assert!(
        is_same || found.iter().chain(&nearest).any(is_decided_by_rounding),
        "{name}: {found:?} instead of {nearest:?}: {ray:?}"
    );
    is_same
}

fn check_generated(kind: Kind) {
    // Within 2 % of what is asked for.
    let triangles = if ray_count() > RAYS { 294_000 } else { 20_000 };
    let mut scene = generate(&Recipe { kind, triangles, seed: 1 }).expect("in range");
    scene.name = kind.name().into();
    check(&scene);
}

fn check_file(folder: &Path, path: &Path) {
    let options = LoadOptions { scenes_folder: Some(folder.to_owned()) };
    check(&tessera_scene::load(path, &options).expect("it loads"));
}

#[test]
fn cornell() {
    check_generated(Kind::Cornell);
}

#[test]
fn hall() {
    check_generated(Kind::Hall);
}

#[test]
fn rooms() {
    check_generated(Kind::Rooms);
}

#[test]
fn plant() {
    check_generated(Kind::Plant);
}

#[test]
fn city() {
    check_generated(Kind::City);
}

#[test]
fn every_generator_is_tested() {
    assert_eq!(Kind::ALL.len(), 5, "give the new generator a test above");
}

#[test]
fn bunny() {
    if let Some(folder) = scene_folder() {
        check_file(&folder, &folder.join("stanford_bunny/bun_zipper.ply"));
    }
}

#[test]
fn dragon() {
    if let Some(folder) = scene_folder() {
        check_file(&folder, &folder.join("stanford_dragon/dragon_vrip_res4.ply"));
    }
}

#[test]
fn sponza() {
    if let Some(folder) = scene_folder() {
        check_file(&folder, &root().join("scenes/sponza.toml"));
    }
}
