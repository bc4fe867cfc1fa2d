//! Batches on their way to the transport: their tiles are coded beside rendering, the next batch while one is sent.

use crate::session::{Batch, micros};
use std::time::Instant;
use tessera_wire::{Coding, TileCoding, TileGrid, pixels, pixels::Packer};
use tokio::{
    sync::mpsc,
    task::{JoinError, spawn_blocking},
};

/// Codes `batches` and hands them on, in order, until either side is gone.
pub(crate) async fn code_batches(
    mut batches: mpsc::UnboundedReceiver<Batch>,
    coded: mpsc::Sender<Batch>,
) -> Result<(), JoinError> {
    let mut packer = Packer::default();
    while let Some(mut batch) = batches.recv().await {
        if batch.frame.coding != Coding::Raw {
            // Milliseconds of work: too long for a thread that others' pipes wait for.
            let work = move || {
                code(&mut batch, &mut packer);
                (batch, packer)
            };
            (batch, packer) = spawn_blocking(work).await?;
        }
        if coded.send(batch).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// Codes the tiles of a batch as its frame says, and completes their entries.
fn code(batch: &mut Batch, packer: &mut Packer) {
    let frame = &batch.frame;
    let Ok(grid) = TileGrid::new(frame.width, frame.height, frame.tile) else { return };
    for (entry, pixels) in batch.header.tiles.iter_mut().zip(&mut batch.pixels) {
        let begin = Instant::now();
        if frame.coding == Coding::Rounded {
            pixels::round(frame.format, pixels);
        }
        let width = grid.rect(entry.tile).map_or(0, |rect| rect.width);
        if let Some(packed) = packer.pack(frame.format, width, pixels, frame.coding) {
            *pixels = packed;
            entry.coding = TileCoding::Packed;
            // Fewer than there were.
            entry.length = pixels.len() as u32;
        }
        entry.coding_us = micros(begin.elapsed());
    }
}
