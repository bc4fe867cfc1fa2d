//! Pictures whose every value is known, and references kept in files.

use glam::{DMat4, DVec3};
use std::f64::consts::PI;
use std::fs;
use tessera_geometry::CameraPose;
use tessera_oracle::{Key, NO_TRIANGLE, Oracle, OracleImage, Reference, VERSION, View};
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_scene::{
    AlphaMode, Environment, Image, Light, LightKind, Material, Mesh, Node, Primitive, Scene, TextureRef,
    Without, Wrap,
};

/// What is done to something, and what the error then says.
type Change<'a, T> = (&'a dyn Fn(&mut T), &'a str);

/// A scene of parallelograms, each with a material of its own.
#[derive(Default)]
struct Stage(Scene);

impl Stage {
    /// Adds one along `u` and `v` from `corner`; its front is where `u x v` points, its texture runs along `u` and `v`.
    fn quad(mut self, corner: [f64; 3], u: [f64; 3], v: [f64; 3], material: Material) -> Self {
        let (corner, u, v) = (DVec3::from(corner), DVec3::from(u), DVec3::from(v));
        let scene = &mut self.0;
        scene.materials.push(material);
        scene.meshes.push(Mesh {
            name: String::new(),
            primitives: vec![Primitive {
                positions: vec![corner, corner + u, corner + u + v, corner + v],
                uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                material: scene.materials.len() - 1,
                ..Primitive::default()
            }],
        });
        scene.roots.push(scene.nodes.len());
        scene.nodes.push(Node {
            name: String::new(),
            transform: DMat4::IDENTITY,
            mesh: Some(scene.meshes.len() - 1),
            children: Vec::new(),
        });
        self
    }

    /// A wall at this depth that faces +z, 200 wide.
    fn wall(self, z: f64, material: Material) -> Self {
        self.quad([-100.0, -100.0, z], [200.0, 0.0, 0.0], [0.0, 200.0, 0.0], material)
    }

    fn lamp(mut self, kind: LightKind, position: [f64; 3], direction: [f64; 3], intensity: f32) -> Self {
        self.0.lights.push(Light {
            name: String::new(),
            kind,
            position: position.into(),
            direction: direction.into(),
            intensity: [intensity, intensity / 2.0, 0.0],
            range: f32::INFINITY,
        });
        self
    }

    fn sky(mut self, radiance: f32) -> Self {
        self.0.environment =
            Environment::Gradient { zenith: [radiance; 3], horizon: [radiance; 3], nadir: [radiance; 3] };
        self
    }

    /// What a ray from `eye` to `target` shows.
    fn look(&self, eye: [f64; 3], target: [f64; 3]) -> OracleImage {
        self.look_to_depth(eye, target, 8)
    }

    fn look_to_depth(&self, eye: [f64; 3], target: [f64; 3], depth: u32) -> OracleImage {
        Oracle::new(&self.0, Without::default()).expect("sound").render(&view(eye, target, depth), |_| ())
    }

    fn red(&self, eye: [f64; 3], target: [f64; 3]) -> f64 {
        self.look(eye, target).color[0][0]
    }
}

/// One pixel.
fn view(eye: [f64; 3], target: [f64; 3], depth: u32) -> View {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    // Never parallel to the view.
    let up = (target - eye).normalize().any_orthogonal_vector();
    let pose = CameraPose { eye, target, up, fov_degrees: 1.0 };
    View { pose, width: 1, height: 1, samples: 1, depth, min_weight: 0.0 }
}

/// Rough, without highlight: sends back irradiance / pi.
fn chalk() -> Material {
    Material { specular: [0.0; 3], ..Material::default() }
}

fn glow(radiance: f32) -> Material {
    Material { emissive: [radiance; 3], base_color: [0.0, 0.0, 0.0, 1.0], ..chalk() }
}

/// A perfect mirror of this reflectance at normal incidence.
fn mirror(reflectance: f32) -> Material {
    let base_color = [reflectance, reflectance, reflectance, 1.0];
    Material { base_color, metallic: 1.0, roughness: 0.0, ..Material::default() }
}

fn glass(ior: f32) -> Material {
    Material { transmission: 1.0, roughness: 0.0, ior, ..Material::default() }
}

fn assert_near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{found} is not {expected}");
}

