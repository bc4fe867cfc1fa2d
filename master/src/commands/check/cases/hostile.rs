//! Bytes and files that mean harm, or were damaged.

use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::exact;
use std::fs;
use tessera_kdtree::soup::{Random, scenes, unkind_ray};
use tessera_kdtree::{TreeView, validate};
use tessera_pack::Pack;
use tessera_scene::{LoadOptions, load};
use tessera_whitted::stage::look;
use tessera_whitted::stage::stages::bazaar;
use tessera_whitted::{PixelBlock, PixelFormat, Renderer};

pub const CASES: &[Case] = &[
    Case {
        id: "21",
        input: "scene files cut short, indices out of range",
        judge: "I: an error, no panic",
        run: Run::Once(files),
    },
    Case {
        id: "42",
        input: "trees with bits flipped and slots cut",
        judge: "I: refused, or traversed to the end",
        run: Run::Once(trees),
    },
    Case {
        id: "42-pack",
        input: "packs with a bit flipped, cut, or forged under a right hash",
        judge: "I: refused, or rendered to the end",
        run: Run::Once(forged),
    },
];

/// A triangle, as text and as what it takes to break it.
const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
                   property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

fn files(_: Effort) -> Outcome {
    let folder = tempfile::tempdir().map_err(|e| format!("no folder for files: {e}"))?;
    let read = |name: &str, text: &[u8]| -> Result<bool, String> {
        let path = folder.path().join(name);
        fs::write(&path, text).map_err(|e| e.to_string())?;
        Ok(load(&path, &LoadOptions::default()).is_ok_and(|scene| scene.flatten().is_ok()))
    };
    let sound = [read("sound.ply", PLY.as_bytes())?, read("sound.obj", OBJ.as_bytes())?];
    let lost = sound.iter().filter(|read| !**read).count();
    let mut taken = Vec::new();
    let faults: [(&str, String); 7] = [
        ("index.ply", PLY.replace("3 0 1 2", "3 0 1 7")),
        ("count.ply", PLY.replace("element vertex 3", "element vertex 4000000000")),
        ("list.ply", PLY.replace("3 0 1 2", "3 0 1")),
        ("index.obj", OBJ.replace("f 1 2 3", "f 1 2 9")),
        ("zero.obj", OBJ.replace("f 1 2 3", "f 0 1 2")),
        ("words.obj", OBJ.replace("v 1 0 0", "v 1 zero 0")),
        ("not.glb", "glTF, but not really".into()),
    ];
    for (name, text) in &faults {
        if read(name, text.as_bytes())? {
            taken.push(*name);
        }
    }
    // A file may end behind any byte: what is read of it must not fall over, and no face is made up.
    let cut = PLY.len() - "3 0 1 2\n".len();
    for length in (0..cut).step_by(7) {
        if read("cut.ply", &PLY.as_bytes()[..length])? {
            taken.push("cut.ply");
        }
    }
    Ok(Finding::all([
        Finding::none(taken.len(), faults.len() + cut.div_ceil(7), "faulty files taken"),
        Finding::none(lost, sound.len(), "sound files refused"),
    ]))
}

