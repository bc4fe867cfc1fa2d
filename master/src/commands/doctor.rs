//! `tessera doctor`.

use super::progress::Progress;
use super::run::cores;
use super::{CommandError, backend::KernelChoice};
use clap::Args;
use serde::Serialize;
use std::fmt::Write;
use tessera_master::UdpBuffers;
use tessera_master::report::bytes;
use tessera_worker::{Adapter, Backend, BackendChoice, BackendConfig, adapters, free_memory};

/// How to answer.
#[derive(Debug, Args)]
#[command(
    long_about = "Say what renders here, how fast, and what is missing\n\n\
        Lists every GPU that a driver offers, also those that cannot be used, with the reason; renders a small scene on the CPU and on \
        each usable GPU, and says which of them `--backend auto` takes, and why. Looks at the kernel's buffers for UDP, over which \
        masters, workers and clients talk, and at the memory that is free. Hints say what to do about what is missing. Nothing is \
        changed. Exit code 0 if something here can render, else 1.",
    after_help = "Examples:\n\
        \x20 tessera doctor\n\
        \x20 tessera doctor --json\n\
        \x20 tessera worker --join @join.txt --backend gpu --gpu 1     the GPU that is number 1 in the list"
)]
pub struct DoctorArgs {
    /// Print one JSON object: adapters, auto, backends, udp, memory, threads, hints, can_render
    #[arg(long)]
    json: bool,
}

/// Everything that is found. The keys are for programs.
#[derive(Debug, Serialize)]
struct Diagnosis {
    version: &'static str,
    /// Every GPU, usable or not.
    adapters: Vec<AdapterLine>,
    /// What `--backend auto` takes.
    auto: BackendLine,
    /// The CPU and each usable GPU, measured.
    backends: Vec<BackendLine>,
    udp: Udp,
    memory: Memory,
    /// Threads that run at the same time.
    threads: u32,
    /// What to do about what is missing.
    hints: Vec<String>,
    can_render: bool,
}

#[derive(Debug, Serialize)]
struct AdapterLine {
    index: usize,
    name: String,
    api: String,
    driver: String,
    kind: &'static str,
    memory_bytes: Option<u64>,
    limits: serde_json::Map<String, serde_json::Value>,
    f64: bool,
    unusable: Option<String>,
}

#[derive(Debug, Serialize)]
struct BackendLine {
    /// `auto`, `cpu` or `gpu`.
    asked: &'static str,
    /// The GPU that was asked for.
    gpu: Option<usize>,
    /// What was got: `cpu` or `gpu`.
    backend: Option<&'static str>,
    numeric_class: Option<String>,
    rays_per_second: Option<u64>,
    note: Option<String>,
    error: Option<String>,
}

#[derive(Debug, Serialize)]
struct Udp {
    wanted_bytes: usize,
    send_bytes: Option<usize>,
    receive_bytes: Option<usize>,
    error: Option<String>,
}

#[derive(Debug, Serialize)]
struct Memory {
    free_bytes: Option<u64>,
}

pub fn run(args: &DoctorArgs, progress: &Progress) -> Result<(), CommandError> {
    let found = {
        let _bar = progress.step("looking at this machine");
        diagnose()
    };
    if args.json {
        super::print_json(&found)?
    } else {
        super::print_text(&found.text())?
    }
    if found.can_render {
        return Ok(());
    }
    let why = found.auto.error.unwrap_or_default();
    Err(CommandError::Failed(format!("nothing here can render: {why}")))
}

fn diagnose() -> Diagnosis {
    let adapters = adapters();
    let auto = measure("auto", BackendChoice::Auto, None);
    let mut backends = vec![measure("cpu", BackendChoice::Cpu, None)];
    let usable = adapters.iter().filter(|adapter| adapter.unusable.is_none());
    backends.extend(usable.map(|adapter| measure("gpu", BackendChoice::Gpu, Some(adapter.index))));
    let udp = match UdpBuffers::of_this_system() {
        Ok(given) => Udp { send_bytes: given.send, receive_bytes: given.receive, ..Udp::of(None) },
        Err(e) => Udp::of(Some(e.to_string())),
    };
    let memory = Memory { free_bytes: free_memory() };
    let can_render = backends.iter().any(|line| line.error.is_none());
    let hints = hints(&adapters, &backends, &udp, &memory);
    Diagnosis {
        version: env!("CARGO_PKG_VERSION"),
        adapters: adapters.into_iter().map(AdapterLine::from).collect(),
        auto,
        backends,
        udp,
        memory,
        threads: cores(),
        hints,
        can_render,
    }
}