#[test]
fn a_plane_sends_back_what_arrives() {
    let base_color = [0.5, 1.0, 1.0, 1.0];
    let stage = || Stage::default().wall(0.0, Material { base_color, ..chalk() });

    // A point of 8 candela 2 above, 1.5 aside: E = I cos / d^2.
    let point = stage().lamp(LightKind::Point, [1.5, 0.0, 2.0], [0.0, 0.0, -1.0], 8.0);
    let distance: f64 = 2.5;
    let expected = 0.5 * 8.0 * (2.0 / distance) / (distance * distance) / PI;
    let image = point.look([3.0, 1.0, 4.0], [0.0, 0.0, 0.0]);
    assert_near(image.color[0][0], expected);
    // Half the intensity, twice the colour.
    assert_near(image.color[0][1], expected);
    assert_eq!((image.color[0][2], image.color[0][3]), (0.0, 1.0));

    // Lux from 60 degrees aside.
    let slant = [0.75_f64.sqrt(), 0.0, -0.5];
    let sun = stage().lamp(LightKind::Directional, [0.0; 3], slant, 3.0);
    assert_near(sun.red([0.0, 0.5, 4.0], [0.0; 3]), 0.5 * 3.0 * 0.5 / PI);

    // A spot between its cones: the square of the share of the cosine.
    let (inner, outer) = (0.2_f32, 0.6_f32);
    let spot = stage().lamp(LightKind::Spot { inner, outer }, [0.0, 0.0, 2.0], [0.0, 0.0, -1.0], 8.0);
    let (aside, down) = (0.8, 2.0);
    let distance2: f64 = aside * aside + down * down;
    let cosine = down / distance2.sqrt();
    let (inside, outside) = (libm::cos(f64::from(inner)), libm::cos(f64::from(outer)));
    let share = (cosine - outside) / (inside - outside);
    assert!(0.0 < share && share < 1.0);
    assert_near(
        spot.red([0.3, 0.5, 4.0], [aside, 0.0, 0.0]),
        0.5 * 8.0 * cosine / distance2 / PI * share * share,
    );
    assert_eq!(spot.red([0.3, 0.5, 4.0], [2.0, 0.0, 0.0]), 0.0);

    // A range: 1 - (d / range)^4.
    let mut short = stage().lamp(LightKind::Point, [0.0, 0.0, 2.0], [0.0; 3], 8.0);
    short.0.lights[0].range = 4.0;
    assert_near(short.red([0.3, 0.5, 4.0], [0.0; 3]), 0.5 * 8.0 / 4.0 / PI * (1.0 - 1.0 / 16.0));

    // Behind the plane no lamp is seen, from behind none in front.
    assert_eq!(point.red([0.0, 0.0, -4.0], [0.0; 3]), 0.0);
}

#[test]
fn a_shadow_ends_where_the_light_passes_the_edge() {
    // A half plane at height 1, its edge at x = 0; a lamp above it at (-1, 0, 3): the shadow on z = 0 reaches to x = 1/2.
    let stage = Stage::default().wall(0.0, chalk()).lamp(LightKind::Point, [-1.0, 0.0, 3.0], [0.0; 3], 1.0);
    let edge = -1.0 + 1.0 * 3.0 / 2.0;
    let stage = stage.quad([-50.0, -50.0, 1.0], [50.0, 0.0, 0.0], [0.0, 100.0, 0.0], chalk());
    let eye = [4.0, 0.0, 0.5];
    assert_eq!(stage.red(eye, [edge - 1e-9, 0.1, 0.0]), 0.0);
    assert!(stage.red(eye, [edge + 1e-9, 0.1, 0.0]) > 0.01);

    // A lamp in the plane of a surface is not put out by it, neither by a lamp shade that touches it.
    let ceiling = Stage::default().wall(0.0, chalk()).wall(3.0, chalk());
    let ceiling = ceiling.lamp(LightKind::Point, [0.0, 0.0, 3.0], [0.0; 3], 1.0);
    assert_near(ceiling.red([1.0, 0.0, 1.0], [0.0; 3]), 1.0 / 9.0 / PI);
}

#[test]
fn coincident_surfaces_do_not_shadow_each_other() {
    // The same wall thrice, lit and seen ever flatter.
    let triple = |z| Stage::default().wall(z, chalk()).wall(z, chalk()).wall(z, chalk());
    for k in 0..60 {
        let slope = libm::exp2(-f64::from(k) / 4.0);
        let length = (1.0 + slope * slope).sqrt();
        let sun = [-1.0 / length, 0.0, -slope / length];
        for z in [0.3, 1e7 + 0.1] {
            let stage = triple(z).lamp(LightKind::Directional, [0.0; 3], sun, 1.0);
            let found = stage.red([2.0, 0.3, z + 2.0], [0.12345, 0.1, z]);
            assert_near(found, -sun[2] / PI);
        }
    }
}

