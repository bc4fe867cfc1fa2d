//! Constants of the text that Rust has too.

use super::eval::{Machine, Value};
use super::{keys, parse, whole};
use crate::backend::gpu::kernel::{GROUP_SIDE, KernelKey, TraversalForm};
use crate::backend::gpu::probe::{PATH_ENDED, PROBE_WORDS};
use crate::backend::gpu::slot::CUT_LOOPS;
use crate::backend::gpu::wavefront::GROUPS_ACROSS;
use naga::{ArraySize, TypeInner};
use std::collections::BTreeMap;
use tessera_geometry::{LocalCamera, Vec3, wgsl as geometry};
use tessera_kdtree::{node, wgsl as kdtree};
use tessera_pack::{EnvironmentKind, LightKind, Material, MaterialFlags, NO_TEXTURE, Wrap};
use tessera_quantize::normal;
use tessera_whitted::twins::{constants as whitted, frame_word};
use tessera_whitted::{Features, FrameParams, PixelFormat, Probe, Sampler, Sampling};

/// Constants that Rust has not, and why.
const WGSL_ONLY: [(&str, &str); 23] = [
    ("SHORT", "a choice of the short stack, which the CPU has not; any gives the same answers"),
    ("LEAST_STEEPNESS", "of the distance without f64, which the CPU has not"),
    ("SQUARE_OVERFLOWS", "the CPU lets infinities come and go"),
    ("SQUARE_UNDERFLOWS", "the CPU lets infinities come and go"),
    ("EXP2_HIGH", "libm has it in f64; held to its meaning below"),
    ("EXP2_LOW", "libm has it in f64; held to its meaning below"),
    ("ROW_ASKED", "a row of a state, which kernels alone read"),
    ("ROW_HIT", "a row of a state, which kernels alone read"),
    ("ROW_AT_HAND", "a row of a state, which kernels alone read"),
    ("ROW_SEEN", "a row of a state, which kernels alone read"),
    ("ROW_SEEN_FIRST", "a row of a state, which kernels alone read"),
    ("ROW_SUM", "a row of a state, which kernels alone read"),
    ("ROW_COUNTS", "a row of a state, which kernels alone read"),
    ("ROW_VIEW", "a row of a state, which kernels alone read"),
    ("ROW_WAITING", "a row of a state, which kernels alone read"),
    ("ROW_LIGHT", "a row of a state, which kernels alone read"),
    ("CENTRE", "not a number of a sample; the CPU looks for the surface by a function of its own"),
    ("NO_SAMPLE", "not a number of a sample; a loop ends on the CPU"),
    ("PATH_NEW", "how far a probed path is, for the kernel alone"),
    ("PATH_UNDER_WAY", "how far a probed path is, for the kernel alone"),
    ("BARE", "a kind of query; a closure on the CPU"),
    ("CODING_SRGB", "an enum without numbers on the CPU"),
    ("CODING_LINEAR", "an enum without numbers on the CPU"),
];

