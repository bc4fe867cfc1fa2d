//! A pack holds no section that its scene does not use; what is forced in nevertheless is valid, and is there.

use crate::support::{bare, everything, image};
use tessera_pack::format::Section;
use tessera_pack::{
    Environment, Forced, ImageInput, Material, MaterialFlags, NO_TEXTURE, Pack, PackInput, PackOptions,
    PackStats, Plain, Wrap, build_pack,
};

/// A scene, and how it is packed.
type Case = (PackInput, PackOptions);

/// Of a section: scenes that do not use it, and one that does. None for a section of which every scene with a triangle has a use.
///
/// A new section has no arm here, and the tests do not compile without one.
fn cases(section: Section) -> Option<(Vec<Case>, Case)> {
    let plain = |positions, normals, uvs| PackOptions {
        plain: Plain { positions, normals, uvs },
        ..PackOptions::default()
    };
    let usual = PackOptions::default();
    let all_plain = plain(true, true, true);
    let full = || (everything(8), usual);
    let with = |change: &dyn Fn(&mut PackInput), options| {
        let mut input = everything(8);
        change(&mut input);
        (input, options)
    };
    Some(match section {
        Section::Head
        | Section::Faces
        | Section::MaterialRuns
        | Section::IdRuns
        | Section::Slots
        | Section::Materials => return None,
        Section::Cells => {
            (vec![(everything(8), all_plain), (everything(8), plain(true, false, false))], full())
        }
        Section::Records => {
            (vec![(everything(8), all_plain), (sheet(), plain(true, false, false))], (sheet(), usual))
        }
        Section::Positions => (vec![full(), (sheet(), usual)], (sheet(), plain(true, false, false))),
        Section::Normals => {
            let unlit = |input: &mut PackInput| {
                input.materials.iter_mut().for_each(|m| m.flags |= MaterialFlags::UNLIT);
            };
            let no_direction = |input: &mut PackInput| input.normals.fill([0.0; 3]);
            let none = |input: &mut PackInput| input.normals.clear();
            let without =
                vec![full(), with(&unlit, all_plain), with(&no_direction, all_plain), with(&none, all_plain)];
            (without, (everything(8), all_plain))
        }
        Section::Uvs => {
            let no_texture = |input: &mut PackInput| input.materials.fill(Material::default());
            let none = |input: &mut PackInput| input.uvs.clear();
            (vec![full(), with(&no_texture, all_plain), with(&none, all_plain)], (everything(8), all_plain))
        }
        Section::SideUvs => {
            let narrow = |input: &mut PackInput| input.uvs.fill([0.25, 0.5]);
            (vec![(sheet(), usual), with(&narrow, usual), (everything(8), all_plain)], full())
        }
        Section::Colors => {
            let white = |input: &mut PackInput| input.colors.fill([255; 4]);
            // No material shows its alpha.
            let clear = |input: &mut PackInput| input.colors.fill([255, 255, 255, 9]);
            (vec![with(&white, usual), with(&clear, usual), (sheet(), usual)], full())
        }
        Section::List => (vec![(triangle(), usual)], full()),
        Section::Textures | Section::Texels => {
            let no_uvs = |input: &mut PackInput| input.uvs.clear();
            let no_use = |input: &mut PackInput| input.materials.fill(Material::default());
            let no_effect = |input: &mut PackInput| {
                input.materials.fill(Material {
                    // They multiply a factor of 0.
                    emissive_texture: 0,
                    transmission_texture: 1,
                    ..Material::default()
                });
            };
            // Its triangles have no area.
            let flat = |input: &mut PackInput| {
                input.materials =
                    vec![Material { base_texture: 0, ..Material::default() }, Material::default()];
                input.material_runs = vec![(0, 0), (2, 1)];
                input.triangles[0] = [0, 0, 1];
                input.triangles[1] = [2, 2, 2];
            };
            let without = [&no_uvs as &dyn Fn(&mut PackInput), &no_use, &no_effect, &flat];
            (without.map(|change| with(change, usual)).into(), full())
        }
        Section::Lights => {
            let none = |input: &mut PackInput| input.lights.clear();
            let dark = |input: &mut PackInput| input.lights.iter_mut().for_each(|l| l.intensity = [0.0; 3]);
            let unlit = |input: &mut PackInput| {
                input.materials.iter_mut().for_each(|m| m.flags |= MaterialFlags::UNLIT);
            };
            let without = [&none as &dyn Fn(&mut PackInput), &dark, &unlit];
            (without.map(|change| with(change, usual)).into(), full())
        }
        Section::Environment => {
            (vec![with(&|input| input.environment = Environment::default(), usual)], full())
        }
        Section::Cameras => (vec![with(&|input| input.cameras.clear(), usual)], full()),
    })
}