#[test]
fn facing_mirrors_show_a_geometric_series() {
    // Two mirrors of reflectance k that glow by e: e (1 + k + ... + k^depth).
    let shiny = || Material { emissive: [0.25; 3], ..mirror(0.5) };
    let stage = Stage::default().wall(0.0, shiny()).wall(2.0, shiny());
    for depth in [0u32, 1, 5, 20] {
        let image = stage.look_to_depth([0.1, 0.2, 1.0], [0.1, 0.2, 0.0], depth);
        assert_near(image.color[0][0], 0.25 * (1.0 - libm::pow(0.5, f64::from(depth + 1))) / 0.5);
        assert_eq!((image.rays.reflection, image.cut_weight), (u64::from(depth), 0.0));
    }

    // Cut off at a weight of 1/8: three more generations count, and what is left out weighs 1/16.
    let oracle = Oracle::new(&stage.0, Without::default()).expect("sound");
    let cut = View { min_weight: 0.125, ..view([0.1, 0.2, 1.0], [0.1, 0.2, 0.0], 20) };
    let image = oracle.render(&cut, |_| ());
    assert_eq!((image.color[0][0], image.cut_weight), (0.25 * 1.875, 0.0625));
}

#[test]
fn a_mirror_shows_what_lies_at_the_angle_of_reflection() {
    // A mirror floor; what is seen in it at (1, 0, 0) from (0, 0, 1) is at (2, 0, 1): the border between two walls.
    let stage = Stage::default()
        .wall(0.0, mirror(1.0))
        .quad([2.0, -50.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 1.0], glow(1.0))
        .quad([2.0, -50.0, 1.0], [0.0, 100.0, 0.0], [0.0, 0.0, 50.0], glow(3.0));
    let at = |x: f64| stage.red([0.0, 0.0, 1.0], [x, 0.1, 0.0]);
    assert_near(at(1.0 + 1e-9), 1.0);
    assert_near(at(1.0 - 1e-9), 3.0);
}

#[test]
fn a_slab_shifts_what_is_behind_it() {
    // Glass of index n, 1 thick, met at 45 degrees: the ray comes out parallel, d sin (1 - cos / sqrt(n^2 - sin^2)) aside, which is that
    // over the cosine along the wall behind.
    let n: f64 = 1.5;
    let angle = PI / 4.0;
    let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
    let along = 1.0 * sine * (1.0 - cosine / (n * n - sine * sine).sqrt()) / cosine;

    // A wall 5 behind, dark up to x = 0.
    let slab = |material: Material| {
        Stage::default()
            .wall(0.0, material.clone())
            .quad([-100.0, 100.0, -1.0], [200.0, 0.0, 0.0], [0.0, -200.0, 0.0], material)
            .quad([0.0, -100.0, -6.0], [100.0, 0.0, 0.0], [0.0, 200.0, 0.0], glow(1.0))
    };
    let seen = |stage: &Stage, at: f64| {
        // Unbent, the ray would meet the wall at x = `at`.
        stage.red([at - 16.0, 0.0, 10.0], [at - 6.0, 0.0, 0.0])
    };
    let stage = slab(glass(1.5));
    // Where the straight way through ends in the dark, what is reflected twice inside comes out farther on, in the light.
    assert!(seen(&stage, along + 1e-9) > 0.5, "to the right of the shifted edge");
    assert!(seen(&stage, along - 1e-9) < 0.01);

    // Every way through: T (1 + R^2 + ...) with T = (1 - R)^2; what the inner reflections see besides is the wall too.
    let far = seen(&stage, 60.0);
    let parallel = (n * cosine - (1.0 - sine * sine / (n * n)).sqrt())
        / (n * cosine + (1.0 - sine * sine / (n * n)).sqrt());
    let across = (cosine - n * (1.0 - sine * sine / (n * n)).sqrt())
        / (cosine + n * (1.0 - sine * sine / (n * n)).sqrt());
    let r = (parallel * parallel + across * across) / 2.0;
    let bounces = (1.0 - r) * (1.0 - r) * (1.0 + r * r + r * r * r * r);
    assert!((far - bounces).abs() < 2.0 * libm::pow(r, 6.0) + 1e-12, "{far} is not {bounces}");

    // A thin wall, and glass as thin as air, bend nothing.
    for material in [Material { thin_walled: true, ..glass(1.5) }, glass(1.0)] {
        let stage = slab(material);
        assert!(seen(&stage, 1e-9) > 0.5 && seen(&stage, -1e-9) < 0.01);
    }
}

