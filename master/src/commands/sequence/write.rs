//! Files and lines of a sequence's frames, written in a thread of its own: while an image is packed, the next is rendered.

use super::CommandError;
use super::pattern::Pattern;
use crate::commands::print_text;
use crate::commands::run::Rendered;
use serde::Serialize;
use std::thread::JoinHandle;
use std::time::Duration;
use tessera_master::{OutputFile, SequenceFrame};
use tokio::sync::mpsc;

/// Images that wait for the thread.
const WAITING: usize = 2;

/// The thread that writes.
pub struct Writer {
    images: mpsc::Sender<SequenceFrame>,
    thread: JoinHandle<Result<Written, CommandError>>,
}

/// What was written.
pub struct Written {
    latencies: Vec<Duration>,
    is_json: bool,
}

/// A line a frame.
#[derive(Serialize)]
struct Line {
    frame: u64,
    file: String,
    frame_ms: f64,
    latency_ms: f64,
    hash: String,
    bytes_returned: u64,
    workers: usize,
    dropped_tiles: u64,
}

/// The last line.
#[derive(Serialize)]
struct Sum {
    frames: usize,
    skipped: u64,
    given_up: u64,
    seconds: f64,
    frames_a_second: f64,
    latency_ms_p50: f64,
    latency_ms_max: f64,
}

impl Writer {
    /// Starts it.
    pub fn start(pattern: Pattern, is_json: bool) -> Self {
        let (images, mut came) = mpsc::channel(WAITING);
        let thread = std::thread::spawn(move || {
            let mut latencies = Vec::new();
            while let Some(SequenceFrame { number, result, latency }) = came.blocking_recv() {
                let path = pattern.file(number);
                let file = OutputFile::check(&path).map_err(CommandError::failed)?;
                result.image.write(&file).map_err(CommandError::failed)?;
                let line = Line {
                    frame: number,
                    file: path.display().to_string(),
                    frame_ms: milliseconds(result.timings.frame),
                    latency_ms: milliseconds(latency),
                    hash: result.image.hash().to_string(),
                    bytes_returned: result.workers.iter().map(|worker| worker.bytes_returned).sum(),
                    workers: result.workers.len(),
                    dropped_tiles: result.dropped_tiles,
                };
                latencies.push(latency);
                print_text(&if is_json { one_line(&line)? } else { line.text() })?;
            }
            Ok(Written { latencies, is_json })
        });
        Self { images, thread }
    }

    /// Where images go.
    pub fn images(&self) -> mpsc::Sender<SequenceFrame> {
        self.images.clone()
    }

    /// Waits until all is written.
    pub fn finish(self) -> Result<Written, CommandError> {
        drop(self.images);
        let panicked = |_| CommandError::Failed("the thread that writes files has panicked".into());
        self.thread.join().map_err(panicked)?
    }
}

impl Written {
    /// Says how it went.
    pub fn print(mut self, rendered: &Rendered) -> Result<(), CommandError> {
        self.latencies.sort_unstable();
        let frames = self.latencies.len();
        let at = |place: usize| milliseconds(self.latencies.get(place).copied().unwrap_or_default());
        let seconds = rendered.took.as_secs_f64();
        let sum = Sum {
            frames,
            skipped: rendered.skipped,
            given_up: rendered.given_up,
            seconds,
            frames_a_second: frames as f64 / seconds.max(1e-9),
            latency_ms_p50: at(frames / 2),
            latency_ms_max: at(frames.saturating_sub(1)),
        };
        print_text(&if self.is_json { one_line(&sum)? } else { sum.text() })
    }
}

impl Line {
    fn text(&self) -> String {
        let Self { frame, file, frame_ms, latency_ms, hash, bytes_returned, .. } = self;
        format!(
            "frame {frame}: {frame_ms:.1} ms, {latency_ms:.1} ms from the pose, {bytes_returned} bytes returned, {hash}, {file}\n"
        )
    }
}

impl Sum {
    fn text(&self) -> String {
        let Self { frames, seconds, frames_a_second, latency_ms_p50, latency_ms_max, .. } = self;
        let mut text = format!("{frames} frames in {seconds:.2} s: {frames_a_second:.2} a second; ");
        text +=
            &format!("from pose to image {latency_ms_p50:.1} ms (median), {latency_ms_max:.1} ms at most\n");
        if self.skipped + self.given_up > 0 {
            text += &format!("{} poses were skipped, {} frames given up\n", self.skipped, self.given_up);
        }
        text
    }
}

fn one_line(value: &impl Serialize) -> Result<String, CommandError> {
    Ok(serde_json::to_string(value).map_err(CommandError::failed)? + "\n")
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}
