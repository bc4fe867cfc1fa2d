//! Surfaces without a back.

use crate::support::*;
use std::f32::consts::PI;
use tessera_geometry::Hit;
use tessera_pack::{Material, MaterialFlags};
use tessera_whitted::PixelFormat;

const GLOW: [f32; 3] = [0.25, 0.5, 1.0];

/// Adds a level card of half width 1 in the height `y`, with its front up.
fn add_card(stage: &mut Stage, y: f64, material: Material) {
    stage.quad([-1.0, y, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], material);
}

#[test]
fn a_one_sided_card_is_there_from_its_front_alone() {
    let mut stage = Stage::default();
    add_card(&mut stage, 0.0, one_sided(unlit(GLOW)));
    let pack = stage.pack();
    let miss =
        Layers { color: [0.0; 3], alpha: 0.0, depth: f32::INFINITY, normal: [0.0; 3], id: Hit::NO_TRIANGLE };
    for samples in [1, 4] {
        let from = |y: f64| {
            let mut view = View { samples, ..look([0.3, y, 0.2], [0.3, 0.0, 0.2]) };
            view.pose.fov_degrees = 0.01;
            view
        };
        let front = from(2.0).pixel(&pack);
        assert_eq!((front.color, front.alpha, front.depth), (GLOW, 1.0, 2.0));
        assert_eq!(from(-2.0).pixel(&pack), miss, "{samples} samples");
        assert_eq!(from(-2.0).bytes(&pack, PixelFormat::Rgba8).0, [0; 4]);
    }
}

#[test]
fn what_lies_behind_a_hidden_back_is_seen_through_all_layers() {
    // From below: a veil of one half, two hidden backs (one of them in the veil's own plane), a glow.
    let veil = Material {
        base_color: [0.0, 0.0, 0.0, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    let mut stage = Stage::default();
    add_card(&mut stage, 0.0, one_sided(chalk()));
    add_card(&mut stage, 0.0, veil);
    add_card(&mut stage, 1.0, one_sided(chalk()));
    add_card(&mut stage, 2.0, unlit([1.0; 3]));
    let pixel = look([0.3, -2.0, 0.2], [0.3, 0.0, 0.2]).pixel(&stage.pack());
    assert_eq!((pixel.color, pixel.alpha, pixel.depth), ([0.5; 3], 1.0, 2.0));
}

#[test]
fn a_one_sided_card_casts_its_shadow_to_both_sides() {
    for (height, down) in [(1.0, -1.0), (-1.0, 1.0)] {
        // A double-sided sheet in the middle, lit through the card's front or its back.
        let mut stage = Stage::default();
        stage.quad([-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0], chalk());
        add_card(&mut stage, height, one_sided(chalk()));
        stage.light(directional_light([0.0, down, 0.0], PI));
        let pack = stage.pack();
        let at = |x: f64| look([x, 0.1 * height, 3.0], [x, 0.0, 0.2]).pixel(&pack).color;
        assert_color(at(0.3), 0.0, 0.0);
        assert_color(at(3.0), 1.0, 1e-5);
    }
}

#[test]
fn mirrors_and_panes_show_no_backs_either() {
    let pane = Material { flags: MaterialFlags::THIN_WALLED, ..glass(1.0) };
    for (flip, wanted) in [(false, [1.0; 3]), (true, GLOW)] {
        // A mirror in the floor sees the card from below through a pane; so does an eye between the two.
        let mut stage = Stage::default();
        stage.quad([-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0], mirror(1.0));
        let (u, v) = ([0.0, 0.0, 2.0], [2.0, 0.0, 0.0]);
        let (u, v) = if flip { (v, u) } else { (u, v) };
        stage.quad([-1.0, 2.0, -1.0], u, v, one_sided(unlit(GLOW)));
        add_card(&mut stage, 1.9, pane);
        stage.surround();
        let pack = stage.pack();
        let mirrored = look([0.1, 2.0, 4.2], [0.1, 0.0, 2.1]).pixel(&pack);
        assert_eq!(mirrored.color.map(|c| (c * 1e4).round() / 1e4), wanted, "in the mirror, flip {flip}");
        let through = look([0.1, 1.0, 0.2], [0.1, 2.0, 0.2]).pixel(&pack);
        assert_eq!(through.color, wanted, "through the pane, flip {flip}");
    }
}

#[test]
fn closed_bodies_look_the_same_without_backs() {
    // Glass keeps the back that a ray meets from within; backs of opaque bodies are never seen from outside.
    let picture = |sided: fn(Material) -> Material| {
        let mut stage = Stage::default();
        stage.ball([0.0, 0.2, 0.0], 1.0, 12, sided(glass(1.5)));
        stage.ball([-0.6, 0.0, -2.5], 1.0, 12, sided(chalk()));
        stage.cuboid([-4.0, -2.0, -4.0], [4.0, -1.0, 4.0], sided(chalk()));
        stage.light(point_light([2.0, 4.0, 3.0], 60.0));
        stage.surround();
        look([0.3, 0.6, 4.0], [0.0; 3]).sized(40, 40).layers(&stage.pack())
    };
    let (pixels, counts) = picture(one_sided);
    assert_eq!((pixels, counts), picture(|material| material));
    assert!(counts.refraction > 0, "the glass is in view");

    // And a one-sided room is seen into.
    let mut room = Stage::default();
    room.cuboid([-1.0; 3], [1.0; 3], one_sided(unlit(GLOW)));
    let outside = look([0.1, 0.2, 4.0], [0.1, 0.2, 0.0]);
    assert_eq!(outside.pixel(&room.clone().pack()).depth, 3.0);
    let inside = look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]);
    assert_eq!(inside.pixel(&room.pack()).alpha, 0.0);
}