#[test]
fn light_passes_glass_veils_and_holes() {
    let lit = |material: Material| {
        let stage =
            Stage::default().wall(0.0, chalk()).lamp(LightKind::Directional, [0.0; 3], [0.0, 0.0, -1.0], 1.0);
        stage.wall(1.0, material).red([1.0, 0.0, 0.5], [0.1, 0.2, 0.0]) * PI
    };
    assert_near(lit(Material { base_color: [0.5, 1.0, 1.0, 1.0], ..glass(1.5) }), 0.5);
    // Metal passes nothing; an alpha passes the rest.
    assert_eq!(lit(Material { metallic: 1.0, ..glass(1.5) }), 0.0);
    assert_near(
        lit(Material { alpha: AlphaMode::Blend, base_color: [1.0, 1.0, 1.0, 0.25], ..chalk() }),
        0.75,
    );
    let mask =
        |alpha: f32| Material { alpha: AlphaMode::Mask(0.5), base_color: [1.0, 1.0, 1.0, alpha], ..chalk() };
    assert_near(lit(mask(0.25)), 1.0);
    assert_eq!(lit(mask(0.5)), 0.0);
    // Shadows know no sides.
    assert_eq!(lit(Material { double_sided: false, ..chalk() }), 0.0);
}

#[test]
fn left_out_rays_take_their_share_of_the_material_with_them() {
    let radiance = |material: Material, without: Without| {
        let stage = Stage::default().wall(0.0, material).wall(-1.0, glow(1.0)).wall(9.0, glow(2.0));
        let stage = stage.lamp(LightKind::Directional, [0.0; 3], [0.0, 0.0, -1.0], 1.0);
        let oracle = Oracle::new(&stage.0, without).expect("sound");
        oracle.render(&view([0.1, 0.2, 2.0], [0.1, 0.2, 0.0], 8), |_| ()).color[0][0]
    };
    let on = Without::default();
    let pane = || Material { thin_walled: true, specular: [0.0; 3], ..glass(1.5) };
    assert_near(radiance(pane(), on), 0.96 + 0.04 * 2.0);
    // Without reflection what glass reflects passes too.
    assert_near(radiance(pane(), Without { reflection: true, ..on }), 1.0);
    // Without refraction it is an opaque white body, lit by the lamp unless the far wall is in the way.
    let opaque = Without { refraction: true, ..on };
    assert_near(radiance(pane(), opaque), 0.0);
    assert_near(radiance(pane(), Without { shadows: true, ..opaque }), 1.0 / PI);
}

#[test]
fn veils_holes_and_backs_are_looked_through() {
    let behind = |material: Material, eye: f64| {
        let stage = Stage::default().wall(0.0, material).wall(-1.0, glow(1.0)).wall(9.0, glow(2.0));
        stage.look([0.1, 0.2, eye], [0.1, 0.2, 0.0])
    };
    let veil =
        |alpha: f32| Material { alpha: AlphaMode::Blend, base_color: [0.0, 0.0, 0.0, alpha], ..chalk() };
    let image = behind(veil(0.25), 2.0);
    assert_near(image.color[0][0], 0.75);
    assert_eq!((image.id[0], image.depth[0]), (1, 2.0));
    assert_eq!(image.normal[0], [0.0, 0.0, 1.0]);

    // What covers nothing is not the first surface; nor are holes and backs that do not show.
    let hole = Material { alpha: AlphaMode::Mask(0.5), base_color: [1.0, 1.0, 1.0, 0.4], ..chalk() };
    for material in [veil(0.0), hole] {
        let image = behind(material, 2.0);
        assert_eq!((image.color[0][0], image.depth[0]), (1.0, 3.0));
        assert!(image.id[0] == 2 || image.id[0] == 3);
    }
    let one_sided = Material { double_sided: false, ..glow(5.0) };
    assert_eq!(behind(one_sided.clone(), 2.0).color[0][0], 5.0);
    // From behind: through it to the wall in front of it.
    let image = behind(one_sided, -0.5);
    assert_eq!((image.color[0][0], image.depth[0]), (2.0, 9.5));
    // What transmits has a back.
    let image = behind(Material { double_sided: false, thin_walled: true, ..glass(1.5) }, -0.5);
    assert_near(image.color[0][0], 0.96 * 2.0 + 0.04 * 1.0);
}

