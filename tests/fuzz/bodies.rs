//! What is done with bytes that somebody else made: one function a fuzz target. Each ends, whatever the bytes are; a panic, an endless
//! loop or memory without bound is the fault that is looked for.
//!
//! The fuzz targets and the plain tests over their corpora (`tests/corpora.rs`) both include this file.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use tessera_geometry::{CameraPose, DVec3};
use tessera_pack::{Pack, PackOptions, Plain, build_pack};
use tessera_scene::{LoadOptions, Scene, SceneError, Selection, Without};
use tessera_whitted::{
    Adaptive, Features, FrameParams, PixelBlock, PixelFormat, Renderer, Sampler, Sampling,
};
use tessera_wire::codec::{self, Message};
use tessera_wire::{
    BatchHeader, FrameSummary, FromClient, JoinString, LocalTicket, PackChunk, ToClient, ToMaster, ToWorker,
};

// The rest of it is for the tests beside it.
#[allow(dead_code)]
#[path = "../../shared/pack/tests/pack/support.rs"]
mod support;

/// What is done with bytes.
pub type Body = fn(&[u8]);

/// The targets, each with its corpus in `corpus/NAME/`.
pub const TARGETS: [(&str, Body); 9] = [
    ("wire", wire),
    ("join", join),
    ("pack", pack),
    ("gltf", gltf),
    ("obj", obj),
    ("mtl", mtl),
    ("ply", ply),
    ("image", image),
    ("scene_file", scene_file),
];

/// A kind of message, then its body as it travels behind the length.
pub fn wire(bytes: &[u8]) {
    let Some((kind, body)) = bytes.split_first() else { return };
    match kind % 8 {
        0 => {
            if let Some(ToMaster::Hello(hello)) = message::<ToMaster>(body) {
                let _ = hello.check();
            }
        }
        1 => {
            if let Some(ToWorker::Frame(frame)) = message::<ToWorker>(body)
                && let Ok(grid) = frame.check()
            {
                assert!(grid.largest_tile_pixels() > 0 && grid.tiles() > 0);
            }
        }
        2 => drop(message::<PackChunk>(body)),
        3 => {
            if let Some(batch) = message::<BatchHeader>(body) {
                let _ = batch.check();
            }
        }
        4 => drop(message::<LocalTicket>(body)),
        5 => drop(message::<FromClient>(body)),
        6 => drop(message::<ToClient>(body)),
        _ => drop(message::<FrameSummary>(body)),
    }
}

/// A message that decodes is sent on as bytes that decode to the same. By its bytes: NaN equals nothing.
fn message<M: Message>(body: &[u8]) -> Option<M> {
    let message: M = codec::decode(body).ok()?;
    let sent = codec::encode(&message).expect("what was read can be written");
    let again: M = codec::decode(&sent[codec::PREFIX_BYTES..]).expect("what was written can be read");
    assert_eq!(codec::encode(&again).expect("written once"), sent);
    Some(message)
}

/// A join string.
pub fn join(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match text.parse::<JoinString>() {
        Ok(join) => assert_eq!(join.to_string().parse(), Ok(join)),
        Err(error) => assert_one_line(&error.to_string()),
    }
}

/// Changes of a sound pack, three bytes each (place, place, new value), or from a first byte of 4 on a whole file. Its hash is made
/// right, so that what is behind it is reached; a pack that is accepted is rendered.
pub fn pack(bytes: &[u8]) {
    let Some((&which, rest)) = bytes.split_first() else { return };
    let mut file = match packs().get(usize::from(which)) {
        Some(sound) => {
            let mut file = sound.clone();
            for change in rest.chunks_exact(3) {
                // Places spread over the whole file; the first kilobytes, where the tables are, one by one.
                let place = usize::from(u16::from_le_bytes([change[0], change[1]]));
                let place = if place < file.len().min(1 << 15) { place } else { place * 37 % file.len() };
                file[place] = change[2];
            }
            file
        }
        None => rest.to_vec(),
    };
    if file.len() >= 64 {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&file[..32]).update(&file[64..]);
        let hash = hasher.finalize();
        file[32..64].copy_from_slice(hash.as_bytes());
    }
    match Pack::from_bytes(&file) {
        Ok(pack) => render(&pack),
        Err(error) => assert_one_line(&error.to_string()),
    }
}

/// Packs with every section between them.
fn packs() -> &'static [Vec<u8>; 3] {
    static PACKS: OnceLock<[Vec<u8>; 3]> = OnceLock::new();
    PACKS.get_or_init(|| {
        let plain = Plain { positions: true, normals: true, uvs: true };
        [(Plain::default(), 64), (Plain::default(), 8192), (plain, 64)].map(|(plain, max_intervals)| {
            let options = PackOptions { plain, max_intervals, ..PackOptions::default() };
            build_pack(support::everything(3), &options).expect("a sound scene").0.bytes().to_vec()
        })
    })
}

