//! Bytes that were changed: refused, or harmless.

use crate::support::everything;
use std::ops::Range;
use tessera_geometry::{Ray, Vec3};
use tessera_pack::format::Section;
use tessera_pack::{NO_TEXTURE, NormalCode, Pack, PackError, PackOptions, Plain, build_pack};

/// Five packs that have every section and every flag between them.
fn packs() -> Vec<Pack> {
    let plain = [
        Plain::default(),
        Plain { positions: true, normals: true, uvs: true },
        Plain { positions: true, normals: false, uvs: false },
    ];
    // The coarse grid has narrow cells, the fine one wide ones.
    let smith = [(plain[0], 64), (plain[0], 8192), (plain[1], 64), (plain[2], 64)]
        .map(|(plain, max_intervals)| PackOptions { plain, max_intervals, ..PackOptions::default() });
    let oct = PackOptions { normal_code: NormalCode::Oct, max_intervals: 64, ..PackOptions::default() };
    smith
        .into_iter()
        .chain([oct])
        .map(|options| build_pack(everything(8), &options).expect("a sound scene").0)
        .collect()
}

/// Makes the content hash right again.
fn rehash(bytes: &mut [u8]) {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..32]);
    hasher.update(&bytes[64..]);
    let hash = hasher.finalize();
    bytes[32..64].copy_from_slice(hash.as_bytes());
}

/// Where each section lies, by the table in the file.
fn sections(bytes: &[u8]) -> Vec<(String, Range<usize>)> {
    let long = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("8 bytes")) as usize;
    let count = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
    (0..count)
        .map(|i| 64 + 24 * i)
        .map(|at| {
            let name = String::from_utf8_lossy(&bytes[at..at + 8]).trim_end_matches('\0').to_owned();
            (name, long(at + 8)..long(at + 8) + long(at + 16))
        })
        .collect()
}

/// A small generator (SplitMix64): the same changes in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ z >> 31) % n as u64) as usize
    }
}

/// Reads everything that a renderer could read, and traces a few rays.
fn read_all(pack: &Pack) {
    let (mesh, tree) = (pack.mesh(), pack.tree());
    for id in 0..pack.triangle_count() {
        for v in mesh.indices(id) {
            let p = mesh.position(v);
            assert!(p.is_finite() && mesh.uv(v).is_finite());
            assert!(mesh.normal(v).is_none_or(|n| (n.length() - 1.0).abs() < 1e-2));
            assert!(mesh.color(v).iter().all(|c| (0.0..=1.0).contains(c)));
        }
        let material = &pack.materials()[pack.material_of(id) as usize];
        assert_ne!(pack.original_id(id), u32::MAX);
        for slot in [
            material.base_texture,
            material.metallic_roughness_texture,
            material.emissive_texture,
            material.transmission_texture,
        ] {
            if slot != NO_TEXTURE {
                let t = pack.textures()[slot as usize];
                let last = u64::from(t.first_texel) + u64::from(t.width) * u64::from(t.height) - 1;
                assert!(last < pack.texels().len() as u64);
            }
        }
    }
    for i in 0..16 {
        let direction = Vec3::new(0.3 - 0.05 * i as f32, 0.1, -1.0).normalize();
        let origin = Vec3::new(1000.0 * i as f32 - 8000.0, 3.0, 1e6);
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        let hit = tree.closest_hit(&mesh, &ray, |_| true);
        assert!(hit.is_none_or(|h| h.triangle < pack.triangle_count()));
        tree.any_hit(&mesh, &ray, |_| false);
    }
    assert!(pack.frame().to_world(Vec3::ONE).is_finite());
    assert!(pack.lights().iter().all(|l| l.position.iter().all(|x| x.is_finite())));
    assert!(pack.environment().up.iter().all(|x| x.is_finite()));
    assert!(pack.cameras().iter().all(|c| c.name().is_some_and(|n| !n.is_empty())));
    assert!(pack.ambient().radiance.iter().all(|x| x.is_finite()));
}

#[test]
fn a_changed_byte_is_always_noticed() {
    let mut random = Random(1);
    for pack in packs() {
        let sound = pack.bytes();
        for _ in 0..300 {
            let mut bytes = sound.to_vec();
            bytes[random.below(sound.len())] ^= 1 << random.below(8);
            assert!(Pack::from_bytes(&bytes).is_err());
        }
        for at in [0, 7, 8, 12, 16, 24, 32, 63, 64, sound.len() - 1] {
            let mut bytes = sound.to_vec();
            bytes[at] ^= 0x80;
            assert!(Pack::from_bytes(&bytes).is_err(), "byte {at}");
        }
    }
}

#[test]
fn every_truncation_and_every_continuation_is_refused() {
    let pack = &packs()[0];
    for length in (0..200).chain((200..pack.bytes().len()).step_by(97)) {
        let error = Pack::from_bytes(&pack.bytes()[..length]).expect_err("truncated");
        assert!(matches!(error, PackError::NotAPack | PackError::Truncated { .. }), "{length}: {error}");
    }
    let mut longer = pack.bytes().to_vec();
    longer.push(0);
    assert!(matches!(Pack::from_bytes(&longer), Err(PackError::Truncated { .. })));
}