#[test]
fn a_path_passes_64_layers() {
    let seen = |layers: u32| {
        let veil = || Material { alpha: AlphaMode::Blend, base_color: [0.0; 4], ..chalk() };
        let stage = (0..layers).fold(Stage::default().wall(-1.0, glow(1.0)), |stage, k| {
            stage.wall(f64::from(k) / 100.0, veil())
        });
        let image = stage.look([0.1, 0.2, 3.0], [0.1, 0.2, 0.0]);
        image.color[0]
    };
    assert_eq!(seen(64), [1.0; 4]);
    assert_eq!(seen(65), [0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn a_miss_is_transparent_without_surroundings() {
    let veil =
        Material { alpha: AlphaMode::Blend, base_color: [1.0, 1.0, 1.0, 0.25], unlit: true, ..chalk() };
    let stage = Stage::default().quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], veil);
    assert_eq!(stage.look([0.1, 0.2, 3.0], [0.1, 0.2, 0.0]).color[0], [0.25; 4]);
    let miss = stage.look([0.1, 0.2, 3.0], [5.0, 0.2, 0.0]);
    assert_eq!((miss.color[0], miss.id[0], miss.depth[0]), ([0.0; 4], NO_TRIANGLE, f64::INFINITY));
    assert!(!miss.is_hit(0));
    assert_eq!(stage.sky(0.5).look([0.1, 0.2, 3.0], [0.1, 0.2, 0.0]).color[0], [0.625, 0.625, 0.625, 1.0]);
}

#[test]
fn surroundings_are_a_gradient_or_a_picture() {
    let mut stage = Stage::default();
    stage.0.environment = Environment::Gradient { zenith: [4.0; 3], horizon: [1.0; 3], nadir: [2.0; 3] };
    for (direction, expected) in [([0.0, 1.0, 0.0], 4.0), ([3.0, 0.0, 4.0], 1.0), ([3.0, -4.0, 0.0], 1.8)] {
        assert_near(stage.red([0.0; 3], direction), expected);
    }

    // Four columns by two rows: the centre of the image is +z, -x to the right of it.
    let code = |k: u8| [k * 30, 0, 0, 255];
    let texels: Vec<u8> = (0..8).flat_map(code).collect();
    stage.0.images.push(Image { name: String::new(), width: 4, height: 2, rgba: texels.into() });
    stage.0.environment = Environment::Map { image: 0, scale: 2.0 };
    let light = |code: f64| libm::pow((code / 255.0 + 0.055) / 1.055, 2.4);
    // The texel's centre at longitude 45 degrees to the right, latitude 45 up: column 2, row 0.
    let up = 1.0 / 2f64.sqrt();
    let found = stage.red([0.0; 3], [-up * up, up, up * up]);
    assert_near(found, 2.0 * light(60.0));
}

#[test]
fn a_texture_lies_on_its_surface() {
    let texels = [[0u8, 0, 0, 255], [255, 255, 255, 255]].concat();
    let texture = TextureRef { image: 0, wrap_s: Wrap::Clamp, wrap_t: Wrap::Clamp, nearest: false };
    let painted = Material { unlit: true, base_texture: Some(texture), ..chalk() };
    let mut stage = Stage::default().quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], painted);
    stage.0.images.push(Image { name: String::new(), width: 2, height: 1, rgba: texels.into() });
    for (x, expected) in [(0.1, 0.0), (0.25, 0.0), (0.375, 0.25), (0.6, 0.7), (0.9, 1.0)] {
        assert_near(stage.red([x, 0.3, 2.0], [x, 0.3, 0.0]), expected);
    }
    let bare = Oracle::new(&stage.0, Without { textures: true, ..Without::default() }).expect("sound");
    assert_eq!(bare.render(&view([0.1, 0.3, 2.0], [0.1, 0.3, 0.0], 1), |_| ()).color[0], [1.0; 4]);
}