/// A few pixels from each of the pack's cameras, and from one that frames its box.
fn render(pack: &Pack) {
    let (bounds, frame) = (pack.tree().bounds, pack.frame());
    let (low, high) = (frame.to_world(bounds.min), frame.to_world(bounds.max));
    let target = (low + high) * 0.5;
    let framing = CameraPose { eye: target + (high - low) * 1.5, target, up: DVec3::Y, fov_degrees: 40.0 };
    let stated = pack.cameras().iter().take(3).map(|camera| {
        let [eye, target, up] = [camera.eye, camera.target, camera.up].map(DVec3::from_array);
        CameraPose { eye, target, up, fov_degrees: camera.fov_degrees }
    });
    let renderer = Renderer::new(pack);
    for pose in stated.chain([framing]) {
        let Ok(camera) = pose.to_local(&frame, 8, 8) else { continue };
        let thorough = Sampling {
            sampler: Sampler::LowDiscrepancy,
            cutoff: 0.0,
            adaptive: Some(Adaptive { error: 0.1 }),
        };
        for (format, samples, sampling) in
            [(PixelFormat::Rgba8, 1, Sampling::default()), (PixelFormat::Layers, 2, thorough)]
        {
            let params = FrameParams {
                camera,
                width: 8,
                height: 8,
                samples,
                sampling,
                max_depth: 3,
                frame: 0,
                features: Features::default(),
                format,
            };
            let block = PixelBlock { x: 0, y: 0, width: 8, height: 8 };
            renderer.render_block(&params, block, &mut vec![0; block.byte_len(format)]);
        }
    }
}

/// A `.gltf`, or a `.glb` if it begins like one.
pub fn gltf(bytes: &[u8]) {
    import("a.gltf", &[("a.gltf", bytes), ("a.png", PNG), ("a.bin", &[0; 256])]);
}

/// A `.obj` beside a material library.
pub fn obj(bytes: &[u8]) {
    import(
        "a.obj",
        &[("a.obj", bytes), ("a.mtl", b"newmtl a\nmap_Kd a.png\nnewmtl b\nillum 7\nd 0.5\n"), ("a.png", PNG)],
    );
}

/// A material library.
pub fn mtl(bytes: &[u8]) {
    import("a.obj", &[("a.obj", TEXTURED), ("a.mtl", bytes), ("a.png", PNG)]);
}

/// A `.ply`.
pub fn ply(bytes: &[u8]) {
    import("a.ply", &[("a.ply", bytes)]);
}

/// An image that a material names.
pub fn image(bytes: &[u8]) {
    import(
        "a.obj",
        &[("a.obj", TEXTURED), ("a.mtl", b"newmtl a\nmap_Kd a.png\nmap_Ke a.png\n"), ("a.png", bytes)],
    );
}

/// A scene file beside a source and an image. Generators are asked for few triangles only, since many take their time.
pub fn scene_file(bytes: &[u8]) {
    let in_number = |byte: &u8| byte.is_ascii_hexdigit() || *byte == b'_';
    let longest = bytes.split(|byte| !in_number(byte)).map(<[u8]>::len).max().unwrap_or(0);
    if bytes.windows(8).any(|window| window == b"generate") && longest > 8 {
        return;
    }
    let generates_many = bytes.split(|byte| !byte.is_ascii_digit()).any(|digits| digits.len() > 4);
    if generates_many && bytes.windows(9).any(|window| window == b"triangles") {
        return;
    }
    import("a.toml", &[("a.toml", bytes), ("a.obj", TEXTURED), ("a.mtl", b"newmtl a\n"), ("a.png", PNG)]);
}

const TEXTURED: &[u8] =
    b"mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nusemtl b\nf 1 3 2\n";

/// One red texel.
const PNG: &[u8] = include_bytes!("corpus/image/texel.png");

/// Loads `name` from a folder with these files; goes on with the scene if there is one, as a render would.
fn import(name: &str, files: &[(&str, &[u8])]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files {
        fs::write(folder.path().join(name), bytes).expect("a temporary file");
    }
    if let Err(error) = use_scene(&folder.path().join(name)) {
        assert_one_line(&error.to_string());
    }
}

fn use_scene(path: &Path) -> Result<(), SceneError> {
    let scene: Scene = tessera_scene::load(path, &LoadOptions::default())?;
    let flat = scene.flatten()?;
    let vertices = flat.positions.len();
    assert!(flat.triangles.as_flattened().iter().all(|&index| (index as usize) < vertices));
    assert!(
        [flat.normals.len(), flat.uvs.len(), flat.colors.len()].iter().all(|n| *n == 0 || *n == vertices)
    );
    let selection = Selection::of(&scene, &flat, Without::default());
    assert!(selection.materials.iter().all(|&material| material < scene.materials.len()));
    assert!(selection.images.iter().all(|&image| image < scene.images.len()));
    assert!(!scene.cameras.is_empty());
    scene.warnings.iter().chain(&scene.notes).for_each(|line| assert_one_line(line));
    Ok(())
}

/// What a person reads: one line that no terminal obeys.
fn assert_one_line(text: &str) {
    assert!(!text.is_empty() && !text.contains(char::is_control), "{text:?}");
}