fn triangle() -> PackInput {
    bare(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]], vec![[0, 1, 2]])
}

/// Two triangles, and nothing that is optional.
fn sheet() -> PackInput {
    let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [1.0, 1.0, 0.0]];
    bare(corners, vec![[0, 1, 2], [2, 1, 3]])
}

fn build((input, options): Case) -> (Pack, PackStats) {
    let (pack, stats) = build_pack(input, &options).expect("a sound scene");
    assert!(pack.triangle_count() > 0);
    assert_eq!(Pack::from_bytes(pack.bytes()).map(|again| again.id()), Ok(pack.id()));
    (pack, stats)
}

#[test]
fn a_pack_holds_a_section_exactly_when_its_scene_uses_it() {
    for &section in Section::ALL {
        let name = section.name();
        let Some((without, with)) = cases(section) else {
            assert!(build((triangle(), PackOptions::default())).0.section_bytes(section) > 0, "{name}");
            continue;
        };
        for (number, case) in without.into_iter().enumerate() {
            assert_eq!(build(case).0.section_bytes(section), 0, "{name}, scene {number} does not use it");
        }
        assert!(build(with).0.section_bytes(section) > 0, "{name} is used");
    }
}

#[test]
fn what_is_left_out_has_one_reason() {
    let (_, stats) = build((sheet(), PackOptions::default()));
    let mut names: Vec<_> = stats.left_out.iter().map(|line| line.0).collect();
    names.sort_unstable();
    assert_eq!(names, ["color", "environ", "light", "normal", "texture", "uv"]);
}

/// Whether `pack` has what `forced` puts in.
fn has(pack: &Pack, forced: Forced) -> bool {
    let has = |section| pack.section_bytes(section) > 0;
    match forced {
        Forced::Normals => pack.mesh().has_normals(),
        Forced::Uvs => pack.mesh().has_uvs(),
        Forced::SideUvs => pack.side_uv_count() == pack.vertex_count(),
        Forced::Colors => pack.mesh().has_colors(),
        Forced::Textures => {
            pack.mesh().has_uvs() && pack.materials().iter().all(|m| m.base_texture != NO_TEXTURE)
        }
        Forced::Materials => pack.material_run_count() == 2,
        Forced::IdRuns => pack.id_run_count() == pack.triangle_count(),
        Forced::Lights => has(Section::Lights),
        Forced::Environment => has(Section::Environment),
        Forced::Cameras => has(Section::Cameras),
        Forced::Unused => pack.materials().len() == 2 && has(Section::Textures),
    }
}

