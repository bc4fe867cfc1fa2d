//! Passes over a ray set: who takes how long, and whether all answer alike.
//!
//! Threads take chunks from a counter, and count their own CPU time. One pass warms up and is the check; then the peers alternate
//! inside each repetition, so that what else the machine does meets all of them. (The definition also turns subnormal numbers
//! off in the processor. Rust counts that as undefined behaviour, so it is left out for every peer; in voxel units there are
//! none.)

use super::clock::thread_seconds;
use super::hash::Hash;
use super::peer::Peer;
use super::ray_set::{RayKind, WorldHit, WorldRay};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Rays that a thread takes at once.
const CHUNK: usize = 4096;

/// Distances that differ by more than this, relative to the reference's, are another hit.
const DIFFERS_RELATIVE: f32 = 1e-3;

/// What one peer did with a ray set.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Rays that hit anything.
    pub hits: usize,
    /// Rays whose hit or miss, or whose distance, is not the reference's.
    pub differs: usize,
    /// Of all answers, bit for bit.
    pub hash: String,
    /// Wall seconds of each repetition, ascending.
    pub wall_s: Vec<f64>,
    /// CPU seconds of all threads together, ascending.
    pub cpu_s: Vec<f64>,
}

/// The middle of ascending values.
pub fn median(ascending: &[f64]) -> f64 {
    ascending[ascending.len() / 2]
}

/// Lets every peer trace `rays`, once to check and then `repetitions` times. Fails when twins do not answer with the same bits.
pub fn measure(
    peers: &[Box<dyn Peer>],
    kind: RayKind,
    rays: &[WorldRay],
    reference: &Answers,
    threads: usize,
    repetitions: usize,
) -> Result<Vec<Measured>, String> {
    let mut answers = Answers::new(kind, rays.len());
    let mut all: Vec<Measured> = Vec::with_capacity(peers.len());
    for peer in peers {
        answers.trace(&**peer, rays, threads);
        let hash = answers.hash();
        let twin = (0..all.len()).find(|&k| peer.twin().is_some() && peers[k].twin() == peer.twin());
        if let Some(twin) = twin.filter(|&k| all[k].hash != hash) {
            return Err(format!(
                "{} and {} do not answer {} rays with the same bits: {} and {hash}",
                peers[twin].name(),
                peer.name(),
                kind.name(),
                all[twin].hash
            ));
        }
        let (hits, differs) = (answers.hits(), answers.differs(reference));
        all.push(Measured { hits, differs, hash, wall_s: Vec::new(), cpu_s: Vec::new() });
    }
    for _ in 0..repetitions {
        for (peer, measured) in peers.iter().zip(&mut all) {
            let (wall_s, cpu_s) = answers.trace(&**peer, rays, threads);
            measured.wall_s.push(wall_s);
            measured.cpu_s.push(cpu_s);
        }
    }
    for measured in &mut all {
        measured.wall_s.sort_by(f64::total_cmp);
        measured.cpu_s.sort_by(f64::total_cmp);
    }
    Ok(all)
}

/// The answers to a ray set.
pub enum Answers {
    Closest(Vec<WorldHit>),
    Blocked(Vec<u8>),
}

impl Answers {
    /// Room for the answers to `count` rays.
    pub fn new(kind: RayKind, count: usize) -> Self {
        match kind {
            RayKind::Shadow => Self::Blocked(vec![0; count]),
            RayKind::Primary | RayKind::Diffuse => Self::Closest(vec![WorldHit::MISS; count]),
        }
    }

    /// Those of `peer`.
    pub fn of(peer: &dyn Peer, kind: RayKind, rays: &[WorldRay], threads: usize) -> Self {
        let mut answers = Self::new(kind, rays.len());
        answers.trace(peer, rays, threads);
        answers
    }

    /// Has `peer` answer anew; returns wall and CPU seconds.
    fn trace(&mut self, peer: &dyn Peer, rays: &[WorldRay], threads: usize) -> (f64, f64) {
        match self {
            Self::Closest(hits) => in_chunks(rays, hits, threads, |rays, hits| peer.closest(rays, hits)),
            Self::Blocked(blocked) => in_chunks(rays, blocked, threads, |rays, b| peer.occluded(rays, b)),
        }
    }

    fn hits(&self) -> usize {
        match self {
            Self::Closest(hits) => hits.iter().filter(|hit| hit.is_hit()).count(),
            Self::Blocked(blocked) => blocked.iter().filter(|&&b| b != 0).count(),
        }
    }

