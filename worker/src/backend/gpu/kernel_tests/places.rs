//! Where the text reads a pack: it is asked for a record in a row of words each of which holds its own place.

use super::constants::frame;
use super::eval::{Machine, Value};
use super::{parse, whole};
use crate::backend::gpu::kernel::KernelKey;
use naga::Module;
use std::mem::offset_of;
use tessera_kdtree::node::Node;
use tessera_pack::{Light, Material, SideUv, Texture};
use tessera_quantize::Record;
use tessera_quantize::oct::oct_point;
use tessera_whitted::PixelFormat;
use tessera_whitted::device::{encode_rgba16, words_per_pixel};
use tessera_whitted::sample::low_discrepancy;
use tessera_whitted::twins::{frame_word, layouts};

/// Where a record's fields lie: name, first word, words.
type Fields = Vec<(&'static str, usize, usize)>;

macro_rules! fields {
    ($record:ident: $($field:ident)*, unread $($unread:ident)*) => {{
        fn words_of<S, T>(_: fn(&S) -> &T) -> usize {
            size_of::<T>() / 4
        }
        // None is forgotten.
        let _ = |$record { $($field: _,)* $($unread: _,)* }: $record| ();
        let fields: Fields = vec![$((
            stringify!($field),
            offset_of!($record, $field) / 4,
            words_of(|record: &$record| &record.$field),
        )),*];
        fields
    }};
}

/// A place in the row for each section, far from the others: that of its member in `SceneInfo`.
fn place(member: &str) -> u32 {
    let [_, scene, ..] = layouts();
    let (_, offset, _) = scene.members.into_iter().find(|(name, ..)| *name == member).unwrap_or_default();
    (offset as u32 / 4) << 20
}

fn machine(module: &Module) -> Machine<'_> {
    Machine { module, word: &|at| at, scene: &place }
}

/// Holds the function that reads record `i` of a section to the record in Rust.
fn check(function: &str, section: &str, record_bytes: usize, fields: &Fields) {
    let module = parse(&whole());
    let structs = super::structs(&module);
    let name = function.trim_end_matches("_at");
    let (_, members, _) =
        structs.into_iter().find(|(twin, ..)| twin.eq_ignore_ascii_case(name)).expect("a twin");
    let members: Vec<_> = members.iter().map(|member| member.name.as_deref().unwrap_or("")).collect();
    assert_eq!(members, fields.iter().map(|field| field.0).collect::<Vec<_>>(), "members for {function}");
    for i in [0, 3] {
        let Value::Many(values) = machine(&module).call(function, vec![Value::U(i)]) else {
            panic!("{function} answers no struct");
        };
        for (value, (name, first, words)) in values.iter().zip(fields) {
            let first = place(section) + i * record_bytes as u32 / 4 + *first as u32;
            let expected: Vec<_> = (first..first + *words as u32).collect();
            assert_eq!(value.words(), expected, "{function}({i}).{name}");
        }
    }
}

#[test]
fn records_are_read_where_rust_has_written_them() {
    let material = fields!(Material:
        base_color specular metallic emissive roughness transmission ior alpha_cutoff flags
        base_texture metallic_roughness_texture emissive_texture transmission_texture, unread);
    check("material_at", "at_materials", size_of::<Material>(), &material);
    let texture = fields!(Texture: first_texel width height sampling, unread);
    check("texture_at", "at_textures", size_of::<Texture>(), &texture);
    let light = fields!(Light:
        position kind direction range intensity cos_inner cos_outer, unread reserved);
    check("light_at", "at_lights", size_of::<Light>(), &light);

    let module = parse(&whole());
    let ask = |function: &str, i: u32| machine(&module).call(function, vec![Value::U(i)]).words();
    let in_material =
        |field: usize| vec![place("at_materials") + (2 * size_of::<Material>() + field) as u32 / 4];
    assert_eq!(ask("material_flags_at", 2), in_material(offset_of!(Material, flags)));
    assert_eq!(ask("material_transmission_at", 2), in_material(offset_of!(Material, transmission)));
    let from = |section: &str, first: u32, words: u32| {
        (place(section) + first..place(section) + first + words).collect::<Vec<_>>()
    };
    assert_eq!(ask("mesh_indices", 7), from("at_faces", 21, 3));
    assert_eq!(ask("list_at", 7), from("at_list", 7, 1));
    assert_eq!(ask("texel_word", 7), from("at_texels", 7, 1));
    assert_eq!(ask("srgb_linear", 7), from("at_srgb", 7, 1));
    assert_eq!(ask("srgb_threshold", 7), from("at_thresholds", 7, 1));
    assert_eq!(ask("mesh_position", 7), from("at_positions", 21, 3));
    assert_eq!(ask("mesh_normal", 7), from("at_normals", 21, 3));
    assert_eq!(ask("mesh_uv", 7), from("at_uvs", 14, 2));
}