/// Every constant that both have, and the bits that it must have.
fn twins(f64: bool) -> BTreeMap<&'static str, u32> {
    let feature = |shadows, reflection, refraction| {
        frame_word(&frame(Features { shadows, reflection, refraction }, PixelFormat::Rgba8), "features")
    };
    let format = |format| frame_word(&frame(Features::default(), format), "format");
    let sampler = |sampler| {
        let sampling = Sampling { sampler, ..Sampling::default() };
        frame_word(&FrameParams { sampling, ..frame(Features::default(), PixelFormat::Rgba8) }, "sampler")
    };
    let mut twins = BTreeMap::from([
        ("NORMAL_ENTRIES", normal::ENTRIES as u32),
        ("MATERIAL_WORDS", size_of::<Material>() as u32 / 4),
        ("DOUBLE_SIDED", MaterialFlags::DOUBLE_SIDED),
        ("UNLIT", MaterialFlags::UNLIT),
        ("ALPHA_MASK", MaterialFlags::ALPHA_MASK),
        ("ALPHA_BLEND", MaterialFlags::ALPHA_BLEND),
        ("THIN_WALLED", MaterialFlags::THIN_WALLED),
        ("NO_TEXTURE", NO_TEXTURE),
        ("LIGHT_POINT", LightKind::Point as u32),
        ("LIGHT_DIRECTIONAL", LightKind::Directional as u32),
        ("LIGHT_SPOT", LightKind::Spot as u32),
        ("ENVIRONMENT_NONE", EnvironmentKind::None as u32),
        ("ENVIRONMENT_GRADIENT", EnvironmentKind::Gradient as u32),
        ("ENVIRONMENT_MAP", EnvironmentKind::Map as u32),
        ("WRAP_REPEAT", Wrap::Repeat as u32),
        ("WRAP_MIRROR", Wrap::Mirror as u32),
        ("WRAP_CLAMP", Wrap::Clamp as u32),
        ("FEATURE_SHADOWS", feature(true, false, false).expect("a word")),
        ("FEATURE_REFLECTION", feature(false, true, false).expect("a word")),
        ("FEATURE_REFRACTION", feature(false, false, true).expect("a word")),
        ("SAMPLER_JITTERED", sampler(Sampler::Jittered).expect("a word")),
        ("SAMPLER_LOW_DISCREPANCY", sampler(Sampler::LowDiscrepancy).expect("a word")),
        ("FORMAT_RGBA8", format(PixelFormat::Rgba8).expect("a word")),
        ("FORMAT_RGBA16", format(PixelFormat::Rgba16).expect("a word")),
        ("FORMAT_LAYERS", format(PixelFormat::Layers).expect("a word")),
        ("GROUP_SIDE", GROUP_SIDE),
        ("PROBE_WORDS", PROBE_WORDS as u32),
        ("PATH_ENDED", PATH_ENDED),
        ("CUT_LOOPS", CUT_LOOPS as u32),
        ("GROUPS_ACROSS", GROUPS_ACROSS),
        ("LOOK", Probe::LOOK),
        ("OPAQUE", Probe::OPAQUE),
        ("LAYER", Probe::LAYER),
    ]);
    for (name, bits) in geometry::CONSTANTS.into_iter().chain(kdtree::constants(f64)).chain(whitted()) {
        assert_eq!(twins.insert(name, bits), None, "{name} is in two tables");
    }
    twins
}

pub(super) fn frame(features: Features, format: PixelFormat) -> FrameParams {
    let camera = LocalCamera { origin: Vec3::ZERO, forward: Vec3::Z, right: Vec3::X, up: Vec3::Y };
    let sampling = Sampling::default();
    FrameParams {
        camera,
        width: 1,
        height: 1,
        samples: 1,
        sampling,
        max_depth: 1,
        frame: 0,
        features,
        format,
    }
}

/// The constants of a kernel's text.
fn constants(key: &KernelKey) -> BTreeMap<String, Value> {
    let module = parse(key);
    let machine = Machine { module: &module, word: &|at| at, scene: &|_| 0 };
    let of = |constant: &naga::Constant| {
        let name = constant.name.clone()?;
        Some((name, machine.constant(&module.global_expressions[constant.init])))
    };
    module.constants.iter().filter_map(|(_, constant)| of(constant)).collect()
}

#[test]
fn constants_are_those_of_rust_or_explained() {
    let mut unused: Vec<_> = WGSL_ONLY.iter().map(|(name, _)| *name).collect();
    for f64 in [false, true] {
        for form in [TraversalForm::PrivateStack, TraversalForm::ShortStack] {
            let key = KernelKey { f64, form, ..whole() };
            let mut twins = twins(f64);
            let of_variant = key.variant.constants(key.depth);
            for (name, value) in constants(&key) {
                if let Some(bits) = twins.remove(name.as_str()) {
                    assert_eq!(value.words(), [bits], "{name} is {value:?}");
                } else if WGSL_ONLY.iter().any(|(only, _)| *only == name) {
                    unused.retain(|only| *only != name);
                } else {
                    let is_of_variant = of_variant.contains(&format!("const {name}:"));
                    assert!(is_of_variant, "{name} stands in no table: add it to its twin or to WGSL_ONLY");
                }
            }
            assert!(twins.is_empty(), "the text has no constants {twins:?}");
        }
    }
    assert!(unused.is_empty(), "WGSL_ONLY explains what is not there: {unused:?}");
}

