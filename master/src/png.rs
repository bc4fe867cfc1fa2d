//! PNG files, written row by row.

use crate::image::{ImageHash, ImageHasher, PixelFormat};
use crate::output::{OutputError, OutputFile};
use png::{BitDepth, ColorType, Compression, EncodingError, Filter};
use std::io::{self, Write};
use std::thread::JoinHandle;
use tokio::sync::mpsc;

/// A PNG file that is written while its image is rendered, by a thread of its own, which hashes the rows too.
///
/// The file appears when [`PngStream::finish`] has succeeded. If that is never called nothing is left behind.
pub struct PngStream {
    file: OutputFile,
    width: u32,
    height: u32,
    format: PixelFormat,
    /// Of the file that is being written; there is none after a failure.
    attempt: Option<Attempt>,
}

/// A thread that writes the file once.
struct Attempt {
    words: mpsc::Sender<Word>,
    thread: JoinHandle<Result<ImageHash, OutputError>>,
}

enum Word {
    /// Whole rows.
    Rows(Vec<u8>),
    /// Those were all.
    Finish,
}

impl PngStream {
    /// Rows that wait for the thread beside those that it is at: rendering goes on while a band is compressed, and a writer that is slower
    /// than the workers holds them up instead of filling the memory.
    const WAITING: usize = 1;

    /// Begins the file of an image of `width` by `height` pixels of a `format` that PNG has: 8 or 16 bits.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn begin(
        file: &OutputFile,
        width: u32,
        height: u32,
        format: PixelFormat,
    ) -> Result<Self, OutputError> {
        let attempt = Some(Attempt::start(file, width, height, format)?);
        Ok(Self { file: file.clone(), width, height, format, attempt })
    }

    /// Takes the next rows from the top, in the wire format and without padding; waits while the writer is behind.
    ///
    /// # Errors
    /// Writing has failed.
    pub async fn push(&mut self, rows: Vec<u8>) -> Result<(), OutputError> {
        let sent = match &self.attempt {
            Some(attempt) => attempt.words.send(Word::Rows(rows)).await.is_ok(),
            None => false,
        };
        if sent {
            return Ok(());
        }
        // The thread ends early for a reason.
        Err(self.end().err().unwrap_or_else(|| self.failed("no rows are taken any more")))
    }

    /// Begins the file again: what was pushed is of an image that is dropped.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn restart(&mut self) -> Result<(), OutputError> {
        // That it was not finished is what it fails with.
        let _ = self.end();
        self.attempt = Some(Attempt::start(&self.file, self.width, self.height, self.format)?);
        Ok(())
    }

    /// Puts the file in place once every row has been pushed; the image's hash.
    ///
    /// # Errors
    /// Writing has failed, or rows are missing.
    pub async fn finish(mut self) -> Result<ImageHash, OutputError> {
        if let Some(attempt) = &self.attempt {
            // A thread that takes no words has failed, and says why.
            let _ = attempt.words.send(Word::Finish).await;
        }
        self.end()
    }

    /// Waits for the thread, which ends without a word to finish too.
    fn end(&mut self) -> Result<ImageHash, OutputError> {
        let Some(Attempt { words, thread }) = self.attempt.take() else {
            return Err(self.failed("writing it has failed before"));
        };
        drop(words);
        thread.join().unwrap_or_else(|_| Err(self.failed("the thread that writes it has panicked")))
    }

    fn failed(&self, what: &str) -> OutputError {
        OutputError::Target { path: self.file.path().to_owned(), what: what.into() }
    }
}

impl Drop for PngStream {
    /// Returns when the unfinished file is gone: the process may end next.
    fn drop(&mut self) {
        if self.attempt.is_some() {
            let _ = self.end();
        }
    }
}

impl Attempt {
    fn start(file: &OutputFile, width: u32, height: u32, format: PixelFormat) -> Result<Self, OutputError> {
        let (words, mut taken) = mpsc::channel(PngStream::WAITING);
        let target = file.clone();
        let write = move || {
            let mut hasher = ImageHasher::new(width, height, format);
            let rows = std::iter::from_fn(|| match taken.blocking_recv() {
                Some(Word::Rows(rows)) => {
                    hasher.update(&rows);
                    Some(Ok(rows))
                }
                Some(Word::Finish) => None,
                None => Some(Err(io::Error::other("the image was not finished"))),
            });
            target.write(|to| write_png(width, height, format, rows, to))?;
            Ok(hasher.finish())
        };
        let thread = std::thread::Builder::new().name("png".into()).spawn(write);
        let thread = thread.map_err(|source| OutputError::Io { path: file.path().to_owned(), source })?;
        Ok(Self { words, thread })
    }
}

/// Writes an image of 8 or 16 bits whose rows come in pieces of any length, in the wire format.
pub(crate) fn write_png(
    width: u32,
    height: u32,
    format: PixelFormat,
    rows: impl IntoIterator<Item = io::Result<impl AsRef<[u8]>>>,
    to: impl Write,
) -> Result<(), EncodingError> {
    /// Bytes of a chunk of the file: twelve of them are its frame.
    const CHUNK_BYTES: usize = 1 << 18;
    let is_wide = format == PixelFormat::Rgba16;
    let mut to = Latch { to, failed: None };
    let mut encoder = png::Encoder::new(&mut to, width, height);
    encoder.set_color(ColorType::Rgba);
    encoder.set_depth(if is_wide { BitDepth::Sixteen } else { BitDepth::Eight });
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header()?;
    let mut stream = writer.stream_writer_with_size(CHUNK_BYTES)?;
    let mut swapped = Vec::new();
    for piece in rows {
        let piece = piece?;
        if !is_wide {
            stream.write_all(piece.as_ref())?;
            continue;
        }
        // PNG's samples have the large byte first.
        for part in piece.as_ref().chunks(CHUNK_BYTES) {
            swapped.clear();
            swapped.extend(part.chunks_exact(2).flat_map(|sample| [sample[1], sample[0]]));
            stream.write_all(&swapped)?;
        }
    }
    stream.finish()?;
    writer.finish()?;
    to.failed.map_or(Ok(()), |error| Err(error.into()))
}