#[test]
fn many_samples_tend_to_the_share_that_is_covered() {
    // A slanting edge cuts the only pixel; by n samples its area comes out within a few parts in n: each edge adds O(log n / n).
    let stage = Stage::default().quad(
        [0.0, -9.0, 0.0],
        [9.0, 9.0, 0.0],
        [-9.0, 9.0, 0.0],
        Material { unlit: true, ..chalk() },
    );
    let oracle = Oracle::new(&stage.0, Without::default()).expect("sound");
    let pose = CameraPose {
        eye: DVec3::new(0.2, -9.0, 1.0),
        target: DVec3::new(0.2, -9.0, 0.0),
        up: DVec3::Y,
        fov_degrees: 90.0,
    };
    // The square [-0.8, 1.2] x [-1, 1] above y > |x|.
    let expected = (1.0 * 1.0 / 2.0 + 0.8 * 0.8 / 2.0 + 0.8 * 0.2) / 4.0;
    for samples in [16, 64, 256, 1024] {
        let view = View { pose, width: 1, height: 1, samples, depth: 0, min_weight: 0.0 };
        let alpha = oracle.render(&view, |_| ()).color[0][3];
        assert!((alpha - expected).abs() < 8.0 / f64::from(samples), "{samples}: {alpha} is not {expected}");
    }
}

#[test]
fn the_tree_changes_no_bit_of_a_picture() {
    for kind in [Kind::Cornell, Kind::Hall] {
        let scene = generate(&Recipe { kind, triangles: 1500, seed: 2 }).expect("in range");
        let view = View {
            pose: scene.cameras[0].pose,
            width: 20,
            height: 15,
            samples: 2,
            depth: 4,
            min_weight: 1.0 / 512.0,
        };
        let oracle = Oracle::new(&scene, Without::default()).expect("sound");
        let rows = std::sync::atomic::AtomicU32::new(0);
        let fast = oracle.render(&view, |_| {
            rows.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        });
        assert_eq!(rows.into_inner(), 15);
        assert!(
            fast.rays.reflection > 0 && fast.rays.shadow > 0 && fast.id.iter().any(|&id| id != NO_TRIANGLE)
        );
        assert!(fast == oracle.by_brute_force().render(&view, |_| ()), "{kind}");
    }
}

#[test]
fn the_hash_follows_what_is_seen() {
    let scene = || {
        let stage = Stage::default().wall(0.0, chalk()).wall(1.0, glass(1.5)).sky(1.0);
        stage.lamp(LightKind::Point, [0.0, 0.0, 4.0], [0.0; 3], 1.0).0
    };
    let hash = |scene: &Scene, without| Oracle::new(scene, without).expect("sound").content_hash();
    let on = Without::default();
    let first = hash(&scene(), on);
    assert_eq!(first, hash(&scene(), on));

    // Names say nothing, nor does what no ray can meet: a material that nothing uses may.
    let mut renamed = scene();
    renamed.name = "another".into();
    renamed.materials[0].name = "another".into();
    renamed.lights[0].name = "another".into();
    assert_eq!(first, hash(&renamed, on));

    let changes: [&dyn Fn(&mut Scene); 9] = [
        &|s| s.meshes[0].primitives[0].positions[2].x = s.meshes[0].primitives[0].positions[2].x.next_up(),
        &|s| s.meshes[1].primitives[0].triangles.swap(0, 1),
        &|s| s.materials[1].ior = 1.4,
        &|s| s.materials[0].double_sided = false,
        &|s| s.lights[0].range = 7.0,
        &|s| s.lights[0].position.y += 1.0,
        &|s| s.ambient[1] = 0.5,
        &|s| s.environment = Environment::None,
        &|s| s.nodes[0].transform = DMat4::from_translation(DVec3::X),
    ];
    let mut all = vec![first, hash(&scene(), Without { shadows: true, ..on })];
    for change in changes {
        let mut scene = scene();
        change(&mut scene);
        all.push(hash(&scene, on));
    }
    let count = all.len();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), count);
}