/// Opens a backend, which measures it.
fn measure(asked: &'static str, choice: BackendChoice, gpu: Option<usize>) -> BackendLine {
    let kernel = KernelChoice::Auto.kernel();
    let none = BackendLine {
        asked,
        gpu,
        backend: None,
        numeric_class: None,
        rays_per_second: None,
        note: None,
        error: None,
    };
    match Backend::open(&BackendConfig { choice, gpu: gpu.map(|index| index.to_string()), kernel }) {
        Ok(opened) => BackendLine {
            backend: Some(opened.name()),
            numeric_class: Some(opened.numeric_class().into()),
            rays_per_second: Some(opened.speed()),
            note: Some(opened.note().into()),
            ..none
        },
        Err(e) => BackendLine { error: Some(e.to_string()), ..none },
    }
}

/// What to do about what is missing.
fn hints(adapters: &[Adapter], backends: &[BackendLine], udp: &Udp, memory: &Memory) -> Vec<String> {
    /// Room for the largest scene in the README, San Miguel, and an image.
    const SCARCE: u64 = 1 << 30;
    let mut hints = Vec::new();
    let is_real = |adapter: &&Adapter| adapter.kind != "software";
    if adapters.is_empty() {
        hints.push(
            "no GPU was found: if there is one, install its Vulkan driver (NVIDIA: the proprietary driver, in containers \
             NVIDIA_DRIVER_CAPABILITIES must name `graphics`; AMD, Intel: on Debian and Ubuntu `mesa-vulkan-drivers`) and see that \
             this user may open /dev/dri or /dev/nvidia*"
                .into(),
        );
    } else if !adapters.iter().any(|adapter| is_real(&adapter)) {
        hints.push(
            "only software drivers were found, which are slower than the CPU backend: install the Vulkan driver of the GPU, and see \
             that this user may open /dev/dri or /dev/nvidia*"
                .into(),
        );
    }
    for adapter in adapters.iter().filter(is_real) {
        if let Some(reason) = &adapter.unusable {
            hints.push(format!("{} is not used: {reason}; a newer driver may help", adapter.name));
        }
    }
    for line in backends {
        if let (Some(index), Some(error)) = (line.gpu, &line.error) {
            hints.push(format!("GPU {index} was found and does not work: {error}"));
        }
    }
    match (&udp.error, udp.are_small()) {
        (Some(error), _) => hints.push(format!(
            "UDP sockets cannot be opened ({error}): masters, workers and clients talk over UDP; `tessera render` without --master and \
             with --workers 0 needs none"
        )),
        (None, true) => hints.push(format!(
            "UDP buffers are smaller than wanted, a busy machine may send packets twice; on Linux: sysctl -w net.core.rmem_max={0} \
             net.core.wmem_max={0}",
            udp.wanted_bytes
        )),
        (None, false) => {}
    }
    if let Some(free) = memory.free_bytes.filter(|free| *free < SCARCE) {
        hints.push(format!(
            "only {} of memory are free: large scenes will be refused; end what else runs",
            bytes(free)
        ));
    }
    hints
}

impl Udp {
    fn of(error: Option<String>) -> Self {
        Self { wanted_bytes: UdpBuffers::WANTED, send_bytes: None, receive_bytes: None, error }
    }

    fn are_small(&self) -> bool {
        UdpBuffers { send: self.send_bytes, receive: self.receive_bytes }.are_small()
    }
}

impl From<Adapter> for AdapterLine {
    fn from(adapter: Adapter) -> Self {
        let Adapter { index, name, driver, api, kind, memory, limits, has_f64, unusable } = adapter;
        let limits = limits.into_iter().map(|(name, value)| (name.into(), value.into())).collect();
        Self { index, name, api, driver, kind, memory_bytes: memory, limits, f64: has_f64, unusable }
    }
}

