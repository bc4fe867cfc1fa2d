//! The kernel that a pack needs: each part is on exactly when the pack has a use for it.

use crate::support::*;
use tessera_pack::{ImageInput, Material, MaterialFlags, Pack, PackOptions, Plain, build_pack};
use tessera_whitted::variant::{Part, Variant};

/// A pack of one triangle and a material, after `change`.
fn pack(change: impl FnOnce(&mut Stage)) -> Pack {
    let mut stage = Stage::default();
    stage.input.textures =
        vec![ImageInput { width: 1, height: 1, rgba: [255; 4].into(), ..Default::default() }];
    change(&mut stage);
    stage.pack()
}

fn sheet(material: Material) -> impl FnOnce(&mut Stage) {
    move |stage| stage.quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], material)
}

/// What `pack` needs is `parts`, and nothing else.
#[track_caller]
fn check(pack: &Pack, parts: &[&str]) {
    let variant = Variant::of(pack);
    let on: Vec<_> = variant.parts().into_iter().filter(|part| part.1).map(|part| part.0).collect();
    assert_eq!(on, parts);
    let all = variant.parts().len();
    assert_eq!(variant.left_out().len(), all - on.len());
    assert!(variant.left_out().iter().all(|part| !on.contains(part)));
    assert_eq!(variant.name(), if on.is_empty() { "bare".into() } else { on.join("+") });
    // The other twin has all that the pack has data for.
    let everything = Variant::everything(pack);
    for (part, is_on) in everything.parts() {
        let is_data = ["normals", "textures", "colors"].contains(&part);
        assert_eq!(is_on, !is_data || on.contains(&part), "{part}");
    }
    assert_eq!(everything.layout, variant.layout);
    for part in Part::ALL {
        let with = variant.with(part);
        let more: Vec<_> = Part::ALL.into_iter().filter(|&p| with.has(p) && !variant.has(p)).collect();
        assert_eq!(more.is_empty(), variant.has(part) || !everything.has(part), "{}", part.name());
        assert!(more.iter().all(|&p| p == part), "{}", part.name());
    }
}

#[test]
fn a_bare_sheet_needs_nothing() {
    check(&pack(sheet(chalk())), &[]);
}

#[test]
fn materials_decide_about_holes_sides_light_mirrors_and_glass() {
    let flags = MaterialFlags::DOUBLE_SIDED;
    let rough = |roughness| Material { roughness, ..chalk() };
    let clear = Material { transmission: 0.5, ..chalk() };
    let half =
        |bit| Material { base_color: [1.0, 1.0, 1.0, 0.5], alpha_cutoff: 0.6, flags: flags | bit, ..chalk() };
    let whole = |bit| Material { flags: flags | bit, ..chalk() };
    let cases: [(Material, &[&str]); 13] = [
        (half(MaterialFlags::ALPHA_MASK), &["holes"]),
        // Opaque everywhere.
        (whole(MaterialFlags::ALPHA_MASK), &[]),
        (whole(MaterialFlags::ALPHA_BLEND), &[]),
        (one_sided(chalk()), &["hidden-backs"]),
        (half(MaterialFlags::ALPHA_BLEND), &["see-through"]),
        (mirror(0.9), &["mirrors"]),
        (rough(0.5), &[]),
        (rough(0.49), &["mirrors"]),
        (clear, &["see-through", "glass"]),
        // Glass keeps its back.
        (one_sided(clear), &["see-through", "glass"]),
        (glass(1.5), &["see-through", "mirrors", "glass"]),
        // Whatever it is made of, it shows its colour alone.
        (Material { flags: flags | MaterialFlags::UNLIT, ..glass(1.5) }, &[]),
        (Material { flags: flags | MaterialFlags::UNLIT, ..mirror(0.5) }, &[]),
    ];
    for (material, parts) in cases {
        check(&pack(sheet(material)), parts);
    }
}

#[test]
fn vertices_decide_about_normals_textures_and_colours() {
    check(&pack(|stage| stage.ball([0.0; 3], 1.0, 4, chalk())), &["normals"]);
    let textured = Material { base_texture: 0, ..chalk() };
    check(&pack(sheet(textured)), &["textures"]);
    // Without texture coordinates there is nothing to look up.
    let no_uvs = |stage: &mut Stage| {
        sheet(textured)(stage);
        stage.input.uvs.clear();
    };
    check(&pack(no_uvs), &[]);
    // A texture can make a rough surface smooth.
    let glossy = Material { metallic_roughness_texture: 0, ..chalk() };
    check(&pack(sheet(glossy)), &["textures", "mirrors"]);
    let colored = |stage: &mut Stage| {
        sheet(chalk())(stage);
        stage.input.colors.fill([255, 0, 0, 255]);
    };
    check(&pack(colored), &["colors"]);
}

#[test]
fn one_material_is_none_to_choose_from() {
    let two = |stage: &mut Stage| {
        sheet(chalk())(stage);
        stage.quad([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], unlit([1.0; 3]));
    };
    check(&pack(two), &["materials"]);
}

#[test]
fn the_tree_decides_about_references() {
    let mut stage = Stage::default();
    // Sheets through many balls: triangles that many nodes would share.
    for i in 0..24 {
        stage.ball([f64::from(i % 5), f64::from(i / 5), 0.3], 0.4, 12, chalk());
    }
    for z in 0..4 {
        stage.quad([-1.0, -1.0, 0.2 * f64::from(z)], [7.0, 0.0, 0.0], [0.0, 7.0, 0.0], chalk());
    }
    for max_refs in [0, 1, 2] {
        let mut options = PackOptions::default();
        options.tree.max_refs = max_refs;
        options.plain = Plain { positions: max_refs == 1, ..Plain::default() };
        let (pack, stats) = build_pack(stage.input.clone(), &options).expect("it packs");
        let has_refs = stats.tree.inner1 + stats.tree.inner2 > 0;
        assert_eq!(has_refs, max_refs > 0, "the scene is made for it: {:?}", stats.tree);
        let variant = Variant::of(&pack);
        assert_eq!(variant.refs, has_refs);
        assert_eq!(variant.layout.plain_positions, max_refs == 1);
    }
}