fn trees(effort: Effort) -> Outcome {
    let (mut refused, mut harmless, mut cut, mut cut_taken) = (0, 0, 0, 0);
    let mut random = Random(61);
    for (_, soup) in scenes() {
        for max_refs in 0..=2 {
            let tree = soup.build(max_refs);
            for _ in 0..effort.pick(60, 600) {
                let (mut slots, mut list) = (tree.slots.clone(), tree.list.clone());
                match random.below(8) {
                    0 => slots.truncate(random.below(slots.len() + 1)),
                    1 => list.truncate(random.below(list.len() + 1)),
                    2 if !list.is_empty() => {
                        let at = random.below(list.len());
                        list[at] ^= 1 << random.below(32);
                    }
                    _ => {
                        let at = random.below(slots.len());
                        slots[at][random.below(2)] ^= 1 << random.below(32);
                    }
                }
                let view = TreeView { bounds: tree.bounds, slots: &slots, list: &list };
                let is_sound = validate(&view, soup.len()).is_ok();
                // Every slot and every entry of the list belongs to one node.
                let is_cut = slots.len() < tree.slots.len() || list.len() < tree.list.len();
                cut += usize::from(is_cut);
                cut_taken += usize::from(is_cut && is_sound);
                if !is_sound {
                    refused += 1;
                    continue;
                }
                harmless += 1;
                for i in 0..20 {
                    let ray = unkind_ray(i, &mut random, &soup, &[]);
                    view.closest_hit(&soup, &ray, |_| true);
                }
            }
        }
    }
    // A bit of a plane or of a triangle's number may well leave a tree, though not the one that was built.
    Ok(Finding::all([
        Finding::none(cut_taken, cut, "cut trees taken"),
        Finding::at_least("trees refused", refused, 1),
        Finding::at_least("trees that are others, traversed to the end", harmless, 1),
    ]))
}

fn forged(effort: Effort) -> Outcome {
    let pack = exact(&bazaar())?;
    let sound = pack.bytes();
    let mut random = Random(62);
    let (mut unnoticed, mut flipped) = (0, 0);
    for _ in 0..effort.pick(100, 1000) {
        let mut bytes = sound.to_vec();
        bytes[random.below(sound.len())] ^= 1 << random.below(8);
        unnoticed += usize::from(Pack::from_bytes(&bytes).is_ok());
        flipped += 1;
    }
    let lengths: Vec<usize> = (0..200).chain((200..sound.len()).step_by(sound.len() / 50)).collect();
    let cut = lengths.iter().filter(|n| Pack::from_bytes(&sound[..**n]).is_ok()).count();

    // What has the right hash and passes the checks is rendered to the end.
    let view = look([0.3, 0.6, 5.0], [0.0; 3]).sized(8, 8);
    let render = |pack: &Pack| {
        // (Where the grid itself was forged, the camera may be nowhere.)
        if view.pose.to_local(&pack.frame(), 8, 8).is_err() {
            return false;
        }
        let block = PixelBlock { x: 0, y: 0, width: 8, height: 8 };
        let params = view.params(pack, PixelFormat::Rgba8);
        Renderer::new(pack).render_block(&params, block, &mut [0; 256]).primary == 64
    };
    // What is only hashed again is the pack that it was: so what is refused is refused for what was forged.
    let mut unchanged = sound.to_vec();
    rehash(&mut unchanged);
    let is_kept = unchanged == sound && Pack::from_bytes(&unchanged).is_ok_and(|pack| render(&pack));
    let (mut refused, mut rendered, mut nowhere) = (0, 0, 0);
    for _ in 0..effort.pick(300, 3000) {
        let mut bytes = sound.to_vec();
        for _ in 0..1 + random.below(3) {
            bytes[64 + random.below(sound.len() - 64)] = random.bits() as u8;
        }
        rehash(&mut bytes);
        let Ok(forged) = Pack::from_bytes(&bytes) else {
            refused += 1;
            continue;
        };
        let counted = if render(&forged) { &mut rendered } else { &mut nowhere };
        *counted += 1;
    }
    Ok(Finding::all([
        Finding::none(unnoticed, flipped, "flipped bits not noticed"),
        Finding::none(cut, lengths.len(), "packs cut short taken"),
        Finding::holds("the pack itself, hashed again, is taken", is_kept.to_string(), is_kept),
        Finding::at_least("forged packs refused", refused, 1),
        Finding::holds(
            "forged packs rendered to the end >= 1",
            format!("{rendered}, and {nowhere} without a place for the camera"),
            rendered > 0,
        ),
    ]))
}

/// Makes the content hash right again.
fn rehash(bytes: &mut [u8]) {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..32]);
    hasher.update(&bytes[64..]);
    let hash = hasher.finalize();
    bytes[32..64].copy_from_slice(hash.as_bytes());
}