/// Changes bytes under a right hash: what passes the checks must be safe to render.
#[test]
fn forged_content_is_refused_or_harmless() {
    let mut random = Random(2);
    let mut outcomes = std::collections::BTreeMap::<String, [u32; 2]>::new();
    for pack in packs() {
        let sound = pack.bytes();
        let mut places = sections(sound);
        places.push(("file header".into(), 0..32));
        places.push(("section table".into(), 64..64 + 24 * (places.len() - 1)));
        for (name, range) in places {
            for _ in 0..100 {
                let mut bytes = sound.to_vec();
                for _ in 0..=random.below(3) {
                    let at = range.start + random.below(range.len());
                    bytes[at] = match random.below(4) {
                        0 => bytes[at] ^ 1 << random.below(8),
                        1 => 0xFF,
                        2 => 0,
                        _ => random.below(256) as u8,
                    };
                }
                rehash(&mut bytes);
                let outcome = Pack::from_bytes(&bytes);
                outcomes.entry(name.clone()).or_default()[usize::from(outcome.is_ok())] += 1;
                if let Ok(forged) = outcome {
                    read_all(&forged);
                }
            }
        }
    }
    // Every section can be at fault, but for those in which any value is right; and some changes do no harm anywhere.
    for (name, [refused, passed]) in &outcomes {
        assert_eq!(*refused > 0, !matches!(name.as_str(), "color" | "texel"), "{name}: {refused} {passed}");
        assert!(*passed > 0, "{name}: {refused} {passed}");
    }
    assert_eq!(outcomes.len(), Section::ALL.len() + 2, "every section was there: {outcomes:?}");
}

/// Overwrites `new` at `offset` of `section` and returns the message of the refusal.
fn refusal(pack: &Pack, section: &str, offset: usize, new: &[u8]) -> String {
    let mut bytes = pack.bytes().to_vec();
    let range = sections(&bytes).into_iter().find(|s| s.0 == section).expect("a section of that name").1;
    bytes[range][offset..offset + new.len()].copy_from_slice(new);
    rehash(&mut bytes);
    match Pack::from_bytes(&bytes) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("accepted: {section} {offset} {new:?}"),
    }
}

