//! A run for trace viewers: the JSON object format of 'Trace Event Format' (Google), which Perfetto and Chrome read.

use super::{Placed, RunTrace, TraceTile, WorkerSpans, place};
use serde::Serialize;
use std::borrow::Cow;

/// The whole file. Viewers show `traceEvents` and skip what they do not know.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct TraceFile<'a> {
    /// In the order of `ts`.
    pub trace_events: Vec<Event>,
    /// `ms`.
    pub display_time_unit: &'static str,
    /// For people.
    pub other_data: OtherData,
    /// What was measured, for `tessera why-slow`.
    pub tessera: &'a RunTrace,
}

/// What a viewer shows beside the events.
#[derive(Debug, Serialize)]
pub struct OtherData {
    /// How far times of workers can be trusted.
    pub clocks: &'static str,
}

/// A thing that took time (`X`), or the name of a process or track (`M`).
#[derive(Debug, Serialize)]
pub struct Event {
    /// What.
    pub name: Cow<'static, str>,
    /// Kind of event.
    pub ph: &'static str,
    /// When it began, in microseconds.
    pub ts: u64,
    /// How long it took, in microseconds; of `X` alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dur: Option<u64>,
    /// The master is 0, workers count from 1.
    pub pid: usize,
    /// The track.
    pub tid: usize,
    /// More about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub args: Option<Args>,
}

/// More about an event.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Args {
    /// Of a process or track.
    Name {
        /// Its name.
        name: String,
    },
    /// Its place among others.
    Order {
        /// From the top.
        sort_index: usize,
    },
    /// Of a tile.
    Tile {
        /// Which.
        tile: u32,
        /// Times that it had been handed out before.
        attempt: u32,
        /// When it was handed out, from the frame's begin.
        assigned_us: u64,
        /// Bytes on the wire.
        wire_bytes: u64,
        /// Bytes of its pixels.
        pixel_bytes: u32,
        /// Time of coding, somewhere between rendering and sending.
        coding_us: u64,
        /// Whether another result is in the image.
        dropped: bool,
    },
}

/// Stands in every file.
const CLOCKS: &str = "Times of the master are measured. A worker's clock has another zero: its tiles lie to each other as it has measured them, \
and are moved as a whole so that the shortest ways to it and back are equally long; where that does not fit, they are cut. Nothing begins before it was \
handed out, or is sent after it came.";

/// What a worker does, a group of tracks each: several tiles may wait or travel at a time, and each then has a track. The first is from a tile's
/// hand-out, or from the end of the one before it, until it is begun.
const KINDS: [&str; 5] = ["assigned", "render", "code and wait to be sent", "transfer", "idle"];

/// Tracks of a kind that get numbers of their own.
const TRACKS: usize = 1 << 20;

impl<'a> TraceFile<'a> {
    /// Of a run that was checked.
    pub fn new(run: &'a RunTrace) -> Self {
        let mut events = Events { all: Vec::new(), lanes: vec![Default::default(); run.workers.len()] };
        let mut begin = 0;
        for (number, frame) in run.frames.iter().enumerate() {
            if frame.send_scene_us > 0 {
                events.span("send the scene", [0, 2], begin, frame.send_scene_us, None);
            }
            begin += frame.send_scene_us;
            let name = Cow::Owned(format!("frame {}", number + 1));
            events.span(name, [0, 1], begin, frame.frame_us, None);
            let spans = place(frame, &run.workers);
            for (worker, spans) in spans.iter().enumerate() {
                events.worker(worker, spans, begin, frame.frame_us, &frame.tiles);
            }
            let last = frame.tiles.iter().map(|tile| tile.received_us).max().unwrap_or(0);
            begin += frame.frame_us.max(last);
        }
        events.name(run);
        events.all.sort_by_key(|event| event.ts);
        Self {
            trace_events: events.all,
            display_time_unit: "ms",
            other_data: OtherData { clocks: CLOCKS },
            tessera: run,
        }
    }
}

