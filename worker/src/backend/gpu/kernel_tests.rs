//! Holds the kernels' text to Rust, without a GPU: every kernel is valid, and structs, constants and the places where a pack's records are
//! read are those of the Rust that writes them.

mod constants;
mod eval;
mod places;

use super::kernel::{
    BUGS, Chunks, KernelKey, Purpose, SLOT_BINDING, Stage, TraversalForm, binding_types, text,
};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Module, Scalar, ScalarKind, StorageAccess, TypeInner, VectorSize};
use std::collections::BTreeMap;
use tessera_pack::device::VertexLayout;
use tessera_whitted::twins::layouts;
use tessera_whitted::variant::Variant;
use wgpu::BufferBindingType;

/// Everything in one binding each.
const WHOLE: Chunks = Chunks { slot_bindings: 1, slots_log2: 31, word_bindings: 1, words_log2: 31 };

/// Several of both.
const SPLIT: Chunks = Chunks { slot_bindings: 3, slots_log2: 20, word_bindings: 5, words_log2: 27 };

/// Number of switches of a variant.
const SWITCHES: usize = 16;

/// All switches on or off but for number `odd`, if there is one of that number.
fn variant(on: bool, odd: usize) -> Variant {
    let mut numbers = 0..SWITCHES;
    let mut next = || on ^ (numbers.next() == Some(odd));
    let variant = Variant {
        layout: VertexLayout {
            plain_positions: next(),
            wide_cells: next(),
            record_words: [0, 2, 3][odd % 3],
            plain_normals: next(),
            oct_normals: next(),
            plain_uvs: next(),
            has_side_uvs: next(),
        },
        refs: next(),
        normals: next(),
        textures: next(),
        colors: next(),
        materials: next(),
        holes: next(),
        hidden_backs: next(),
        see_through: next(),
        mirrors: next(),
        glass: next(),
    };
    assert_eq!(numbers.next(), None, "SWITCHES is too large");
    variant
}

/// The kernel with everything in it.
fn whole() -> KernelKey {
    KernelKey {
        variant: variant(true, SWITCHES),
        depth: 5,
        form: TraversalForm::PrivateStack,
        f64: true,
        chunks: WHOLE,
        purpose: Purpose::Probe,
    }
}

/// Every switch alone, on among those that are off and the other way round, in both precisions; and the kernels with all and nothing in
/// every form, for every purpose, over one binding and several, with paths of any depth.
fn keys() -> Vec<KernelKey> {
    let mut keys = Vec::new();
    for (on, f64) in [(false, false), (false, true), (true, false), (true, true)] {
        let key = KernelKey { f64, purpose: Purpose::Render, ..whole() };
        keys.extend((0..SWITCHES).map(|odd| KernelKey { variant: variant(on, odd), ..key }));
        for form in [TraversalForm::PrivateStack, TraversalForm::ShortStack] {
            for (chunks, depth) in [(WHOLE, 0), (SPLIT, 32)] {
                for purpose in [Purpose::Render, Purpose::Probe, Purpose::Rays] {
                    let variant = variant(on, SWITCHES);
                    keys.push(KernelKey { variant, depth, form, f64, chunks, purpose });
                }
                let form = TraversalForm::Wavefront;
                for purpose in Stage::ALL.map(Purpose::Wave) {
                    let variant = variant(on, SWITCHES);
                    keys.push(KernelKey { variant, depth, form, f64, chunks, purpose });
                }
            }
        }
    }
    keys
}

fn parse(key: &KernelKey) -> Module {
    let text = text(key);
    naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{key:?}: {}", e.emit_to_string(&text)))
}

/// A bug whose place is gone, or is not one, would be planted nowhere, or twice; and one that is no WGSL is no wrong answer.
#[test]
fn every_bug_for_tests_has_one_place_in_every_kernel_and_leaves_it_valid() {
    for key in keys() {
        let text = text(&key);
        for (mutation, right, _) in BUGS {
            assert_eq!(text.matches(right).count(), 1, "{}: {right}: {key:?}", mutation.name());
        }
    }
    for (f64, purpose) in [(false, Purpose::Render), (true, Purpose::Render), (true, Purpose::Probe)] {
        let text = text(&KernelKey { f64, purpose, ..whole() });
        for (mutation, right, wrong) in BUGS {
            let text = text.replace(right, wrong);
            let name = mutation.name();
            let module = naga::front::wgsl::parse_str(&text);
            let module = module.unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&text)));
            let capabilities = if f64 { Capabilities::FLOAT64 } else { Capabilities::empty() };
            let checked = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
            assert!(checked.is_ok(), "{name}: {checked:?}");
        }
    }
}

