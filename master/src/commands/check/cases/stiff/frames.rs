//! Frames rendered whole and by rows.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tessera_geometry::{DVec3, LocalCamera, Vec3};
use tessera_master::{
    Balance, Cluster, FrameBuffer, FrameJob, ImageHash, ImageHasher, OutputFile, PixelFormat, PngStream,
};
use tessera_pack::{Material, Pack, PackInput, PackOptions, build_pack};
use tessera_wire::{FrameId, PackId, Rect};
use tessera_worker::Kernel;
use tessera_worker::gpu::probe::cpu_rect;

/// Width and height, and side of a tile: none, one or both sides divide, and tiles larger than the image.
pub const SIZES: [([u32; 2], u32); 8] = [
    ([1, 1], 128),
    ([1, 300], 16),
    ([300, 1], 16),
    ([64, 64], 16),
    ([65, 63], 16),
    ([33, 31], 200),
    ([150, 100], 7),
    ([16_384, 5], 64),
];

/// A tilted square in front of the camera.
///
/// # Errors
/// Those of packing.
pub fn slope() -> Result<Pack, String> {
    let input = PackInput {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, -1.0], [-1.0, 1.0, -1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material_runs: vec![(0, 0)],
        materials: vec![Material { emissive: [0.2, 0.4, 0.6], ..Material::default() }],
        ..PackInput::default()
    };
    Ok(build_pack(input, &PackOptions::default()).map_err(|e| e.to_string())?.0)
}

/// A view of it that its edges cross.
pub fn job(pack: &Pack, [width, height]: [u32; 2], tile: u32, format: PixelFormat) -> FrameJob {
    let origin = pack.frame().to_local(DVec3::new(0.2, 0.1, 3.0));
    FrameJob {
        tile,
        depth: 2,
        format,
        balance: Balance::Dynamic,
        ..FrameJob::new(
            LocalCamera { origin, forward: -Vec3::Z, right: Vec3::X * 0.6, up: Vec3::Y * 0.4 },
            width,
            height,
        )
    }
}

/// One frame, held whole; every tile once.
///
/// # Errors
/// Those of rendering, and a tile that was lost or doubled.
pub async fn whole(cluster: &mut Cluster, job: &FrameJob) -> Result<FrameBuffer, String> {
    let result = cluster.render(job, |_| ()).await.map_err(|e| e.to_string())?;
    let tiles: u32 = result.workers.iter().map(|worker| worker.tiles).sum();
    if tiles != job.width.div_ceil(job.tile) * job.height.div_ceil(job.tile) {
        return Err(format!("{tiles} tiles were counted"));
    }
    Ok(result.image)
}

/// The same, to a PNG file by rows.
///
/// # Errors
/// Those of rendering and writing.
pub async fn by_rows(cluster: &mut Cluster, job: &FrameJob, path: &Path) -> Result<ImageHash, String> {
    let file = OutputFile::check(path).map_err(|e| e.to_string())?;
    let stream = PngStream::begin(&file, job.width, job.height, job.format);
    let mut stream = stream.map_err(|e| e.to_string())?;
    cluster.render_rows(job, &mut stream, |_| ()).await.map_err(|e| e.to_string())?;
    stream.finish().await.map_err(|e| e.to_string())
}

/// The hash of the same frame, rendered by this process in bands of rows, none of which is kept.
pub fn hash_by_bands(pack: &Pack, job: &FrameJob) -> ImageHash {
    const ROWS: u32 = 64;
    let frame = job.to_wire(FrameId(1), PackId(pack.id().0));
    let mut hasher = ImageHasher::new(job.width, job.height, job.format);
    for y in (0..job.height).step_by(ROWS as usize) {
        let band = Rect { x: 0, y, width: job.width, height: ROWS.min(job.height - y) };
        hasher.update(&cpu_rect(pack, Kernel::auto(), &frame, band).0);
    }
    hasher.finish()
}

/// The hash of what an 8-bit PNG file holds, read row by row.
///
/// # Errors
/// It is no such file.
pub fn hash_of_png(path: &Path) -> Result<ImageHash, String> {
    let file = BufReader::new(File::open(path).map_err(|e| e.to_string())?);
    let mut reader = png::Decoder::new(file).read_info().map_err(|e| e.to_string())?;
    let info = reader.info();
    if (info.color_type, info.bit_depth) != (png::ColorType::Rgba, png::BitDepth::Eight) {
        return Err(format!("a file of {:?}, {:?}", info.color_type, info.bit_depth));
    }
    let mut hasher = ImageHasher::new(info.width, info.height, PixelFormat::Rgba8);
    while let Some(row) = reader.next_row().map_err(|e| e.to_string())? {
        hasher.update(row.data());
    }
    Ok(hasher.finish())
}
