//! Two machines: network namespaces that a cable joins, a master and a client on one, a worker on the other. The cable may be cut.

use crate::processes::hash;
use crate::support::{Folder, Live, Tessera, root, scene_folder, skipped};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};

/// Where the master listens; each pair of machines has a network of its own.
const MASTER: &str = "10.77.0.1";

/// Two namespaces and the cable. They go with the value, and with them everything in them that is not a process.
struct Machines {
    names: [String; 2],
}

impl Machines {
    /// `None`, said aloud, where namespaces cannot be made.
    fn new() -> Option<Self> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let names = ["a", "b"].map(|end| format!("tessera-{}-{number}-{end}", std::process::id()));
        if let Err(why) = ip(&format!("netns add {}", names[0])) {
            skipped(format_args!("two machines: namespaces cannot be made here ({why})"));
            return None;
        }
        let this = Self { names };
        let [a, b] = &this.names;
        let steps = [
            format!("netns add {b}"),
            format!("link add cable netns {a} type veth peer name cable netns {b}"),
            format!("-n {a} addr add {MASTER}/24 dev cable"),
            format!("-n {b} addr add 10.77.0.2/24 dev cable"),
            format!("-n {a} link set lo up"),
            format!("-n {a} link set cable up"),
            format!("-n {b} link set cable up"),
        ];
        for step in steps {
            if let Err(why) = ip(&step) {
                skipped(format_args!("two machines: `ip {step}` fails ({why})"));
                return None;
            }
        }
        Some(this)
    }

    /// A run of the built binary on machine 0 or 1.
    fn run(&self, machine: usize, args: &str) -> Tessera {
        Tessera::within_network(&self.names[machine], args.split(' '))
    }

    fn set_cable(&self, state: &str) {
        ip(&format!("-n {} link set cable {state}", self.names[1])).expect("the cable is there");
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for name in &self.names {
            // The second may not have been made.
            let _ = ip(&format!("netns del {name}"));
        }
    }
}

fn ip(args: &str) -> Result<(), String> {
    match Command::new("ip").args(args.split(' ')).output() {
        Ok(Output { status, .. }) if status.success() => Ok(()),
        Ok(Output { stderr, .. }) => Err(String::from_utf8_lossy(&stderr).trim().to_owned()),
        Err(e) => Err(e.to_string()),
    }
}

/// A master on machine 0, with its join string in `folder`, and everything to render the same frame elsewhere.
struct Site {
    // In the order in which they end.
    master: Live,
    folder: Folder,
    machines: Machines,
}

impl Site {
    /// `scenes`: where the scene file finds its sources.
    fn new(scene: &Path, scenes: &Path) -> Option<Self> {
        let machines = Machines::new()?;
        let folder = Folder::new();
        let pack = Tessera::new(["scene", "pack", "--out", "scene.tpack"]).args([scene]);
        pack.env("TESSERA_SCENES", scenes).within(folder.path()).run().ok();
        let run = machines.run(0, &format!("master --listen {MASTER}:0 --join-file join.txt -v"));
        let mut master = run.within(folder.path()).start();
        // The file is there when the line is.
        master.line();
        Some(Self { master, folder, machines })
    }

    fn worker(&mut self, machine: usize, name: &str) -> Live {
        let args = format!("worker --join @join.txt --name {name} --threads 1 --no-cache -v");
        let worker = self.machines.run(machine, &args).within(self.folder.path()).start();
        self.master.wait_for(&format!("{name} has joined"));
        worker
    }

    /// What one process makes of the scene.
    fn expected(&self, frame: &str) -> Value {
        let args = format!("render scene.tpack --out one.png --json {frame}");
        Tessera::new(args.split(' ')).within(self.folder.path()).run().json()
    }

    /// A client on the master's machine that says how far it is.
    fn client(&self, frame: &str) -> Live {
        let args = format!("render scene.tpack --out two.png --json -vv --master @join.txt {frame}");
        self.machines.run(0, &args).within(self.folder.path()).start()
    }
}

fn report(client: Live) -> Value {
    serde_json::from_str(&client.finish().ok()).expect("one JSON object")
}

/// Tiles of the image that came from `worker`, over all its connections.
fn tiles_of(report: &Value, worker: &str) -> u64 {
    let crew = report["workers"].as_array().expect("workers");
    crew.iter().filter(|w| w["name"] == worker).map(|w| w["tiles"].as_u64().expect("a number")).sum()
}

#[test]
fn sponza_is_one_image_on_one_machine_and_on_two() {
    let folder = Folder::new();
    let site = match scene_folder() {
        Some(scenes) => Site::new(&root().join("scenes/sponza.toml"), &scenes),
        None => {
            let hall = folder.write("hall.toml", "[generate]\nkind = \"hall\"\ntriangles = 100000\n");
            Site::new(&hall, folder.path())
        }
    };
    let Some(mut site) = site else { return };
    let frame = "--size 512x512 --tile 32";
    let expected = site.expected(frame);
    let workers = [site.worker(0, "near"), site.worker(1, "far")];
    for balance in ["static", "dynamic"] {
        let report = report(site.client(&format!("{frame} --balance {balance}")));
        assert_eq!(hash(&report), hash(&expected), "{balance}");
        for name in ["near", "far"] {
            assert!(tiles_of(&report, name) > 0, "{balance}: {name} has no part: {report}");
        }
    }
    drop(workers);
}

#[test]
fn a_cable_that_is_cut_in_the_middle_changes_nothing() {
    let folder = Folder::new();
    let scene = folder.write("box.toml", "[generate]\nkind = \"cornell\"\ntriangles = 2000\n");
    let Some(mut site) = Site::new(&scene, folder.path()) else { return };
    let frame = "--size 256x256 --spp 32 --tile 16 --balance paper-dynamic";
    let expected = site.expected(frame);
    let _far = site.worker(1, "far");

    // Nobody else is there: the frame waits until the worker is back, as a worker that joins late.
    let mut client = site.client(frame);
    client.wait_for("of 256 tiles");
    site.machines.set_cable("down");
    site.master.wait_for("far is gone");
    site.machines.set_cable("up");
    let alone = report(client);
    assert_eq!(hash(&alone), hash(&expected));
    assert_eq!(tiles_of(&alone, "far"), 256, "{alone}");
    assert_eq!(alone["workers"].as_array().map(Vec::len), Some(2), "it was lost and came back: {alone}");

    // A worker beside the master finishes what the other one had.
    let _near = site.worker(0, "near");
    let mut client = site.client(frame);
    client.wait_for("of 256 tiles");
    site.machines.set_cable("down");
    let both = report(client);
    assert_eq!(hash(&both), hash(&expected));
    assert!(tiles_of(&both, "near") > 0, "{both}");
}
