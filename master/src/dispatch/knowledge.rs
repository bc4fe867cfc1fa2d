//! What frames before have shown: what places of the image cost, how fast workers are, what the link to them is like.

use std::{collections::BTreeMap, time::Duration};
use tessera_wire::{Camera, Features, Frame, PackId, Sampling, TileGrid, TileId, WorkerId};

/// What is known when a frame begins. Pure: the cluster tells it what it measures.
#[derive(Clone, Debug, Default)]
pub struct Knowledge {
    /// Of what costs, bytes and trials are.
    look: Option<Look>,
    costs: Option<CostMap>,
    /// Speeds of those that have rendered, 1 on the average.
    speeds: BTreeMap<WorkerId, f64>,
    /// The last ones, and the shortest.
    round_trips: BTreeMap<WorkerId, (Duration, Duration)>,
    /// Bytes a second of batches that came unhindered, and bytes of a frame on the wire.
    rate: Option<f64>,
    frame_bytes: f64,
    /// What `auto` has tried, and how that went.
    pub(super) trials: super::auto::Trials,
}

/// What decides, beside the camera, what a place of an image costs: frames that differ in it say nothing of each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    pack: PackId,
    samples: u32,
    sampling: Sampling,
    depth: u32,
    features: Features,
}

impl From<&Frame> for Look {
    fn from(frame: &Frame) -> Self {
        let Frame { pack, samples, sampling, depth, features, .. } = *frame;
        Self { pack, samples, sampling, depth, features }
    }
}

/// A result as far as it tells of costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    /// Which tile.
    pub tile: TileId,
    /// Who rendered it.
    pub worker: WorkerId,
    /// How long that took.
    pub render: Duration,
}

/// A frame that is over.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// From where it was seen.
    pub camera: &'a Camera,
    /// Its tiles.
    pub grid: &'a TileGrid,
    /// All of its results.
    pub shown: &'a [Shown],
    /// Who took part.
    pub crew: &'a [WorkerId],
    /// From its begin to its last tile.
    pub took: Duration,
    /// What came for it.
    pub wire_bytes: u64,
    /// How `auto` has handed it out, if it has.
    pub way: Option<usize>,
}

impl Knowledge {
    /// How much a new measurement of a speed counts beside what was known.
    const SPEED_GAIN: f64 = 0.5;

    /// A worker whose speed has changed by such a factor is another one: what was known of it says nothing.
    const SPEED_JUMP: f64 = 1.5;

    /// A frame of this look begins: what is known of others is forgotten, all but workers and links.
    pub fn look_at(&mut self, look: Look) {
        if self.look != Some(look) {
            (self.look, self.costs, self.frame_bytes) = (Some(look), None, 0.0);
            self.trials = super::auto::Trials::default();
        }
    }

    /// Whether frames of this look say something of the next one.
    pub fn is_of(&self, look: Look) -> bool {
        self.look == Some(look)
    }

    /// A round trip to `worker` takes so long now.
    pub fn round_trip(&mut self, worker: WorkerId, time: Duration) {
        let (last, shortest) = self.round_trips.entry(worker).or_insert((time, time));
        (*last, *shortest) = (time, time.min(*shortest));
    }

    /// A batch of `bytes` came within `time` from the word that announced it. The fastest counts: others shared the link, or waited for a
    /// window to open.
    pub fn transfer(&mut self, bytes: u64, time: Duration) {
        /// Below that it is the round trip that is measured.
        const LEAST_BYTES: u64 = 4096;
        /// By so much a rate fades with each batch, so that a link that has become slow is noticed within a few hundred.
        const FADES: f64 = 0.995;
        if bytes >= LEAST_BYTES && !time.is_zero() {
            let rate = bytes as f64 / time.as_secs_f64();
            self.rate = Some(self.rate.map_or(rate, |best| rate.max(FADES * best)));
        }
    }

    /// How long the link takes for what one of `workers` returns of a frame.
    pub fn batch_time(&self, workers: usize) -> Duration {
        let share = self.frame_bytes / workers.max(1) as f64;
        let seconds = self.rate.map_or(0.0, |rate| share / rate);
        Duration::try_from_secs_f64(seconds).unwrap_or_default()
    }

    /// `worker` is gone for good.
    pub fn forget(&mut self, worker: WorkerId) {
        self.speeds.remove(&worker);
        self.round_trips.remove(&worker);
    }

    /// Of a worker; zero while nothing is known.
    pub fn round_trip_of(&self, worker: WorkerId) -> Duration {
        self.round_trips.get(&worker).map_or(Duration::ZERO, |(last, _)| *last)
    }

    /// Of a worker, the shortest that was ever measured: what the way takes while nothing stands in a queue. None while nothing is known, or in
    /// this process.
    pub fn shortest_round_trip_of(&self, worker: WorkerId) -> Option<Duration> {
        self.round_trips.get(&worker).map(|(_, shortest)| *shortest).filter(|time| !time.is_zero())
    }