impl Diagnosis {
    fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, t: &mut String) -> std::fmt::Result {
        writeln!(t, "tessera    {}, {} threads at a time", self.version, self.threads)?;
        if self.adapters.is_empty() {
            writeln!(t, "GPUs       none was found")?;
        }
        for adapter in &self.adapters {
            let memory = adapter.memory_bytes.map_or("memory unknown".into(), bytes);
            let f64 = if adapter.f64 { "f64" } else { "no f64" };
            let AdapterLine { index, name, api, driver, kind, .. } = adapter;
            writeln!(t, "GPU {index:<6} {name}: {kind}, {api}, driver {driver}, {memory}, {f64}")?;
            let limits = adapter.limits.iter().map(|(name, value)| format!("{name} {value}"));
            let limits: Vec<_> = limits.collect();
            if !limits.is_empty() {
                writeln!(t, "           {}", limits.join(", "))?;
            }
            if let Some(reason) = &adapter.unusable {
                writeln!(t, "           cannot be used: {reason}")?;
            }
        }
        for line in &self.backends {
            let name = line.gpu.map_or(line.asked.to_owned(), |index| format!("{} {index}", line.asked));
            line.write_text(t, &name)?;
        }
        match (&self.auto.note, &self.auto.error) {
            (Some(note), _) => {
                writeln!(t, "auto       takes the {}: {note}", self.auto.backend.unwrap_or("?"))?
            }
            (None, error) => writeln!(t, "auto       {}", error.as_deref().unwrap_or("?"))?,
        }
        let size = |size: Option<usize>| size.map_or("unknown".into(), |n| bytes(n as u64));
        match &self.udp.error {
            Some(error) => writeln!(t, "UDP        {error}")?,
            None => writeln!(
                t,
                "UDP        buffers of {} to send and {} to receive, {} wanted",
                size(self.udp.send_bytes),
                size(self.udp.receive_bytes),
                bytes(self.udp.wanted_bytes as u64)
            )?,
        }
        writeln!(t, "memory     {} free", self.memory.free_bytes.map_or("unknown".into(), bytes))?;
        self.hints.iter().try_for_each(|hint| writeln!(t, "hint       {hint}"))
    }
}

impl BackendLine {
    fn write_text(&self, t: &mut String, name: &str) -> std::fmt::Result {
        match (&self.error, self.rays_per_second, &self.numeric_class) {
            (Some(error), ..) => writeln!(t, "{name:<10} {error}"),
            (None, rays, class) => writeln!(
                t,
                "{name:<10} {:.2} million rays a second, numeric class {}",
                rays.unwrap_or(0) as f64 / 1e6,
                class.as_deref().unwrap_or("?")
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(index: usize, kind: &'static str, unusable: Option<&str>) -> Adapter {
        Adapter {
            index,
            name: format!("Chip {index}"),
            driver: "d 1".into(),
            api: "vulkan".into(),
            kind,
            memory: Some(8 << 30),
            limits: vec![("largest_buffer", 1 << 31)],
            has_f64: false,
            unusable: unusable.map(String::from),
        }
    }

    fn hints_for(adapters: &[Adapter], send: usize, free: u64) -> Vec<String> {
        let udp = Udp { send_bytes: Some(send), receive_bytes: Some(64 << 20), ..Udp::of(None) };
        hints(adapters, &[], &udp, &Memory { free_bytes: Some(free) })
    }

    #[test]
    fn hints_say_what_to_do_and_only_where_something_is_missing() {
        let (large, plenty) = (64 << 20, 64 << 30);
        assert_eq!(hints_for(&[adapter(0, "discrete", None)], large, plenty), [""; 0]);
        let says = |hints: Vec<String>, parts: &[&str]| {
            assert_eq!(hints.len(), 1, "{hints:?}");
            assert!(parts.iter().all(|part| hints[0].contains(part)), "{hints:?}");
        };
        says(hints_for(&[], large, plenty), &["no GPU", "Vulkan driver", "mesa-vulkan-drivers"]);
        says(hints_for(&[adapter(0, "software", None)], large, plenty), &["only software drivers"]);
        let old = [adapter(0, "discrete", None), adapter(1, "integrated", Some("no compute"))];
        says(hints_for(&old, large, plenty), &["Chip 1", "no compute", "newer driver"]);
        says(
            hints_for(&[adapter(0, "discrete", None)], 200_000, plenty),
            &["sysctl -w net.core.rmem_max=4194304"],
        );
        says(hints_for(&[adapter(0, "discrete", None)], large, 100 << 20), &["100.00 MiB"]);
    }

    #[test]
    fn the_text_has_a_line_for_everything() {
        let found = diagnose();
        let text =
            Diagnosis { adapters: vec![adapter(3, "discrete", Some("no compute")).into()], ..found }.text();
        for part in [
            "GPU 3      Chip 3: discrete, vulkan, driver d 1, 8.00 GiB, no f64\n",
            "           largest_buffer 2147483648\n",
            "           cannot be used: no compute\n",
            "\ncpu        ",
            "\nauto       takes the ",
            "\nUDP        ",
            "\nmemory     ",
        ] {
            assert!(text.contains(part), "{part:?} is not in {text}");
        }
    }
}
