//! Pictures that are true: made by the oracle, kept for the next time.

use super::CommandError;
use super::progress::Progress;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use tessera_master::compare::Picture;
use tessera_master::{FrameBuffer, PixelFormat};
use tessera_oracle::{Key, Oracle, OracleImage, Reference, ReferenceError, View};
use tessera_scene::{Scene, Without};

/// Where true pictures are kept.
#[derive(Clone, Debug)]
pub struct References {
    folder: Option<PathBuf>,
}

impl References {
    /// In `folder`, which is made if it is not there, or where a desktop keeps what can be had again.
    pub fn open(folder: Option<&Path>) -> Result<Self, CommandError> {
        if let Some(folder) = folder {
            std::fs::create_dir_all(folder).map_err(|e| {
                let folder = folder.display();
                CommandError::Failed(format!("--references {folder}: {e}; name a folder that can be written"))
            })?;
            return Ok(Self { folder: Some(folder.to_owned()) });
        }
        let folder =
            super::cache_folder("references").filter(|folder| match std::fs::create_dir_all(folder) {
                Ok(()) => true,
                Err(e) => {
                    tracing::warn!("true pictures are not kept: {}: {e}", folder.display());
                    false
                }
            });
        Ok(Self { folder })
    }
}

/// A scene whose true pictures may be asked for.
pub struct Truths {
    oracle: Oracle,
    references: References,
}

impl Truths {
    /// Of `scene`, with what is left out `without` some features.
    pub fn new(
        scene: &Scene,
        without: Without,
        references: References,
        progress: &Progress,
    ) -> Result<Self, CommandError> {
        let _bar = progress.step("preparing the oracle");
        let oracle = Oracle::new(scene, without).map_err(CommandError::failed)?;
        Ok(Self { oracle, references })
    }

    /// What `view` shows: as it was kept, or else made now and kept.
    pub fn picture(&self, view: &View, progress: &Progress) -> Result<Picture, CommandError> {
        view.check().map_err(CommandError::usage)?;
        let key = Key { scene: self.oracle.content_hash(), without: self.oracle.without(), view: *view };
        let Some(folder) = &self.references.folder else {
            return as_picture(&self.render(view, progress));
        };
        let path = Reference::path_in(folder, &key);
        match Reference::load(&path, &key) {
            Ok(kept) => {
                tracing::info!("true picture read from {}", path.display());
                return as_picture(&kept.image);
            }
            Err(ReferenceError::Missing { .. }) => (),
            // Whatever has happened to the file, the picture can be had again.
            Err(error) => tracing::warn!("{error}; making it again"),
        }
        let made = Reference { key, image: self.render(view, progress) };
        if let Err(error) = made.save(&path) {
            tracing::warn!("the true picture is not kept: {error}");
        }
        as_picture(&made.image)
    }

    /// Triangles of the scene as its file states it.
    pub fn triangles(&self) -> usize {
        self.oracle.triangles()
    }

    fn render(&self, view: &View, progress: &Progress) -> OracleImage {
        let bar = progress.parts("rendering the true picture");
        let done = AtomicU32::new(0);
        let on_row = |_| bar.set((done.fetch_add(1, Ordering::Relaxed) + 1).into(), view.height.into());
        self.oracle.render(view, on_row)
    }
}

/// The same as what a frame of layers is compared as.
fn as_picture(image: &OracleImage) -> Result<Picture, CommandError> {
    let buffer = FrameBuffer::from_rows(image.width, image.height, PixelFormat::Layers, image.to_layers());
    Ok(Picture::from_frame(&buffer.map_err(CommandError::failed)?))
}
