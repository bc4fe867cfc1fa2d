//! Whole clusters whose workers render on a GPU.

use super::pretend::small;
use super::with_other;
use crate::cluster::{config, worker};
use tessera_master::{Balance, Cluster, ClusterConfig, FrameJob, Workers};
use tessera_worker::{Backend, BackendChoice, BackendConfig, WorkerConfig};

/// One picture on one adapter, whoever renders which tile: to the bit.
#[test]
fn a_frame_has_one_hash_for_any_number_of_workers_and_every_balancing() {
    with_other(|other| {
        let asked = BackendConfig { choice: BackendChoice::Gpu, ..BackendConfig::default() };
        if !other.is_device() {
            return println!("{}: no worker renders on it", other.name());
        }
        // Each has opened it by itself, as workers do.
        let backends: Vec<_> = (0..8).map(|_| Backend::open(&asked).expect("other tests have it")).collect();
        let backend = &backends[0];
        assert!(backend.numeric_class().starts_with("gpu-") && backend.speed() > 1, "{}", backend.note());
        let runtime = tokio::runtime::Runtime::new().expect("threads");
        let (pack, params) = small();
        let mut hashes = Vec::new();
        for (workers, balance) in (1..=8).flat_map(|count| Balance::ALL.map(|balance| (count, balance))) {
            let job = FrameJob {
                tile: if workers % 2 == 0 { 32 } else { 48 },
                samples: 2,
                depth: 4,
                seed: 7,
                balance,
                ..FrameJob::new(params.camera, params.width, params.height)
            };
            let result = runtime.block_on(async {
                let (links, served): (Vec<_>, Vec<_>) = (0..workers)
                    .map(|i| {
                        worker(WorkerConfig {
                            backend: backends[i].clone(),
                            ..config(&format!("g{i}"), None)
                        })
                    })
                    .unzip();
                let mut cluster =
                    Cluster::start(Workers::Links(links), ClusterConfig::default()).await.expect("they join");
                cluster.load(&pack, |_| ()).await.expect("the GPU holds it");
                let result = cluster.render(&job, |_| ()).await.expect("the GPU works");
                cluster.stop().await;
                for served in served {
                    served.await.expect("no panic").expect("dismissed");
                }
                result
            });
            assert_eq!(result.numeric_class(), Some(backend.numeric_class()));
            hashes.push((result.image.hash().to_string(), workers, balance));
        }
        for (hash, workers, balance) in &hashes {
            assert_eq!(hash, &hashes[0].0, "{workers} workers, {balance:?}");
        }
        println!("{}: {} frames, one hash: {}", other.name(), hashes.len(), hashes[0].0);
    });
}