#[test]
fn what_is_forced_in_is_there_and_sound() {
    let mut input = sheet();
    input.materials.push(Material::default());
    input.textures = vec![image(2, 2, Wrap::Repeat, Wrap::Repeat)];
    let forms = [
        Plain::default(),
        Plain { positions: true, ..Plain::default() },
        Plain { positions: true, normals: true, uvs: true },
    ];
    for plain in forms {
        let options = PackOptions { plain, ..PackOptions::default() };
        let (lean, _) = build((input.clone(), options));
        for forced in Forced::ALL {
            let (full, _) = build((input.clone(), PackOptions { forced: Some(forced), ..options }));
            // Plain texture coordinates have no side table.
            let is_possible = !(forced == Forced::SideUvs && plain.uvs);
            assert!(!has(&lean, forced), "{}", forced.name());
            assert_eq!(has(&full, forced), is_possible, "{}, {plain:?}", forced.name());
            let decoded = |pack: &Pack| -> Vec<_> {
                let mesh = pack.mesh();
                (0..pack.vertex_count()).map(|v| (mesh.position(v), mesh.normal(v), mesh.color(v))).collect()
            };
            assert_eq!(decoded(&full), decoded(&lean), "{}", forced.name());
        }
    }
}

#[test]
fn what_is_needed_cannot_be_forced() {
    let (pack, _) = build((everything(8), PackOptions::default()));
    for forced in Forced::ALL {
        let options = PackOptions { forced: Some(forced), ..PackOptions::default() };
        let is_same = build((everything(8), options)).0.id() == pack.id();
        // A list of all ids always says more than runs.
        assert_eq!(is_same, forced != Forced::IdRuns, "{}", forced.name());
    }
}

#[test]
fn coordinates_in_the_side_table_decode_to_the_same_bits() {
    let mut input = everything(8);
    for uv in &mut input.uvs {
        *uv = uv.map(|x| x.rem_euclid(1.0) * 0.9);
    }
    let (lean, _) = build((input.clone(), PackOptions::default()));
    let options = PackOptions { forced: Some(Forced::SideUvs), ..PackOptions::default() };
    let (full, _) = build((input, options));
    assert_eq!((lean.side_uv_count(), full.side_uv_count()), (0, full.vertex_count()));
    assert_eq!(lean.vertex_count(), full.vertex_count());
    for vertex in 0..lean.vertex_count() {
        assert_eq!(lean.mesh().uv(vertex), full.mesh().uv(vertex));
    }
}

#[test]
fn masks_and_blending_go_where_everything_is_opaque() {
    let opaque =
        ImageInput { rgba: [7, 8, 9, 255].repeat(4).into(), ..image(2, 2, Wrap::Repeat, Wrap::Repeat) };
    let holed = ImageInput { rgba: [7, 8, 9, 254].repeat(4).into(), ..opaque.clone() };
    let [mask, blend] = [MaterialFlags::ALPHA_MASK, MaterialFlags::ALPHA_BLEND];
    let flags_of = |texture: &ImageInput, flags, alpha, alpha_cutoff, color: [u8; 4]| {
        let mut input = triangle();
        input.uvs = vec![[0.5; 2]; 3];
        input.colors = vec![color; 3];
        input.textures = vec![texture.clone()];
        let base_color = [1.0, 1.0, 1.0, alpha];
        input.materials =
            vec![Material { base_color, alpha_cutoff, base_texture: 0, flags, ..Material::default() }];
        build((input, PackOptions::default())).0.materials()[0].flags
    };
    let white = [255; 4];
    assert_eq!(flags_of(&opaque, mask, 1.0, 0.5, white), 0);
    assert_eq!(flags_of(&opaque, mask, 0.5, 0.5, white), 0);
    assert_eq!(flags_of(&opaque, mask, 0.25, 0.5, white), mask);
    assert_eq!(flags_of(&opaque, mask, 1.0, 1.5, white), mask);
    assert_eq!(flags_of(&opaque, blend, 1.0, 0.5, white), 0);
    assert_eq!(flags_of(&opaque, blend, 0.75, 0.5, white), blend);
    for flags in [mask, blend] {
        assert_eq!(flags_of(&holed, flags, 1.0, 0.5, white), flags);
        assert_eq!(flags_of(&opaque, flags, 1.0, 0.5, [255, 255, 255, 254]), flags);
    }
}