    fn differs(&self, reference: &Self) -> usize {
        let is_other = |(a, b): &(&WorldHit, &WorldHit)| {
            a.is_hit() != b.is_hit() || (a.is_hit() && (a.t - b.t).abs() > DIFFERS_RELATIVE * b.t.abs())
        };
        match (self, reference) {
            (Self::Closest(a), Self::Closest(b)) => a.iter().zip(b).filter(is_other).count(),
            (Self::Blocked(a), Self::Blocked(b)) => a.iter().zip(b).filter(|(a, b)| a != b).count(),
            _ => unreachable!("both answer the same kind of rays"),
        }
    }

    fn hash(&self) -> String {
        let mut hash = Hash::default();
        self.add_to(&mut hash);
        hash.finish()
    }

    fn add_to(&self, hash: &mut Hash) {
        match self {
            Self::Closest(hits) => hits.iter().for_each(|hit| {
                hash.add(hit.t.to_bits());
                hash.add(hit.triangle);
            }),
            Self::Blocked(blocked) => blocked.iter().for_each(|&b| hash.add(b.into())),
        }
    }
}

/// Has `threads` threads, this one among them, take chunks until none is left. Returns wall seconds, and CPU seconds of all threads.
fn in_chunks<T: Send>(
    rays: &[WorldRay],
    answers: &mut [T],
    threads: usize,
    answer: impl Fn(&[WorldRay], &mut [T]) + Sync,
) -> (f64, f64) {
    let chunks = Mutex::new(rays.chunks(CHUNK).zip(answers.chunks_mut(CHUNK)));
    let next = || chunks.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        let start = thread_seconds();
        while let Some((rays, answers)) = next() {
            answer(rays, answers);
        }
        thread_seconds() - start
    };
    let start = Instant::now();
    let cpu_s = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let mine = work();
        others.into_iter().filter_map(|other| other.join().ok()).sum::<f64>() + mine
    });
    (start.elapsed().as_secs_f64(), cpu_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::bench::clock::Cost;
    use crate::commands::bench::generate::{Kind, generate};
    use crate::commands::bench::mesh::Mesh;
    use crate::commands::bench::obvhs::Obvhs;
    use crate::commands::bench::peer::{Kernel, Ours};
    use crate::commands::bench::ray_set::{Views, ray_sets};
    use tessera_geometry::Vec3;

    const SIDE: u32 = 128;

    fn mesh(kind: Kind) -> Mesh {
        let (positions, triangles) = generate(kind, 2000);
        Mesh::new(kind.name().into(), positions, triangles)
    }

    /// Every kernel over every kind of tree of `mesh`.
    fn ours(mesh: &Mesh, is_plain: bool) -> Vec<Box<dyn Peer>> {
        let build = |refs| Ours::build(mesh, refs, is_plain, &Kernel::ALL).expect("it packs");
        (0..=2).flat_map(build).map(|peer| Box::new(peer) as Box<dyn Peer>).collect()
    }

    /// From the middle of the first pipe to its end: every ray meets long thin triangles.
    fn within_a_pipe() -> Views {
        const PIPE: usize = 132;
        let mesh = mesh(Kind::Pipes);
        let middle = |ring: &[Vec3]| ring.iter().sum::<Vec3>() / ring.len() as f32;
        let (eye, target) = (middle(&mesh.positions[..PIPE]), middle(&mesh.positions[..PIPE / 11]));
        Views::Given([eye.x, eye.y, eye.z, target.x, target.y, target.z, 60.0])
    }

    /// Hashes of what all peers answer to primary, shadow and diffuse rays of all views, whatever the number of threads.
    fn check(kind: Kind, views: Views, is_plain: bool, expected: [&str; 3]) {
        let mesh = mesh(kind);
        let peers = ours(&mesh, is_plain);
        let mut hashes: [Hash; 3] = Default::default();
        let mut hits = [0; 3];
        for view in views.of(&mesh.bounds()) {
            for (k, (kind, rays)) in ray_sets(&view, &mesh, &*peers[0], SIDE).into_iter().enumerate() {
                let reference = Answers::of(&*peers[0], kind, &rays, 1);
                for threads in [1, 3] {
                    let all = measure(&peers, kind, &rays, &reference, threads, 1).expect("twins agree");
                    assert!(all.iter().all(|m| m.hash == reference.hash() && m.differs == 0), "{kind:?}");
                }
                reference.add_to(&mut hashes[k]);
                hits[k] += reference.hits();
            }
        }
        assert!(hits.iter().all(|&h| h > 100), "{hits:?}: nothing is measured where nothing is hit");
        assert_eq!(hashes.map(|h| h.finish()), expected, "{kind:?}, plain {is_plain}: {hits:?} hits");
    }

    #[test]
    fn a_sphere_from_outside() {
        check(
            Kind::Sphere,
            Views::Orbit,
            false,
            ["b30a7e8768fb37a3", "6394daef516be3ed", "09cc93b3f92ff8f9"],
        );
        check(Kind::Sphere, Views::Orbit, true, ["2edfacb72763954b", "6394daef516be3ed", "abed79fde441bb56"]);
    }

    #[test]
    fn pipes_from_within() {
        check(
            Kind::Pipes,
            within_a_pipe(),
            false,
            ["0be1df01e9a2f8d1", "4ab4fbf9e8261d4e", "4bd474cc391964e6"],
        );
        check(
            Kind::Pipes,
            within_a_pipe(),
            true,
            ["822561fc12d2e2a8", "4ab4fbf9e8261d4e", "b7e27f1556f6574d"],
        );
    }

    #[test]
    fn obvhs_sees_the_same_mesh() {
        for (kind, views) in [(Kind::Sphere, Views::Orbit), (Kind::Pipes, within_a_pipe())] {
            let mesh = mesh(kind);
            let mut peers: Vec<Box<dyn Peer>> = vec![Box::new(Obvhs::build(&mesh).expect("it builds"))];
            peers.extend(ours(&mesh, true));
            for view in views.of(&mesh.bounds()) {
                for (kind, rays) in ray_sets(&view, &mesh, &*peers[0], SIDE) {
                    let reference = Answers::of(&*peers[0], kind, &rays, 1);
                    let all = measure(&peers, kind, &rays, &reference, 1, 1).expect("twins agree");
                    assert_eq!(all[0].differs, 0);
                    // Rays that graze an edge may go either way.
                    let most = rays.len() / 1000;
                    assert!(all.iter().all(|m| m.differs <= most), "{}, {kind:?}: {all:?}", mesh.name);
                }
            }
        }
    }

    /// Hits everything at a distance of its own.
    struct Wall(f32);

    impl Peer for Wall {
        fn name(&self) -> String {
            format!("wall at {}", self.0)
        }
        fn twin(&self) -> Option<&'static str> {
            Some("wall")
        }
        fn build_cost(&self) -> Cost {
            Cost::default()
        }
        fn accel_bytes(&self) -> u64 {
            0
        }
        fn total_bytes(&self) -> u64 {
            0
        }
        fn closest(&self, rays: &[WorldRay], hits: &mut [WorldHit]) {
            assert!(rays.len() <= CHUNK && rays.len() == hits.len());
            hits.fill(WorldHit { t: self.0, triangle: 0 });
        }
        fn occluded(&self, _: &[WorldRay], blocked: &mut [u8]) {
            blocked.fill(u8::from(self.0 > 1.0));
        }
    }

    #[test]
    fn twins_that_differ_in_one_bit_fail_the_bench() {
        let view = &Views::Given([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 60.0]).of(&mesh(Kind::Sphere).bounds())[0];
        let rays = crate::commands::bench::ray_set::primary(view, SIDE);
        let run = |far: f32, kind| {
            let peers: Vec<Box<dyn Peer>> = vec![Box::new(Wall(1.0)), Box::new(Wall(far))];
            let reference = Answers::of(&Wall(1.0), kind, &rays, 2);
            measure(&peers, kind, &rays, &reference, 2, 1)
        };
        let same = run(1.0, RayKind::Primary).expect("equal");
        assert!(same.iter().all(|m| m.hits == rays.len() && m.differs == 0 && m.cpu_s.len() == 1));
        for kind in RayKind::ALL {
            let error = run(1.0f32.next_up(), kind).expect_err("different");
            assert!(
                error.contains("wall at 1 and wall at 1.0000001") && error.contains(kind.name()),
                "{error}"
            );
        }
    }

    #[test]
    fn differing_distances_are_counted_beyond_a_thousandth() {
        let of = |t: f32| Answers::Closest(vec![WorldHit { t, triangle: 0 }]);
        assert_eq!(of(1.0009).differs(&of(1.0)), 0);
        assert_eq!(of(1.0011).differs(&of(1.0)), 1);
        assert_eq!(of(f32::INFINITY).differs(&of(f32::INFINITY)), 0);
        assert_eq!(of(1.0).differs(&of(f32::INFINITY)), 1);
        assert_eq!(Answers::Blocked(vec![0, 1]).differs(&Answers::Blocked(vec![1, 1])), 1);
    }
}