/// Texture coordinates of the last of two vertices in the side table.
#[test]
fn the_side_table_is_read_where_rust_has_written_it() {
    let mut key = whole();
    key.variant.layout.plain_uvs = false;
    let module = parse(&key);
    // The bit that sends a vertex to the table is set in every word, and this vertex comes after all.
    let vertex = u32::MAX;
    let count = |member: &str| if member == "side_uv_count" { 2 } else { place(member) };
    let machine = Machine { module: &module, word: &|at| at | 1 << 30, scene: &count };
    let found = machine.call("mesh_uv", vec![Value::U(vertex)]).words();
    let first = place("at_side_uvs") + (size_of::<SideUv>() + offset_of!(SideUv, uv)) as u32 / 4;
    assert_eq!(found, [first | 1 << 30, (first + 1) | 1 << 30]);
    assert_eq!(offset_of!(SideUv, vertex), 0);
}

/// Words whose bits all take part somewhere.
const WORDS: [u32; 7] = [0, u32::MAX, 0x3FF0_0801, 0x1234_0005, 0xA000_4000, 0x5555_5555, 0xDEAD_BEEF];

#[test]
fn bits_of_nodes_and_vertices_are_those_of_rust() {
    let module = parse(&whole());
    let ask = |function: &str, argument: Value| machine(&module).call(function, vec![argument]).words();
    for (a, b) in WORDS.into_iter().flat_map(|a| WORDS.map(|b| (a, b))) {
        let node = Node([a, b]);
        let of = |function: &str| ask(function, Value::pair([a, b]))[0];
        assert_eq!(of("node_is_leaf"), u32::from(node.is_leaf()));
        assert_eq!(of("node_axis"), node.axis() as u32);
        assert_eq!(of("node_split"), node.split().to_bits());
        assert_eq!(of("node_refs"), node.refs());
        assert_eq!(of("node_right"), node.right());
        assert_eq!(of("node_count"), node.count());
        let record = Record([a, b, a]);
        assert_eq!(ask("record_offsets", Value::U(a)), record.offsets());
        assert_eq!(ask("record_cell", Value::U(b)), [u32::from(record.cell())]);
        assert_eq!(ask("record_normal", Value::U(b)), [u32::from(record.normal())]);
        assert_eq!(ask("record_has_side_uv", Value::U(a)), [u32::from(record.has_side_uv())]);
        assert_eq!(ask("record_uv", Value::U(a)), record.uv().map(f32::to_bits));
    }
}

#[test]
fn points_of_the_octahedron_are_those_of_rust() {
    let module = parse(&whole());
    for code in 0..=u16::MAX {
        let point = machine(&module).call("oct_point", vec![Value::U(code.into())]).words();
        assert_eq!(point, oct_point(code).map(i32::cast_unsigned), "{code:#06x}");
    }
}

#[test]
fn low_discrepancy_samples_are_those_of_rust() {
    let module = parse(&whole());
    for (index, seed) in WORDS.into_iter().chain(0..40).flat_map(|index| WORDS.map(|seed| (index, seed))) {
        let at = machine(&module).call("low_discrepancy", vec![Value::U(index), Value::U(seed)]).words();
        assert_eq!(at, low_discrepancy(index, seed), "sample {index:x} of {seed:x}");
    }
}

#[test]
fn pixels_have_the_words_that_rust_makes_room_for() {
    let module = parse(&whole());
    for format in [PixelFormat::Rgba8, PixelFormat::Rgba16, PixelFormat::Layers] {
        let code =
            frame_word(&frame(tessera_whitted::Features::default(), format), "format").expect("a word");
        let words = machine(&module).call("pixel_words", vec![Value::U(code)]).words();
        assert_eq!(words, [words_per_pixel(format)], "{format:?}");
    }
    assert_eq!(encode_rgba16([0.0; 3], 1.0).len(), PixelFormat::Rgba16.bytes_per_pixel());
}

/// What is split over several bindings is found in the right one.
#[test]
fn split_rows_are_read_in_the_right_binding() {
    let text = crate::backend::gpu::kernel::text(&KernelKey { chunks: super::SPLIT, ..whole() });
    for line in [
        "switch i >> 27u {",
        "case 4u: { return words_4[i & 134217727u]; }",
        "default: { return words_0[i & 134217727u]; }",
        "switch i >> 20u {",
        "case 2u: { return slots_2[i & 1048575u]; }",
    ] {
        assert!(text.contains(line), "`{line}` is not in the text");
    }
}
