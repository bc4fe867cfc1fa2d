//! Pixels come as they were sent: coded tiles make the picture that raw ones make, on every way and in every format.

use crate::cluster::{in_memory, job, over_quic, pack};
use crate::support::{Folder, Tessera};
use tessera_master::{Balance, Cluster, ClusterConfig, FrameBuffer, FrameJob, PixelFormat, Workers};
use tessera_wire::{Coding, pixels};

async fn cluster(workers: Workers) -> Cluster {
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack(), |_| ()).await.expect("they take the pack");
    cluster
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn coded_tiles_make_the_picture_of_raw_ones() {
    let (workers, _served) = in_memory(1);
    let mut alone = cluster(workers).await;
    let (workers, _served) = over_quic(3);
    let mut three = cluster(workers).await;
    for format in PixelFormat::ALL {
        let with =
            |balance, tile, coding| FrameJob { format, tile, coding: Some(coding), ..job(&pack(), balance) };
        let raw = alone.render(&with(Balance::Dynamic, 150, Coding::Raw), |_| ()).await.expect("it is well");
        let (width, height) = (raw.image.width(), raw.image.height());
        let mut rounded = raw.image.data().to_vec();
        pixels::round(format, &mut rounded);
        let rounded = FrameBuffer::from_rows(width, height, format, rounded).expect("as many");
        for (balance, tile) in [(Balance::Dynamic, 32), (Balance::PaperStatic, 16), (Balance::Static, 150)] {
            for (coding, expected) in
                [(Coding::Raw, &raw.image), (Coding::Lossless, &raw.image), (Coding::Rounded, &rounded)]
            {
                for cluster in [&mut alone, &mut three] {
                    let frame = cluster.render(&with(balance, tile, coding), |_| ()).await;
                    let frame = frame.expect("workers are well");
                    assert!(frame.image == *expected, "{format}, {balance}, tiles of {tile}, {coding:?}");
                    let in_image = frame.tiles.iter().filter(|tile| tile.is_first);
                    let [wire, pixels] = in_image.fold([0, 0], |[wire, pixels], tile| {
                        [wire + tile.wire_bytes, pixels + u64::from(tile.pixel_bytes)]
                    });
                    assert_eq!(pixels, expected.data().len() as u64);
                    let is_less = 4 * wire < 3 * pixels;
                    assert_eq!(is_less, coding != Coding::Raw, "{format}, {coding:?}: {wire} of {pixels}");
                }
            }
        }
    }
    alone.stop().await;
    three.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_left_to_us_is_raw_in_this_process_and_packed_at_first_elsewhere() {
    let (workers, _served) = in_memory(2);
    let mut here = cluster(workers).await;
    let (workers, _served) = over_quic(1);
    let mut elsewhere = cluster(workers).await;
    let job = job(&pack(), Balance::Dynamic);
    let frame = here.render(&job, |_| ()).await.expect("they are well");
    let same = elsewhere.render(&job, |_| ()).await.expect("it is well");
    assert_eq!((frame.coding, same.coding), (Coding::Raw, Coding::Lossless));
    assert!(frame.image == same.image);
    here.stop().await;
    elsewhere.stop().await;
}

/// The built binary: one hash for raw and lossless, another for rounded pixels, which is the same on every cluster too.
#[test]
fn the_command_says_how_pixels_travelled() {
    let folder = Folder::new();
    let render = |coding: &str, workers: &str| {
        let args = ["demo", "--size", "96x64", "--tile", "32", "--json", "--coding", coding];
        let run = Tessera::new(args).args(["--workers", workers]).within(folder.path()).run();
        let report: serde_json::Value = serde_json::from_str(&run.ok()).expect("JSON");
        (report["image_hash"].as_str().expect("a hash").to_owned(), report["pixels"].clone())
    };
    let (hash, raw) = render("raw", "0");
    assert_eq!((raw["coding"].as_str(), raw["bytes_raw"].as_u64()), (Some("raw"), Some(96 * 64 * 4)));
    let (same, packed) = render("lossless", "2");
    assert_eq!(hash, same);
    assert!(packed["ratio"].as_f64() < Some(0.7), "{packed}");
    let (auto, chosen) = render("auto", "2");
    assert_eq!((&auto, chosen["coding"].as_str()), (&hash, Some("lossless")));
    let (rounded, less) = render("rounded", "0");
    assert!(rounded != hash && less["ratio"].as_f64() < packed["ratio"].as_f64());
    assert_eq!(render("rounded", "2").0, rounded);
    Tessera::new(["demo", "--coding", "jpeg"]).within(folder.path()).run().fails(2, &["--coding", "rounded"]);
}