#[test]
fn the_constants_of_a_variant_are_its_fields() {
    for key in keys().into_iter().filter(|key| !key.f64 && key.form == TraversalForm::PrivateStack) {
        let constants = constants(&key);
        let word = |name: &str| constants[name].words()[0];
        let flag = |name: &str| word(name) == 1;
        let v = key.variant;
        assert_eq!(
            ["PLAIN_POSITIONS", "WIDE_CELLS", "PLAIN_NORMALS", "PLAIN_UVS", "HAS_SIDE_UVS"].map(flag),
            [
                v.layout.plain_positions,
                v.layout.wide_cells,
                v.layout.plain_normals,
                v.layout.plain_uvs,
                v.layout.has_side_uvs
            ]
        );
        let names = ["REFS", "NORMALS", "UVS", "COLORS"].map(|part| flag(&format!("HAS_{part}")));
        assert_eq!(names, [v.refs, v.normals, v.textures, v.colors]);
        let names = ["HAS_HOLES", "HIDES_BACKS", "SEES_THROUGH", "HAS_MIRRORS", "HAS_GLASS", "ONE_MATERIAL"];
        let fields = [v.holes, v.hidden_backs, v.see_through, v.mirrors, v.glass, !v.materials];
        assert_eq!(names.map(flag), fields);
        assert_eq!(word("RECORD_WORDS"), v.layout.record_words);
        assert_eq!(word("PATH_STACK"), v.path_stack(key.depth));
    }
}

/// The private stack has room for the deepest tree, and the trail of the other a bit for each of its levels.
#[test]
fn stacks_are_as_deep_as_trees() {
    let module = parse(&whole());
    let mut arrays = 0;
    for (_, variable) in module.global_variables.iter() {
        if variable.name.as_deref().is_some_and(|name| name.starts_with("waiting_") && name.len() == 10) {
            let TypeInner::Array { size: ArraySize::Constant(size), .. } = module.types[variable.ty].inner
            else {
                panic!("{:?} is no array", variable.name);
            };
            assert_eq!(size.get(), node::MAX_DEPTH, "{:?}", variable.name);
            arrays += 1;
        }
    }
    assert_eq!((arrays, node::MAX_DEPTH), (3, 64));
    // A path's depth has eight bits beside the layers that it has passed.
    const { assert!(FrameParams::MAX_DEPTH < 256) };
}

/// `EXP2_HIGH[i] + EXP2_LOW[i]` is 2^((i - 8) / 16): its sixteenth power is a power of two.
#[test]
fn the_table_of_powers_is_right_to_48_bits() {
    let constants = constants(&whole());
    let table = |name: &str| constants[name].words().into_iter().map(f32::from_bits).collect::<Vec<_>>();
    let (high, low) = (table("EXP2_HIGH"), table("EXP2_LOW"));
    assert_eq!((high.len(), low.len()), (16, 16));
    for (i, (&high, &low)) in high.iter().zip(&low).enumerate() {
        assert!(low.abs() <= (high.next_up() - high) * 0.5, "entry {i}: {low} is more than rounding lost");
        let power = libm::pow(f64::from(high) + f64::from(low), 16.0);
        let expected = libm::exp2(i as f64 - 8.0);
        assert!(
            (power / expected - 1.0).abs() < 16.0 * libm::exp2(-47.0),
            "entry {i}: {power} for {expected}"
        );
    }
}