/// A writer that remembers its first failure: the encoder lets one of its last chunk pass.
struct Latch<W> {
    to: W,
    failed: Option<io::Error>,
}

impl<W> Latch<W> {
    fn note<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        if let (Err(error), None) = (&result, &self.failed) {
            self.failed = Some(match error.raw_os_error() {
                Some(code) => io::Error::from_raw_os_error(code),
                None => io::Error::new(error.kind(), error.to_string()),
            });
        }
        result
    }
}

impl<W: Write> Write for Latch<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.to.write(bytes);
        self.note(result)
    }

    fn flush(&mut self) -> io::Result<()> {
        let result = self.to.flush();
        self.note(result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameBuffer;
    use std::path::Path;

    fn image(width: u32, height: u32, format: PixelFormat) -> FrameBuffer {
        let bytes = width as usize * height as usize * format.bytes_per_pixel();
        let data = (0..bytes).map(|i| (i * i / 7 % 251) as u8).collect();
        FrameBuffer::from_rows(width, height, format, data).unwrap()
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    /// The wire format of a PNG file, read by another crate's decoder.
    fn read(path: &Path) -> Vec<u8> {
        match image::open(path).unwrap() {
            image::DynamicImage::ImageRgba8(image) => image.into_raw(),
            image::DynamicImage::ImageRgba16(image) => {
                image.into_raw().into_iter().flat_map(u16::to_le_bytes).collect()
            }
            other => panic!("{:?}", other.color()),
        }
    }

    #[tokio::test]
    async fn a_stream_makes_the_file_and_the_hash_of_the_whole_image() {
        let folder = tempfile::tempdir().unwrap();
        for (width, height) in [(1, 1), (1, 70), (70, 1), (33, 31), (300, 200)] {
            for format in [PixelFormat::Rgba8, PixelFormat::Rgba16] {
                let image = image(width, height, format);
                let row = width as usize * format.bytes_per_pixel();
                let (whole, streamed) = (folder.path().join("whole.png"), folder.path().join("rows.png"));
                image.write(&OutputFile::check(&whole).unwrap()).unwrap();
                let file = OutputFile::check(&streamed).unwrap();
                for rows in [1, 7, 1000] {
                    let mut stream = PngStream::begin(&file, width, height, format).unwrap();
                    for band in image.data().chunks(rows * row) {
                        stream.push(band.to_vec()).await.unwrap();
                    }
                    assert_eq!(stream.finish().await.unwrap(), image.hash());
                    assert!(read(&streamed) == image.data(), "{width} x {height} {format}, {rows} rows");
                    assert!(std::fs::read(&streamed).unwrap() == std::fs::read(&whole).unwrap());
                }
            }
        }
    }

    #[tokio::test]
    async fn what_is_not_finished_leaves_nothing_and_what_begins_again_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let file = OutputFile::check(&path).unwrap();
        let image = image(50, 40, PixelFormat::Rgba8);
        let begin = || PngStream::begin(&file, 50, 40, PixelFormat::Rgba8).unwrap();
        let mut stream = begin();
        stream.push(image.data()[..2000].to_vec()).await.unwrap();
        drop(stream);
        assert!(names(folder.path()).is_empty());
        // All rows are in, but the frame has failed.
        let mut stream = begin();
        stream.push(image.data().to_vec()).await.unwrap();
        drop(stream);
        assert!(names(folder.path()).is_empty());
        let mut stream = begin();
        stream.push(image.data()[..2000].to_vec()).await.unwrap();
        let error = stream.finish().await.unwrap_err().to_string();
        assert!(error.contains("a.png") && error.lines().count() == 1, "{error}");
        assert!(names(folder.path()).is_empty());

        let mut stream = begin();
        stream.push(vec![9; 2000]).await.unwrap();
        stream.restart().unwrap();
        stream.push(image.data().to_vec()).await.unwrap();
        assert_eq!(stream.finish().await.unwrap(), image.hash());
        assert!(read(&path) == image.data());
        assert_eq!(names(folder.path()), ["a.png"]);
    }

    #[test]
    fn a_disk_that_fills_up_is_noticed_wherever_it_does() {
        /// Takes so many bytes.
        struct Small(usize);
        impl Write for Small {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                if bytes.len() > self.0 {
                    return Err(io::ErrorKind::StorageFull.into());
                }
                self.0 -= bytes.len();
                Ok(bytes.len())
            }

            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let image = image(40, 30, PixelFormat::Rgba8);
        let write = |to: &mut dyn Write| write_png(40, 30, PixelFormat::Rgba8, [Ok(image.data())], to);
        let mut file = Vec::new();
        write(&mut file).unwrap();
        for room in 0..file.len() {
            assert!(write(&mut Small(room)).is_err(), "{room} of {} bytes", file.len());
        }
        assert!(write(&mut Small(file.len())).is_ok());
    }
}