    /// Of a worker; the average while nothing is known.
    pub fn speed_of(&self, worker: WorkerId) -> f64 {
        self.speeds.get(&worker).copied().unwrap_or(1.0)
    }

    /// Whether tiles have shown what they cost.
    pub fn has_costs(&self) -> bool {
        self.costs.is_some()
    }

    /// Seconds that each tile of a frame costs a worker of speed 1; none while nothing is known.
    pub fn costs(&self, camera: &Camera, grid: &TileGrid) -> Option<Vec<f32>> {
        self.costs.as_ref().map(|map| map.seen_from(camera, grid))
    }

    /// A frame is over that `crew` took part in: learns from its results, its bytes on the wire, and the time that it took in the `way` that
    /// `auto` had chosen, if it had.
    pub fn learn(&mut self, seen: &Seen<'_>) {
        let Seen { camera, grid, shown, .. } = *seen;
        let shown: Vec<_> = shown.iter().filter(|s| s.tile.0 < grid.tiles()).copied().collect();
        if shown.is_empty() {
            return;
        }
        // A frame that was handed out without knowing what its tiles cost says nothing of the way in which it was.
        let had_costs = self.has_costs();
        self.learn_speeds(&shown, self.costs(camera, grid).as_deref());
        let mut sums = vec![(0.0, 0u32); grid.tiles() as usize];
        for result in &shown {
            let (sum, count) = &mut sums[result.tile.0 as usize];
            *sum += result.render.as_secs_f64() * self.speed_of(result.worker);
            *count += 1;
        }
        let density = |(tile, &(sum, count)): (usize, &(f64, u32))| {
            let pixels =
                grid.rect(TileId(tile as u32)).map_or(1.0, |r| f64::from(r.width) * f64::from(r.height));
            (count > 0).then(|| (sum / f64::from(count) / pixels) as f32)
        };
        let known: Vec<_> = sums.iter().enumerate().map(density).collect();
        let (sum, count) = known.iter().flatten().fold((0.0, 0u32), |(s, n), d| (s + f64::from(*d), n + 1));
        let mean = (sum / f64::from(count.max(1))) as f32;
        let densities = known.into_iter().map(|density| density.unwrap_or(mean)).collect();
        self.costs = Some(CostMap { camera: *camera, grid: *grid, densities, mean });
        self.frame_bytes = seen.wire_bytes as f64;
        if let Some(way) = seen.way.filter(|_| had_costs) {
            let speeds: f64 = seen.crew.iter().map(|&worker| self.speed_of(worker)).sum();
            let work: f64 = self.costs(camera, grid).into_iter().flatten().map(f64::from).sum();
            if work > 0.0 && speeds > 0.0 {
                let ratio = seen.took.as_secs_f64() * speeds / work;
                self.trials.note(way, seen.crew.len(), grid.tiles(), ratio);
            }
        }
    }

    /// Side of the tiles of the last frame and what they have cost a worker of speed 1 on the average.
    pub fn mean_tile(&self) -> Option<(u32, Duration)> {
        let map = self.costs.as_ref()?;
        let side = f64::from(map.grid.tile());
        let cost = Duration::try_from_secs_f64(f64::from(map.mean) * side * side).ok()?;
        Some((map.grid.tile(), cost))
    }

    /// The work that a worker has done, by what it was known to cost, over the time that it took: its speed. While nothing is known of
    /// costs, all tiles count the same.
    ///
    /// Costs and speeds are known up to a common factor. It is kept: on the average, those of whom something was known are as fast as before.
    /// A frame that slow ones alone have rendered must not make these the measure of all.
    fn learn_speeds(&mut self, shown: &[Shown], costs: Option<&[f32]>) {
        let mut sums = BTreeMap::<WorkerId, (f64, f64)>::new();
        for result in shown {
            let cost = costs.map_or(1.0, |costs| f64::from(costs[result.tile.0 as usize]));
            let (work, time) = sums.entry(result.worker).or_default();
            *work += cost;
            *time += result.render.as_secs_f64();
        }
        let rates: Vec<_> = sums
            .into_iter()
            .filter(|(_, (work, time))| *work > 0.0 && *time > 0.0)
            .map(|(worker, (work, time))| (worker, work / time))
            .collect();
        let known = rates.iter().filter_map(|(worker, rate)| Some((self.speeds.get(worker)?, rate)));
        let (before, now) = known.fold((0.0, 0.0), |(b, n), (before, rate)| (b + before, n + rate));
        let unit = if now > 0.0 {
            now / before
        } else if costs.is_some() {
            1.0
        } else {
            rates.iter().map(|(_, rate)| rate).sum::<f64>() / rates.len().max(1) as f64
        };
        for (worker, rate) in rates {
            let now = rate / unit;
            let speed = self.speeds.entry(worker).or_insert(now);
            let jump = (now / *speed).max(*speed / now);
            *speed = if jump > Self::SPEED_JUMP { now } else { *speed + Self::SPEED_GAIN * (now - *speed) };
        }
    }
}