#[test]
fn refusals_name_section_place_and_rule() {
    let all = packs();
    let (narrow, wide, plain, mixed, oct) = (&all[0], &all[1], &all[2], &all[3], &all[4]);
    let nan = f32::NAN.to_le_bytes();
    let none = u32::MAX.to_le_bytes();
    for (pack, section, offset, new, expected) in [
        (narrow, "head", 0, &f64::NAN.to_le_bytes()[..], "'head', byte 0: the anchor is out of range"),
        (narrow, "head", 24, &0f64.to_le_bytes(), "'head', byte 0: the voxel side is out of range"),
        (narrow, "head", 32, &8193u32.to_le_bytes(), "a number of cells is not in 1..=8192"),
        (narrow, "head", 44, &2u32.to_le_bytes(), "'records', byte 0: "),
        (narrow, "head", 44, &7u32.to_le_bytes(), "a vertex record has 0, 2 or 3 words"),
        (narrow, "head", 48, &1u32.to_le_bytes(), "elements instead of 1"),
        (narrow, "head", 48, &none, "too many vertices"),
        (narrow, "head", 56, &1u32.to_le_bytes(), "more triangles than the scene had"),
        (narrow, "head", 60, &none, "the kd-tree is deeper than a traversal stack"),
        (narrow, "head", 64, &nan, "the root box"),
        (narrow, "kdslot", 4, &(1u32 << 2 | 3).to_le_bytes(), "'kdslot', byte "),
        (narrow, "head", 88, &(-1f32).to_le_bytes(), "ambient radiance"),
        (narrow, "head", 100, &5u32.to_le_bytes(), "unknown flags"),
        (oct, "head", 100, &7u32.to_le_bytes(), "unknown flags"),
        (oct, "head", 100, &2u32.to_le_bytes(), "a code for normals without normals in the records"),
        (plain, "head", 100, &3u32.to_le_bytes(), "a code for normals without normals in the records"),
        (narrow, "head", 100, &0u32.to_le_bytes(), "a normal in the record where there must be none"),
        (narrow, "cells", 4, &0u32.to_le_bytes(), "'cells', byte 4: element 1: cells do not ascend"),
        (wide, "cells", 8, &0u64.to_le_bytes(), "'cells', byte 8: element 1: cells do not ascend"),
        (narrow, "records", 12 + 3, &[0xBF], "'records', byte 12: vertex 1: reserved bits"),
        (narrow, "records", 12 + 4, &[0xFF, 0xFF], "vertex 1: a cell beyond the table"),
        (narrow, "records", 12 + 6, &[0xFE, 0xFF], "vertex 1: a normal code that no encoder writes"),
        (oct, "records", 12 + 6, &[0xFE, 0xFF], "vertex 1: a normal code that no encoder writes"),
        (oct, "records", 12 + 6, &[0xFF, 0x00], "vertex 1: a normal code that no encoder writes"),
        (mixed, "records", 12, &[1], "vertex 1: a position in the record beside a plain one"),
        (plain, "position", 16, &nan, "'position', byte 12: element 1: a coordinate out of range"),
        (plain, "position", 16, &1e9f32.to_le_bytes(), "a coordinate out of range"),
        (
            plain,
            "normal",
            0,
            &2f32.to_le_bytes(),
            "'normal', byte 0: element 0: neither zero nor a unit vector",
        ),
        (
            plain,
            "uv",
            4,
            &f32::INFINITY.to_le_bytes(),
            "'uv', byte 0: element 0: a texture coordinate out of range",
        ),
        (narrow, "side-uv", 4, &nan, "'side-uv', byte 0: element 0: a texture coordinate out of range"),
        (narrow, "side-uv", 0, &none, "'side-uv', byte 0: element 0: a vertex that does not refer"),
        (narrow, "face", 8, &none, "'face', byte 0: element 0: a vertex that does not exist"),
        (narrow, "matrun", 0, &1u32.to_le_bytes(), "the first run does not begin at triangle 0"),
        (narrow, "matrun", 8, &0u32.to_le_bytes(), "'matrun', byte 0: element 0: runs do not ascend"),
        (narrow, "matrun", 4, &none, "a material that does not exist"),
        (narrow, "idrun", 4, &(u32::MAX - 1).to_le_bytes(), "an original id beyond the scene"),
        (narrow, "material", 0, &2f32.to_le_bytes(), "'material', byte 0: element 0: base_color"),
        (narrow, "material", 64, &9u32.to_le_bytes(), "a texture that does not exist"),
        (narrow, "texture", 4, &0u32.to_le_bytes(), "'texture', byte 0: element 0: width or height"),
        (narrow, "texture", 16 + 8, &60_000u32.to_le_bytes(), "'texture', byte 16: element 1: texels beyond"),
        (narrow, "texture", 12, &3u32.to_le_bytes(), "unknown sampling bits"),
        (narrow, "light", 12, &3u32.to_le_bytes(), "'light', byte 0: element 0: unknown kind"),
        (
            narrow,
            "light",
            64 + 16,
            &9f32.to_le_bytes(),
            "'light', byte 64: element 1: direction is not a unit",
        ),
        (narrow, "camera", 0, &f64::NAN.to_le_bytes(), "'camera', byte 0: element 0: eye"),
        (narrow, "environ", 12, &2u32.to_le_bytes(), "'environ', byte 0: a map without an existing texture"),
    ] {
        let message = refusal(pack, section, offset, new);
        assert!(message.contains(expected), "{section} {offset}: {message}");
    }
}

#[test]
fn other_versions_and_other_files_are_told_apart() {
    let pack = &packs()[0];
    let mut newer = pack.bytes().to_vec();
    newer[8] = 2;
    rehash(&mut newer);
    assert_eq!(Pack::from_bytes(&newer).err(), Some(PackError::Version { found: 2 }));
    assert_eq!(Pack::from_bytes(b"\x89PNG\r\n\x1a\n and so on").err(), Some(PackError::NotAPack));
    assert_eq!(Pack::from_bytes(b"").err(), Some(PackError::NotAPack));
    let id = pack.id().to_string();
    assert!(id.len() == 64 && id.starts_with(&format!("{:02x}", pack.bytes()[32])));
}

#[test]
fn shared_bytes_are_read_in_place_or_copied_and_checked_either_way() {
    struct Shifted(Vec<u64>, usize);
    impl AsRef<[u8]> for Shifted {
        fn as_ref(&self) -> &[u8] {
            &bytemuck::cast_slice(&self.0)[self.1..]
        }
    }
    let pack = &packs()[0];
    let shared = |shift: usize, change: fn(&mut [u8])| {
        let mut words = vec![0; (pack.bytes().len() + shift).div_ceil(8)];
        let bytes = &mut bytemuck::cast_slice_mut(&mut words)[shift..];
        bytes[..pack.bytes().len()].copy_from_slice(pack.bytes());
        change(bytes);
        Pack::from_shared(std::sync::Arc::new(Shifted(words, shift)))
    };
    for shift in (0..64).step_by(8) {
        let same = shared(shift, |_| ()).expect("the same bytes");
        assert_eq!(same.bytes(), pack.bytes());
        assert!(same.bytes().as_ptr().addr().is_multiple_of(64));
        let damaged = shared(shift, |bytes| bytes[200] ^= 1);
        assert!(matches!(damaged, Err(PackError::HashMismatch)), "{damaged:?}");
    }
}