#[test]
fn an_unsound_scene_is_refused_in_one_line() {
    let scene = || Stage::default().wall(0.0, chalk()).lamp(LightKind::Point, [0.0; 3], [0.0; 3], 1.0).0;
    let texture = TextureRef { image: 3, wrap_s: Wrap::Repeat, wrap_t: Wrap::Repeat, nearest: false };
    let cases: [Change<Scene>; 6] = [
        (&|s| s.materials[0].metallic = 2.0, "material 0"),
        (&|s| s.materials[0].emissive[0] = f32::NAN, "material 0"),
        (&|s| s.materials[0].base_texture = Some(texture), "image that does not exist"),
        (&|s| s.lights[0].intensity[0] = -1.0, "light 0"),
        (&|s| s.lights[0].kind = LightKind::Directional, "unit vector"),
        (&|s| s.environment = Environment::Map { image: 0, scale: 1.0 }, "environment"),
    ];
    for (change, says) in cases {
        let mut scene = scene();
        scene.name = "scene.gltf".into();
        change(&mut scene);
        let error = Oracle::new(&scene, Without::default()).err().expect("refused").to_string();
        assert!(
            error.contains(says) && error.starts_with("scene.gltf: ") && error.lines().count() == 1,
            "{error}"
        );
    }
}

fn reference() -> Reference {
    let scene = generate(&Recipe { kind: Kind::Cornell, triangles: 1000, seed: 1 }).expect("in range");
    let view =
        View { pose: scene.cameras[0].pose, width: 19, height: 35, samples: 1, depth: 2, min_weight: 0.01 };
    let oracle = Oracle::new(&scene, Without::default()).expect("sound");
    let image = oracle.render(&view, |_| ());
    Reference { key: Key { scene: oracle.content_hash(), without: Without::default(), view }, image }
}

#[test]
fn a_reference_comes_back_as_it_was_rounded() {
    let folder = tempfile::tempdir().expect("a folder");
    let reference = reference();
    let path = Reference::path_in(&folder.path().join("cache"), &reference.key);
    reference.save(&path).expect("it is written");
    let back = Reference::load(&path, &reference.key).expect("it is read");
    assert_eq!(back.key, reference.key);
    assert_eq!(back.image.to_layers(), reference.image.to_layers());
    assert_eq!(back.image, OracleImage::from_layers(19, 35, &reference.image.to_layers()).expect("whole"));
    let names: Vec<_> = fs::read_dir(folder.path().join("cache")).expect("a folder").collect();
    assert_eq!(names.len(), 1, "nothing else is left");
    assert!(OracleImage::from_layers(19, 34, &reference.image.to_layers()).is_err());
}

#[test]
fn a_reference_of_something_else_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let reference = reference();
    let path = Reference::path_in(folder.path(), &reference.key);
    reference.save(&path).expect("it is written");
    let changes: [Change<Key>; 11] = [
        (&|key| key.scene[31] ^= 1, "scene"),
        (&|key| key.without.shadows = true, "shadows"),
        (&|key| key.without.textures = true, "textures"),
        (&|key| key.without.refraction = true, "refraction"),
        (&|key| key.view.width = 20, "width 19, and 20"),
        (&|key| key.view.samples = 2, "samples 1, and 2"),
        (&|key| key.view.depth = 3, "depth 2, and 3"),
        (&|key| key.view.min_weight = 0.02, "least weight"),
        (&|key| key.view.pose.eye.x = key.view.pose.eye.x.next_up(), "eye"),
        (&|key| key.view.pose.up.z = -0.0, "up"),
        (&|key| key.view.pose.fov_degrees += 1e-9, "field of view"),
    ];
    for (change, says) in changes {
        let mut key = reference.key;
        change(&mut key);
        assert_ne!(Reference::path_in(folder.path(), &key), path, "{says}");
        let error = Reference::load(&path, &key).expect_err("refused").to_string();
        assert!(
            error.contains(says) && error.contains("render one") && error.lines().count() == 1,
            "{says}: {error}"
        );
    }
}