struct Events {
    all: Vec<Event>,
    /// Of each worker and kind, when each track is free.
    lanes: Vec<[Vec<u64>; KINDS.len()]>,
}

impl Events {
    fn span(
        &mut self,
        name: impl Into<Cow<'static, str>>,
        [pid, tid]: [usize; 2],
        ts: u64,
        dur: u64,
        args: Option<Args>,
    ) {
        self.all.push(Event { name: name.into(), ph: "X", ts, dur: Some(dur), pid, tid, args });
    }

    /// What a worker did in a frame of `frame_us` that began at `begin`.
    fn worker(&mut self, worker: usize, spans: &WorkerSpans, begin: u64, frame_us: u64, tiles: &[TraceTile]) {
        let mut free = 0;
        for placed in &spans.tiles {
            let Placed { index, assigned, begun, rendered, sent, received } = *placed;
            // Of a whole list that was handed out at once, one tile after the other is next.
            let next = assigned.max(free).min(begun);
            let parts = [(0, next, begun), (1, begun, rendered), (2, rendered, sent), (3, sent, received)];
            for (kind, from, to) in parts {
                // What took no time would hide what did.
                if to > from || kind == 1 {
                    self.part(worker, kind, begin + from, to - from, Some(&tiles[index]));
                }
            }
            if begun > free {
                self.part(worker, 4, begin + free, begun - free, None);
            }
            free = rendered;
        }
        if frame_us > free {
            self.part(worker, 4, begin + free, frame_us - free, None);
        }
    }

    /// On the first track of its kind that is free.
    fn part(&mut self, worker: usize, kind: usize, ts: u64, dur: u64, tile: Option<&TraceTile>) {
        let lanes = &mut self.lanes[worker][kind];
        let lane = lanes.iter().position(|free| *free <= ts).unwrap_or(lanes.len());
        if lane == lanes.len() {
            lanes.push(0);
        }
        lanes[lane] = ts + dur;
        let args = tile.map(|tile| Args::Tile {
            tile: tile.tile,
            attempt: tile.attempt,
            assigned_us: tile.assigned_us,
            wire_bytes: tile.wire_bytes,
            pixel_bytes: tile.pixel_bytes,
            coding_us: tile.coding_us,
            dropped: tile.dropped,
        });
        let name = match tile {
            Some(tile) if kind == 1 => Cow::Owned(format!("tile {}", tile.tile)),
            _ => Cow::Borrowed(KINDS[kind]),
        };
        self.span(name, [worker + 1, track(kind, lane)], ts, dur, args);
    }

    /// Names every process and track.
    fn name(&mut self, run: &RunTrace) {
        let mut meta = Vec::new();
        let mut say = |name: &'static str, [pid, tid]: [usize; 2], args| {
            let name = Cow::Borrowed(name);
            meta.push(Event { name, ph: "M", ts: 0, dur: None, pid, tid, args: Some(args) });
        };
        let named = |name: &str| Args::Name { name: name.to_owned() };
        say("process_name", [0, 0], named("master"));
        say("thread_name", [0, 1], named("frames"));
        say("thread_name", [0, 2], named("scene"));
        for (worker, (about, lanes)) in run.workers.iter().zip(&self.lanes).enumerate() {
            say("process_name", [worker + 1, 0], named(&about.name));
            say("process_sort_index", [worker + 1, 0], Args::Order { sort_index: worker + 1 });
            for (kind, lane) in lanes
                .iter()
                .enumerate()
                .flat_map(|(kind, lanes)| (0..lanes.len()).map(move |lane| (kind, lane)))
            {
                let place = [worker + 1, track(kind, lane)];
                say("thread_name", place, named(KINDS[kind]));
                say("thread_sort_index", place, Args::Order { sort_index: place[1] });
            }
        }
        // Before everything that happened: the sort is stable.
        self.all.splice(0..0, meta);
    }
}

fn track(kind: usize, lane: usize) -> usize {
    1 + kind * TRACKS + lane
}
