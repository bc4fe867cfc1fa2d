//! Glass against optics.

use crate::support::{stages::*, *};
use tessera_geometry::{DVec3, Vec3};
use tessera_pack::{Material, MaterialFlags, Pack};
use tessera_whitted::{Features, PixelFormat, RayCounts};

/// Where the ray of a view meets the ruler.
fn read_ruler(view: View, pack: &Pack) -> f64 {
    ruler_at(&view.pixel(pack))
}

#[test]
fn a_plate_shifts_a_ray_sideways() {
    let thickness = 0.4;
    for degrees in [0.0f64, 20.0, 60.0, 70.0] {
        let i = degrees.to_radians();
        let read = |ior: f32| {
            let (stage, view) = plate(thickness, ior, i);
            read_ruler(view, &stage.pack())
        };
        let n = 1.5;
        let shift =
            thickness * libm::sin(i) * (1.0 - libm::cos(i) / (n * n - libm::sin(i) * libm::sin(i)).sqrt());
        // The ruler is met at an angle: a shift across the ray moves its end by 1 / cos i.
        let measured = (read(1.0) - read(1.5)) * libm::cos(i);
        assert!((measured - shift).abs() < 1e-5, "{degrees} degrees: {measured} instead of {shift}");
    }
}

/// Where a ray parallel to the axis at height `h` crosses the plane at distance 1.5 behind the centre of a glass ball
/// of radius 1, in `f64`.
fn through_ball(h: f64) -> f64 {
    let bend = |d: DVec3, n: DVec3, eta: f64| {
        let c = -d.dot(n);
        d * eta + n * (eta * c - (1.0 - eta * eta * (1.0 - c * c)).sqrt())
    };
    let entry = DVec3::new(h, 0.0, (1.0 - h * h).sqrt());
    let inside = bend(DVec3::NEG_Z, entry, 1.0 / 1.5);
    let exit = entry - inside * (2.0 * inside.dot(entry));
    let out = bend(inside, -exit, 1.5);
    exit.x + out.x * (-1.5 - exit.z) / out.z
}

#[test]
fn a_glass_ball_focuses_half_a_radius_behind_itself() {
    // The ruler stands in the paraxial focus, n R / (2 (n - 1)) = 1.5 R from the centre: rays near the axis all meet
    // its middle.
    assert!(through_ball(0.01).abs() < 1e-5, "the formula itself");
    let worst = |rings: u32| {
        let pack = glass_ball(rings).pack();
        [0.02, 0.05, 0.11, 0.17].into_iter().fold(0.0f64, |worst, h| {
            let view = View { max_depth: 2, ..look([h, 0.003, 3.0], [h, 0.003, 0.0]) };
            worst.max((read_ruler(view, &pack) - through_ball(h)).abs())
        })
    };
    // Facets of size s stand off the ball by s^2 / 8: doubling the rings divides the error by about four.
    let (coarse, middle, fine) = (worst(25), worst(50), worst(100));
    assert!(middle < coarse / 2.0 && fine < middle / 2.0, "{coarse} {middle} {fine}");
    assert!(fine < 1e-3, "{fine}");
}

#[test]
fn glass_of_index_1_changes_no_bit() {
    let (with, without) = (index_1(true).pack(), index_1(false).pack());
    assert_eq!(with.frame(), without.frame());
    let view = look([0.0, 0.0, 6.0], [0.0; 3]).sized(48, 48);
    let (with, without) = (view.layers(&with).0, view.layers(&without).0);
    assert!(with.iter().zip(&without).any(|(a, b)| a.depth != b.depth), "the glass is in view");
    for (i, (a, b)) in with.iter().zip(&without).enumerate() {
        assert_eq!((a.color, a.alpha), (b.color, b.alpha), "pixel {i}");
    }
    assert!(without.iter().any(|p| p.alpha == 0.0) && without.iter().any(|p| p.alpha == 1.0));
}

#[test]
fn a_camera_inside_glass_looks_out_through_it() {
    let mut stage = Stage::default();
    add_ruler(&mut stage, -3.0);
    stage.cuboid([-1.0; 3], [1.0; 3], glass(1.5));
    // From inside at sin i = 0.3 the ray leaves at sin = 0.45.
    let i = libm::asin(0.3);
    let eye = [-0.2, 0.05, 0.0];
    let target = [eye[0] + libm::sin(i), eye[1], -libm::cos(i)];
    let at_face = eye[0] + libm::tan(i);
    let wanted = at_face + 2.0 * libm::tan(libm::asin(0.45));
    let view = View { max_depth: 1, ..look(eye, target) };
    assert!((read_ruler(view, &stage.pack()) - wanted).abs() < 1e-5);
}

#[test]
fn a_pane_is_seen_straight_through_and_reflects_a_little() {
    let pane = Material { flags: MaterialFlags::THIN_WALLED, base_color: [0.5, 1.0, 1.0, 1.0], ..glass(1.5) };
    let mut stage = Stage::default();
    stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], pane);
    stage.quad([-4.0, -4.0, -1.0], [8.0, 0.0, 0.0], [0.0, 8.0, 0.0], unlit([1.0; 3]));
    stage.quad([-4.0, -4.0, 4.0], [0.0, 8.0, 0.0], [8.0, 0.0, 0.0], unlit([0.5, 0.25, 0.0]));
    let view = look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]);
    let [r, g, b] = view.pixel(&stage.clone().pack()).color;
    // At normal incidence 4 % come back.
    for (value, wanted) in [(r, 0.96 * 0.5 + 0.04 * 0.5), (g, 0.96 + 0.04 * 0.25), (b, 0.96)] {
        assert!((value - wanted).abs() < 1e-5, "{r} {g} {b}");
    }
    // The same from behind; from inside a body of glass it would differ.
    let view = look([0.1, 0.2, -0.5], [0.1, 0.2, 0.0]);
    assert!((view.pixel(&stage.pack()).color[0] - (0.96 * 0.5 * 0.5 + 0.04)).abs() < 1e-5);
}

