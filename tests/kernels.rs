//! Kernels in two languages are kept together: siblings in one folder, functions of one name, one room that names wgpu.

use crate::support::root;
use crate::tidy::sources;
use std::collections::BTreeSet;
use std::path::Path;

/// Kernels' text without a sibling, and why.
const WITHOUT_SIBLING: [(&str, &str); 10] = [
    ("shared/geometry/src/arithmetic.wgsl", "products that are never fused: plain operators in Rust"),
    ("shared/geometry/src/arithmetic_f32.wgsl", "quotients and roots: plain operators in Rust"),
    ("shared/geometry/src/arithmetic_f64.wgsl", "quotients and roots: plain operators in Rust"),
    ("shared/geometry/src/locate_f32.wgsl", "half of triangle.rs, for devices without f64"),
    ("shared/geometry/src/locate_f64.wgsl", "half of triangle.rs, for devices with f64"),
    ("shared/kdtree/src/stack_private.wgsl", "an `ArrayVec` in traverse.rs"),
    ("shared/kdtree/src/stack_short.wgsl", "its other form; the CPU needs none"),
    ("shared/whitted/src/maths.wgsl", "the crate libm in Rust"),
    ("shared/whitted/src/waiting.wgsl", "the array of a `PathStack`"),
    ("shared/whitted/src/wavefront.wgsl", "an order of rays that the CPU has not"),
];

/// Of each sibling, functions that Rust has not under that name in the file of that name, and why.
const OWN_FUNCTIONS: &[(&str, &str, &[&str])] = &[
    ("shared/geometry/src/camera.wgsl", "`LocalCamera::ray`", &["camera_ray"]),
    ("shared/geometry/src/ray.wgsl", "`f32::is_finite`", &["is_number"]),
    (
        "shared/geometry/src/triangle.wgsl",
        "`RayShear::new`, and `intersect` up to its crossing",
        &["ray_shear", "may_cross"],
    ),
    ("shared/geometry/src/triangle.wgsl", "vectors with an axis that varies: an index in Rust", &["turned"]),
    ("shared/geometry/src/triangle.wgsl", "`edge`, for a compiler that may fuse it", &["ordered_edges"]),
    (
        "shared/kdtree/src/node.wgsl",
        "methods of `Node`; a test compares their bits",
        &["node_is_leaf", "node_axis", "node_split", "node_refs", "node_right", "node_count"],
    ),
    (
        "shared/kdtree/src/traverse.wgsl",
        "`Line::enter` and `TreeView::descend`",
        &["enter_line", "search", "split_cell"],
    ),
    (
        "shared/quantize/src/vertex.wgsl",
        "methods of `Record`; a test compares their bits",
        &["record_offsets", "record_cell", "record_normal", "record_has_side_uv", "record_uv"],
    ),
    ("shared/whitted/src/color.wgsl", "`f32::is_nan`", &["is_nan"]),
    ("shared/whitted/src/device.wgsl", "of `Features` and `f64`", &["has_feature", "world_length"]),
    ("shared/whitted/src/environment.wgsl", "a pattern of `Backdrop`", &["backdrop_is_none"]),
    ("shared/whitted/src/light.wgsl", "a line of `incoming`, without infinities", &["fallen_off"]),
    (
        "shared/whitted/src/path.wgsl",
        "one loop over all kinds of rays, where the CPU has functions that call each other",
        &[
            "push_segment",
            "pop_segment",
            "query_of",
            "begin_path",
            "step_path",
            "view",
            "ask_light",
            "take_share",
            "put_off",
        ],
    ),
    (
        "shared/whitted/src/pixel.wgsl",
        "a work-group and its buffers",
        &[
            "pixel_words",
            "render",
            "at_in_job",
            "even_bits",
            "render_pixel",
            "no_sum",
            "sample_after",
            "sample_ray",
            "add_sample",
            "mean",
            "write_pixel",
            "load_sum",
            "store_sum",
            "add_counts",
            "loops_are_cut",
            "note_cut_loops",
        ],
    ),
    ("shared/whitted/src/sample.wgsl", "`u32::isqrt`", &["whole_root"]),
    (
        "shared/whitted/src/shade.wgsl",
        "`terms`, `pass`, `refract` and `reflect`, which are names of WGSL or of a variable",
        &["terms_of", "pass_glass", "refract_at", "reflect_at"],
    ),
    ("shared/whitted/src/surface.wgsl", "a closure of `offset_origin`", &["away"]),
    (
        "shared/whitted/src/surface.wgsl",
        "in scene.rs",
        &["uv_at", "color_at", "is_solid", "shows_side", "lets_light_through"],
    ),
    ("shared/whitted/src/surface.wgsl", "the closures of path.rs and light.rs", &["accepts"]),
    ("shared/whitted/src/texture.wgsl", "`Sampling::of`", &["sampling_of"]),
    (
        "shared/pack/src/sections.wgsl",
        "a pack in a row of words: view.rs and mesh.rs read slices; tests compare the places and the hits",
        &[
            "float_at",
            "vec3_at",
            "list_at",
            "mesh_indices",
            "mesh_position",
            "corners_of",
            "mesh_normal",
            "mesh_uv",
            "mesh_color",
            "srgb_linear",
            "srgb_threshold",
            "run_of",
            "material_of",
            "original_id",
            "material_at",
            "material_flags_at",
            "material_transmission_at",
            "texture_at",
            "texel_word",
            "light_at",
        ],
    ),
    ("worker/src/backend/gpu/probe.wgsl", "the device's half", &["record", "probe", "trace_rays"]),
];