/// What places of an image cost, seen from somewhere.
#[derive(Clone, Debug)]
struct CostMap {
    camera: Camera,
    grid: TileGrid,
    /// By tile, seconds a pixel of a worker of speed 1.
    densities: Vec<f32>,
    mean: f32,
}

impl CostMap {
    /// What the tiles of another frame cost: each is looked up at some of its points, in the direction in which they were seen before. That is
    /// exact for a camera that turns; one that moves sees near things elsewhere, and the estimate is as good as they are far. What was
    /// outside of the image costs the mean.
    fn seen_from(&self, camera: &Camera, grid: &TileGrid) -> Vec<f32> {
        let rects = (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile)));
        let pixels = |rect: &tessera_wire::Rect| rect.width as f32 * rect.height as f32;
        if camera == &self.camera && grid == &self.grid {
            return rects.zip(&self.densities).map(|(rect, density)| density * pixels(&rect)).collect();
        }
        // Four points along a side of a tile that may be of several sizes smaller than those before; fewer where that takes longer than it gains.
        let points = if grid.tiles() > 4096 { 2 } else { 4 };
        let (width, height) = grid.size();
        let mean_of = |rect: tessera_wire::Rect| {
            let mut sum = 0.0;
            for j in 0..points {
                for i in 0..points {
                    let at = |first: u32, length: u32, k: u32| {
                        first as f32 + length as f32 * (k as f32 + 0.5) / points as f32
                    };
                    let u = 2.0 * at(rect.x, rect.width, i) / width as f32 - 1.0;
                    let v = 1.0 - 2.0 * at(rect.y, rect.height, j) / height as f32;
                    sum += self.density_towards(camera, u, v);
                }
            }
            sum / (points * points) as f32
        };
        rects.map(|rect| mean_of(rect) * pixels(&rect)).collect()
    }

    /// Of the point (u, v) in [-1, 1]^2 of `camera`'s image.
    fn density_towards(&self, camera: &Camera, u: f32, v: f32) -> f32 {
        let direction: [f32; 3] =
            std::array::from_fn(|axis| camera.forward[axis] + u * camera.right[axis] + v * camera.up[axis]);
        let dot = |a: &[f32; 3], b: &[f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let Camera { forward, right, up, .. } = &self.camera;
        let depth = dot(&direction, forward) / dot(forward, forward);
        if depth.is_nan() || depth <= 0.0 {
            return self.mean;
        }
        let u = dot(&direction, right) / dot(right, right) / depth;
        let v = dot(&direction, up) / dot(up, up) / depth;
        if !(u.abs() <= 1.0 && v.abs() <= 1.0) {
            return self.mean;
        }
        let (width, height) = self.grid.size();
        let place = |t: f32, length: u32| {
            let pixel = ((t + 1.0) * 0.5 * length as f32) as u32;
            pixel.min(length - 1) / self.grid.tile()
        };
        let (column, row) = (place(u, width), place(-v, height));
        self.densities[(row * self.grid.columns() + column) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(yaw: f32) -> Camera {
        let (sin, cos) = (libm::sinf(yaw), libm::cosf(yaw));
        Camera { origin: [0.0; 3], forward: [sin, 0.0, -cos], right: [cos, 0.0, sin], up: [0.0, 1.0, 0.0] }
    }

    /// Tile `t` of `grid` takes `worker_of(t)` the seconds `cost(t)` over the speed of that worker.
    fn shown(grid: &TileGrid, cost: impl Fn(u32) -> f64, speeds: &[f64]) -> Vec<Shown> {
        let result = |tile: u32| {
            let worker = tile as usize % speeds.len();
            let render = Duration::from_secs_f64(cost(tile) / speeds[worker]);
            Shown { tile: TileId(tile), worker: WorkerId(worker as u32), render }
        };
        (0..grid.tiles()).map(result).collect()
    }

    fn learn(known: &mut Knowledge, grid: &TileGrid, shown: &[Shown]) {
        let camera = camera(0.0);
        let (crew, took) = (&[], Duration::ZERO);
        known.learn(&Seen { camera: &camera, grid, shown, crew, took, wire_bytes: 0, way: None });
    }

    #[test]
    fn speeds_and_costs_come_apart_within_a_few_frames() {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let speeds = [0.4, 1.0, 1.6];
        let cost = |tile: u32| f64::from(1 + tile * 7919 % 13) / 100.0;
        let mut known = Knowledge::default();
        for _ in 0..8 {
            learn(&mut known, &grid, &shown(&grid, cost, &speeds));
        }
        let ratio = known.speed_of(WorkerId(2)) / known.speed_of(WorkerId(0));
        // Each was seen with other tiles, and always the same: what is left is a common error of its speed and of their costs, which
        // comes to the same time.
        assert!((ratio - 4.0).abs() < 1.0, "{ratio}");
        let costs = known.costs(&camera(0.0), &grid).unwrap();
        for result in shown(&grid, cost, &speeds) {
            let expected = f64::from(costs[result.tile.0 as usize]) / known.speed_of(result.worker);
            assert!((expected / result.render.as_secs_f64() - 1.0).abs() < 0.02, "{result:?}: {expected}");
        }
        assert_eq!(known.speed_of(WorkerId(9)), 1.0, "nothing is known of it");
        known.forget(WorkerId(0));
        assert_eq!(known.speed_of(WorkerId(0)), 1.0);
    }

    #[test]
    fn groups_that_render_by_turns_are_measured_alike() {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let mut known = Knowledge::default();
        learn(&mut known, &grid, &shown(&grid, |_| 0.01, &[1.0, 1.0, 0.25, 0.25]));
        for turn in 0..6 {
            let mut results = shown(&grid, |_| 0.01, if turn % 2 == 0 { &[1.0; 2] } else { &[0.25; 2] });
            results.iter_mut().for_each(|result| result.worker.0 += 2 * (turn % 2));
            learn(&mut known, &grid, &results);
        }
        let ratio = known.speed_of(WorkerId(0)) / known.speed_of(WorkerId(2));
        assert!((ratio - 4.0).abs() < 0.01, "{ratio}");
        // One that nobody knows is measured by what tiles are known to cost.
        let mut results = shown(&grid, |_| 0.01, &[0.5]);
        results.iter_mut().for_each(|result| result.worker.0 = 9);
        learn(&mut known, &grid, &results);
        let ratio = known.speed_of(WorkerId(0)) / known.speed_of(WorkerId(9));
        assert!((ratio - 2.0).abs() < 0.01, "{ratio}");
    }

    #[test]
    fn what_another_look_has_shown_is_forgotten() {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let look = |samples| Look {
            pack: PackId([1; 32]),
            samples,
            sampling: Sampling::default(),
            depth: 8,
            features: Features::default(),
        };
        let mut known = Knowledge::default();
        known.look_at(look(1));
        learn(&mut known, &grid, &shown(&grid, |_| 0.01, &[1.0, 0.5]));
        known.look_at(look(1));
        assert!(known.has_costs() && known.is_of(look(1)) && !known.is_of(look(64)));
        known.look_at(look(64));
        assert!(!known.has_costs() && known.mean_tile().is_none());
        let ratio = known.speed_of(WorkerId(0)) / known.speed_of(WorkerId(1));
        assert!((ratio - 2.0).abs() < 0.01, "workers are the same: {ratio}");
    }

    #[test]
    fn a_worker_that_slows_down_is_believed_at_once() {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let mut known = Knowledge::default();
        for _ in 0..4 {
            learn(&mut known, &grid, &shown(&grid, |_| 0.01, &[1.0; 4]));
        }
        learn(&mut known, &grid, &shown(&grid, |_| 0.01, &[1.0, 0.25, 1.0, 1.0]));
        let ratio = known.speed_of(WorkerId(0)) / known.speed_of(WorkerId(1));
        assert!((ratio - 4.0).abs() < 0.5, "{ratio}");
    }

    #[test]
    fn costs_follow_a_camera_that_turns() {
        // The right half costs ten times as much.
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let cost = |tile: u32| if tile % 8 >= 4 { 0.010 } else { 0.001 };
        let mut known = Knowledge::default();
        assert_eq!(known.costs(&camera(0.0), &grid), None);
        learn(&mut known, &grid, &shown(&grid, cost, &[1.0]));
        // Half the opening angle of 90 degrees to the right: its border is at the left of the image now.
        let turned = known.costs(&camera(std::f32::consts::FRAC_PI_4), &grid).unwrap();
        assert!((turned[0] - 0.010).abs() < 1e-4, "{turned:?}");
        // What was behind the old border is unknown.
        assert!((turned[7] - 0.0055).abs() < 1e-4, "{turned:?}");
        // Turned away, nothing is known.
        let away = known.costs(&camera(std::f32::consts::PI), &grid).unwrap();
        assert!(away.iter().all(|cost| (cost - 0.0055).abs() < 1e-4));
        // Other tiles, the same view: the same sum.
        let small = TileGrid::new(64, 64, 4).unwrap();
        let costs = known.costs(&camera(0.0), &small).unwrap();
        assert!((costs.iter().sum::<f32>() - 64.0 * 0.0055).abs() < 1e-3);
        assert!((costs[15] - 0.0025).abs() < 1e-5);
    }
}