#[test]
fn a_ray_that_meets_nothing_behind_a_pane_leaves_it_half_covered() {
    let pane = Material { flags: MaterialFlags::THIN_WALLED, ..glass(1.5) };
    let mut stage = Stage::default();
    stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], pane);
    let view = look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]);
    let (bytes, _) = view.bytes(&stage.pack(), PixelFormat::Rgba8);
    assert_eq!(bytes, [0, 0, 0, 10], "4 % of a black reflection, the rest is background");
}

#[test]
fn a_smooth_mirror_never_looks_under_its_own_facets() {
    // A coarse ball with normals that disagree wildly with its facets: every mirror ray must still leave it and see
    // the surroundings.
    let mut stage = Stage::default();
    stage.ball([0.0; 3], 1.0, 6, mirror(1.0));
    for (i, normal) in stage.input.normals.iter_mut().enumerate() {
        let twist = Vec3::new((i % 7) as f32 - 3.0, (i % 5) as f32 - 2.0, (i % 3) as f32 - 1.0);
        *normal = (Vec3::from(*normal) + twist * 0.4).normalize().to_array();
    }
    stage.surround();
    for pixel in look([0.3, 0.4, 2.6], [0.0; 3]).sized(64, 64).layers(&stage.pack()).0 {
        assert_color(pixel.color, 1.0, 1e-5);
    }
}

/// A wall of radiance 1 seen at normal incidence through what `add` puts before it.
fn before_a_bright_wall(add: impl FnOnce(&mut Stage), features: Features) -> ([f32; 3], RayCounts) {
    let mut stage = Stage::default();
    add(&mut stage);
    stage.quad([-4.0, -4.0, -3.0], [8.0, 0.0, 0.0], [0.0, 8.0, 0.0], unlit([1.0; 3]));
    let view = View { features, ..look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]) };
    let (pixels, counts) = view.layers(&stage.pack());
    (pixels[0].color, counts)
}

#[test]
fn without_reflection_glass_passes_all_that_can_pass() {
    let features = Features { reflection: false, ..Features::default() };
    let tinted = Material { base_color: [0.5, 1.0, 0.25, 1.0], ..glass(1.5) };
    let ([r, g, b], counts) =
        before_a_bright_wall(|stage| stage.cuboid([-1.0; 3], [1.0; 3], tinted), features);
    // Two surfaces, and nothing is kept back by either: products of powers of two.
    assert_eq!([r, g, b], [0.25, 1.0, 0.0625]);
    assert_eq!((counts.reflection, counts.refraction), (0, 2));
    let pane = Material { flags: MaterialFlags::THIN_WALLED, ..tinted };
    let (color, _) = before_a_bright_wall(
        |stage| stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], pane),
        features,
    );
    assert_eq!(color, [0.5, 1.0, 0.25]);

    // What is totally reflected has nowhere to go: at 45 degrees to the faces, beyond the critical angle.
    let view = View { features, ..look([0.1, 0.0, 0.0], [1.1, 1.0, 0.0]) };
    let (pixels, counts) = view.layers(&glass_cube().pack());
    assert_eq!((pixels[0].color, pixels[0].alpha), ([0.0; 3], 1.0));
    assert_eq!((counts.reflection, counts.refraction), (0, 0));
}

#[test]
fn a_rough_pane_is_the_same_from_both_sides() {
    let pane = |roughness| Material { flags: MaterialFlags::THIN_WALLED, roughness, ..glass(1.5) };
    // The mirror's share at normal incidence is g Fg, with Fg = 4 % and g = (1 - 2 r)^2; 96 % pass.
    for (roughness, gloss) in [(0.0, 1.0), (0.25, 0.25), (0.5, 0.0), (1.0, 0.0)] {
        let seen = |z: f64| {
            let mut stage = Stage::default();
            stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], pane(roughness));
            stage.surround();
            let view = look([0.1, 0.2, z], [0.1, 0.2, 0.0]);
            (view.pixel(&stage.clone().pack()).color, view.layers(&stage.pack()).1.reflection)
        };
        let (front, back) = (seen(2.0), seen(-2.0));
        assert_eq!(front, back, "roughness {roughness}");
        assert_color(front.0, 0.96 + 0.04 * gloss, 1e-6);
        assert_eq!(front.1, u64::from(gloss > 0.0), "roughness {roughness}");
    }

    // From inside a body, what is kept back is mirrored however rough the glass is.
    let mut stage = Stage::default();
    stage.cuboid([-1.0; 3], [1.0; 3], Material { roughness: 1.0, ..glass(1.5) });
    stage.surround();
    let view = View { max_depth: 1, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
    assert_eq!(view.layers(&stage.pack()).1.reflection, 1);
}