/// Sources with unsafe code, and why. The workspace denies it; each place says why it may.
const UNSAFE: [(&str, &str); 5] = [
    ("master/src/main.rs", "sets an environment variable before any thread is there"),
    ("shared/wire/tests/hostile.rs", "an allocator that counts"),
    ("worker/src/backend/gpu/adapter.rs", "asks Vulkan for the size of a GPU's memory"),
    ("worker/src/backend/gpu/kernel.rs", "compiles kernels without checks at run time"),
    ("worker/src/cache.rs", "maps a pack of the worker's own cache"),
];

#[test]
fn kernels_stand_beside_their_siblings() {
    let sources = sources();
    let of = |path: &Path| sources.iter().find(|(other, _)| other == path).map(|(_, text)| text.as_str());
    let mut alone = BTreeSet::new();
    let mut own = BTreeSet::new();
    for (path, text) in sources.iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "wgsl")) {
        let name = path.to_string_lossy().into_owned();
        let Some(sibling) = of(&path.with_extension("rs")) else {
            assert!(WITHOUT_SIBLING.iter().any(|(alone, _)| *alone == name), "{name} has no sibling in Rust");
            alone.insert(name);
            continue;
        };
        let functions = |text: &str| -> BTreeSet<String> {
            let after = text.split("fn ").skip(1);
            after.filter_map(|rest| rest.split(['(', '<']).next()).map(str::to_owned).collect()
        };
        let twins = functions(sibling);
        for line in text.lines().filter(|line| line.starts_with("fn ")) {
            let function = functions(line).pop_first().unwrap_or_default();
            let excused =
                OWN_FUNCTIONS.iter().any(|(file, _, own)| *file == name && own.contains(&function.as_str()));
            match twins.contains(&function) {
                true => assert!(!excused, "{name}: {function} is in OWN_FUNCTIONS, and Rust has it too"),
                false => assert!(
                    excused,
                    "{name}: {function} is not in its sibling; a reason goes into OWN_FUNCTIONS"
                ),
            }
            own.insert((name.clone(), function));
        }
    }
    for (name, _) in WITHOUT_SIBLING {
        assert!(alone.contains(name), "{name} is not there, or has a sibling");
    }
    for (name, _, functions) in OWN_FUNCTIONS {
        for function in *functions {
            let is_there = own.contains(&((*name).to_owned(), (*function).to_owned()));
            assert!(is_there, "{name} has no function {function}");
        }
    }
}

#[test]
fn one_room_names_wgpu_and_few_files_are_unsafe() {
    // Spelt apart, or this file would be one of them.
    let names = [concat!("wg", "pu::"), concat!("use wg", "pu")];
    let unsafe_code = concat!("un", "safe").to_owned() + " ";
    let mut unsafe_files = BTreeSet::new();
    for (path, text) in sources().into_iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "rs"))
    {
        let is_room = path.starts_with("worker/src/backend/gpu");
        for name in names {
            assert!(
                is_room || !text.contains(name),
                "{}: only worker/src/backend/gpu names wgpu",
                path.display()
            );
        }
        let code = text.lines().map(|line| line.split("//").next().unwrap_or(""));
        let is_code = |line: &str| {
            line.match_indices(&unsafe_code)
                .any(|(at, word)| line[at + word.len()..].starts_with(['{', 'f', 'i', 'e', 't']))
        };
        if code.into_iter().any(is_code) {
            unsafe_files.insert(path.to_string_lossy().into_owned());
        }
    }
    let expected: BTreeSet<_> = UNSAFE.iter().map(|(file, _)| (*file).to_owned()).collect();
    assert_eq!(unsafe_files, expected, "files with unsafe code; see UNSAFE");
    assert!(UNSAFE.iter().all(|(file, _)| root().join(file).is_file()));
}