#[test]
fn every_kernel_is_valid_and_has_the_bindings_of_its_layout() {
    for key in keys() {
        // Validate with no more than the device is asked for.
        let module = parse(&key);
        let capabilities = if key.f64 { Capabilities::FLOAT64 } else { Capabilities::empty() };
        let checked = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
        let info = checked.unwrap_or_else(|e| panic!("{key:?}: {}", e.emit_to_string(&text(&key))));
        let entries: Vec<_> = module.entry_points.iter().map(|entry| entry.name.as_str()).collect();
        let entry = entries.iter().position(|&entry| entry == key.purpose.entry());
        let entry = entry.unwrap_or_else(|| panic!("{key:?}: {entries:?}"));

        // Compare the bindings that the entry uses, and those that are laid out.
        let laid: BTreeMap<_, _> = binding_types(key.chunks, key.purpose).into_iter().collect();
        let mut bindings = BTreeMap::new();
        for (handle, variable) in module.global_variables.iter() {
            let Some(at) = variable.binding else { continue };
            let name = variable.name.as_deref().unwrap_or("");
            let ty = match variable.space {
                AddressSpace::Uniform => BufferBindingType::Uniform,
                AddressSpace::Storage { access } => {
                    BufferBindingType::Storage { read_only: !access.contains(StorageAccess::STORE) }
                }
                other => panic!("{name} lies in {other:?}"),
            };
            assert_eq!(at.group, 0, "{name}");
            let other = bindings.insert(at.binding, (name, ty));
            assert_eq!(other, None, "{name} has the binding of another");
            let is_used = !info.get_entry_point(entry)[handle].is_empty();
            assert!(!is_used || laid.get(&at.binding) == Some(&ty), "{key:?}: {name} is not laid out");
        }
        for (at, ty) in laid {
            assert_eq!(bindings.get(&at).map(|binding| binding.1), Some(ty), "{key:?}: binding {at}");
        }
        assert_eq!(bindings[&SLOT_BINDING].0, "slots_0");
    }
}

#[test]
fn structs_lie_as_their_twins_in_rust_do() {
    let module = parse(&whole());
    for layout in layouts() {
        let (_, members, span) = structs(&module)
            .find(|(name, ..)| *name == layout.twin)
            .unwrap_or_else(|| panic!("the text has no struct {}", layout.twin));
        assert_eq!(span as usize, layout.size, "bytes of {}", layout.twin);
        let members: Vec<_> = members
            .iter()
            .map(|member| {
                (member.name.as_deref().unwrap_or(""), member.offset as usize, rust_type(&module, member.ty))
            })
            .filter(|(name, ..)| !name.starts_with("reserved_"))
            .collect();
        let twins: Vec<_> = layout.members.iter().map(|&(name, at, ty)| (name, at, ty.to_owned())).collect();
        assert_eq!(members, twins, "members of {}", layout.twin);
    }
}

fn structs(module: &Module) -> impl Iterator<Item = (&str, &[naga::StructMember], u32)> {
    module.types.iter().filter_map(|(_, ty)| match &ty.inner {
        TypeInner::Struct { members, span } => Some((ty.name.as_deref()?, members.as_slice(), *span)),
        _ => None,
    })
}

/// The type of Rust that is read as such.
fn rust_type(module: &Module, ty: naga::Handle<naga::Type>) -> String {
    let name = |scalar: Scalar| match (scalar.kind, scalar.width) {
        (ScalarKind::Uint, 4) => "u32",
        (ScalarKind::Float, 4) => "f32",
        other => panic!("{other:?} is not written by Rust"),
    };
    match &module.types[ty].inner {
        TypeInner::Scalar(scalar) => name(*scalar).to_owned(),
        TypeInner::Vector { size: VectorSize::Tri, scalar } => format!("[{}; 3]", name(*scalar)),
        TypeInner::Struct { .. } if module.types[ty].name.as_deref() == Some("Backdrop") => {
            std::any::type_name::<tessera_whitted::device::BackdropInfo>().to_owned()
        }
        other => panic!("{other:?} is not written by Rust"),
    }
}