#[test]
fn a_damaged_reference_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let reference = reference();
    let path = folder.path().join("a.exr");
    let refused = |says: &str| {
        let error = Reference::load(&path, &reference.key).expect_err("refused").to_string();
        assert!(error.contains(says) && error.lines().count() == 1, "{says}: {error}");
    };
    refused("there is no such file");
    reference.save(&path).expect("it is written");
    let whole = fs::read(&path).expect("a file");
    for length in [0, 10, 200, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).expect("written");
        refused("is not a readable EXR file");
    }
    for length in [1 << 19, 2 << 20] {
        let mut long = whole.clone();
        long.resize(whole.len() + length, 7);
        fs::write(&path, &long).expect("written");
        match length {
            // Bytes behind the last row are nobody's.
            0x8_0000 => assert!(Reference::load(&path, &reference.key).is_ok()),
            _ => refused("is longer than"),
        }
    }
    fs::write(&path, "hello").expect("written");
    refused("is not a readable EXR file");

    // A colour that is none, and another size under the same key.
    let mut broken = reference.clone();
    broken.image.color[21][1] = f64::NAN;
    broken.save(&path).expect("it is written");
    refused("value of G at column 2, row 1");
    let layers = reference.image.to_layers();
    broken.image = OracleImage::from_layers(35, 19, &layers).expect("as many");
    broken.save(&path).expect("it is written");
    refused("35 x 19 pixels instead of 19 x 35");

    // A picture that says nothing of itself; a folder.
    fs::remove_file(&path).expect("removed");
    exr::prelude::write_rgb_file(&path, 19, 35, |_, _| (0.5f32, 0.5f32, 0.5f32)).expect("written");
    refused("is no reference of the oracle");
    fs::remove_file(&path).expect("removed");
    fs::create_dir(&path).expect("a folder");
    refused("is no plain file");
}

/// The version, and the picture of [`gallery`] that it stands for.
const PICTURE_OF_VERSION: (u32, &str) =
    (1, "c18ac67a27325caaf83b82e0e7768eb434248756f799e13c483611ecd7cd9079");

/// A bit of everything that the oracle computes: texture, highlight, mirror, glass, pane, veil, hole, back, lights of every kind, surroundings.
fn gallery() -> Scene {
    let texels: Vec<u8> = (0..64u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let texture = TextureRef { image: 0, wrap_s: Wrap::Repeat, wrap_t: Wrap::Mirror, nearest: false };
    let (x, y) = ([1.5, 0.0, 0.0], [0.0, 1.5, 0.0]);
    let veil = Material { alpha: AlphaMode::Blend, base_color: [0.2, 0.5, 0.9, 0.4], ..chalk() };
    let holes = Material { alpha: AlphaMode::Mask(0.5), base_texture: Some(texture), ..chalk() };
    let metal = Material { roughness: 0.2, base_color: [0.9, 0.7, 0.3, 1.0], ..mirror(0.8) };
    let rough = Material { base_texture: Some(texture), roughness: 0.4, ..Material::default() };
    let pane = Material { thin_walled: true, roughness: 0.2, ..glass(1.4) };
    let mut stage = Stage::default()
        .quad([-6.0; 3], [12.0, 0.0, 0.0], [0.0, 12.0, 0.0], rough)
        .quad([-3.0, -2.0, -4.0], [4.0, 0.0, 1.0], [0.0, 4.0, 0.5], metal)
        .quad([-2.0, -1.0, 0.0], x, y, glass(1.5))
        .quad([-2.0, -1.0, -0.5], y, x, glass(1.5))
        .quad([0.0, -1.0, 0.2], x, y, pane)
        .quad([0.5, -0.5, -1.0], x, y, veil)
        .quad([-0.5, 0.2, -2.0], x, y, holes)
        .quad([-1.0, 0.5, 1.0], y, x, Material { double_sided: false, ..glow(0.5) })
        .lamp(LightKind::Point, [1.0, 2.0, 3.0], [0.0, 0.0, -1.0], 20.0)
        .lamp(LightKind::Directional, [0.0; 3], [-0.36, -0.48, -0.8], 1.0)
        .sky(0.25);
    stage.0.ambient = [0.1, 0.2, 0.3];
    stage.0.images.push(Image { name: String::new(), width: 4, height: 4, rgba: texels.into() });
    stage.0
}

/// Stored references are refused by the version alone: one that has not been raised lets those of another arithmetic pass.
#[test]
fn a_changed_picture_has_another_version() {
    let pose = CameraPose {
        eye: DVec3::new(0.4, 0.3, 5.0),
        target: DVec3::new(0.0, 0.1, -1.0),
        up: DVec3::Y,
        fov_degrees: 40.0,
    };
    let view = View { pose, width: 24, height: 16, samples: 2, depth: 6, min_weight: 1.0 / 1024.0 };
    view.check().expect("a usable view");
    let image = Oracle::new(&gallery(), Without::default()).expect("sound").render(&view, |_| ());
    let found = blake3::hash(&image.to_layers()).to_hex();
    assert_eq!(
        (VERSION, found.as_str()),
        PICTURE_OF_VERSION,
        "the oracle's picture is another one, or its version: raise tessera_oracle::VERSION by one with every change of a picture, \
         and write both down in PICTURE_OF_VERSION"
    );
}
