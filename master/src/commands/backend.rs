//! What renders: `--backend`, `--gpu`, `--kernel`.

use super::CommandError;
use clap::Args;
use clap::builder::NonEmptyStringValueParser;
use std::ffi::OsString;
use tessera_worker::{Backend, BackendChoice, BackendConfig, Kernel};

/// What renders on this machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct BackendArgs {
    /// What renders: a GPU, the CPU, or what is faster
    ///
    /// auto takes the GPU where there is a real one and it is the faster on a small scene, else the CPU; gpu fails where there is none.
    /// Pictures of one GPU, driver and program are equal bit for bit, and so are those of all CPUs; `tessera doctor` lists both, and
    /// `tessera compare` says how far two pictures differ.
    #[arg(long, value_name = "BACKEND", value_enum, default_value_t, help_heading = "Rendering")]
    pub backend: BackendFlag,
    /// Which GPU: its number in `tessera doctor`, or a part of its name [default: the best]
    #[arg(long, value_name = "NAME|INDEX", value_parser = NonEmptyStringValueParser::new(), help_heading = "Rendering")]
    pub gpu: Option<String>,
    /// How a CPU traces rays; the picture is the same
    #[arg(long, value_name = "KERNEL", value_enum, default_value_t, help_heading = "Rendering")]
    pub kernel: KernelChoice,
}

impl BackendArgs {
    /// Whether a GPU was asked for, so that there is nothing to do without one.
    pub fn needs_gpu(&self) -> bool {
        self.backend == BackendFlag::Gpu
    }

    /// Whether the faster one is to be chosen.
    pub fn is_auto(&self) -> bool {
        self.backend == BackendFlag::Auto
    }

    /// Asks for what `opened` is from now on.
    pub fn settle(&mut self, opened: &Backend) {
        if opened.name() == "gpu" {
            self.backend = BackendFlag::Gpu;
        } else {
            (self.backend, self.gpu) = (BackendFlag::Cpu, None);
        }
    }

    /// Checks what can be checked without looking for a device.
    pub fn check(&self) -> Result<(), CommandError> {
        match (&self.gpu, self.backend) {
            (Some(gpu), BackendFlag::Cpu) => Err(CommandError::Usage(format!(
                "--gpu {gpu}: with --backend cpu no GPU renders; leave one of them out"
            ))),
            _ => Ok(()),
        }
    }

    /// Opens what was asked for, which measures it.
    pub fn open(&self) -> Result<Backend, CommandError> {
        self.check()?;
        let choice = match self.backend {
            BackendFlag::Auto => BackendChoice::Auto,
            BackendFlag::Gpu => BackendChoice::Gpu,
            BackendFlag::Cpu => BackendChoice::Cpu,
        };
        let config = BackendConfig { choice, gpu: self.gpu.clone(), kernel: self.kernel.kernel() };
        Backend::open(&config).map_err(CommandError::failed)
    }

    /// The same as arguments, for a process that renders likewise.
    pub fn to_args(&self) -> Vec<OsString> {
        let mut args = vec!["--backend", self.backend.as_str(), "--kernel", self.kernel.as_str()];
        // In one word: a name may begin with a dash.
        let gpu = self.gpu.as_ref().map(|gpu| format!("--gpu={gpu}"));
        args.extend(gpu.as_deref());
        args.into_iter().map(Into::into).collect()
    }
}

/// `--backend`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendFlag {
    /// What is faster here
    #[default]
    Auto,
    /// A GPU, or nothing
    Gpu,
    /// The CPU
    Cpu,
}

impl BackendFlag {
    /// As it is written on a command line.
    fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
        }
    }
}

/// `--kernel`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum KernelChoice {
    /// The fastest of this machine
    #[default]
    Auto,
    /// Ray by ray
    Scalar,
    /// Eight rays at once
    Wide,
}

impl KernelChoice {
    /// What it is on this machine.
    pub fn kernel(self) -> Kernel {
        match self {
            Self::Auto => Kernel::auto(),
            Self::Scalar => Kernel::Scalar,
            Self::Wide => Kernel::wide(),
        }
    }

    /// As it is written on a command line.
    fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Scalar => "scalar",
            Self::Wide => "wide",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Flags {
        #[command(flatten)]
        backend: BackendArgs,
    }

    #[test]
    fn a_child_process_is_told_the_same() {
        for line in ["", "--backend gpu --gpu=-odd", "--backend auto --gpu 1 --kernel wide", "--backend cpu"]
        {
            let parse = |args: Vec<OsString>| {
                Flags::try_parse_from([OsString::from("x")].into_iter().chain(args))
                    .expect("it parses")
                    .backend
            };
            let first = parse(line.split_whitespace().map(Into::into).collect());
            assert_eq!(parse(first.to_args()), first, "{line}");
        }
    }

    #[test]
    fn what_is_settled_can_be_opened_again() {
        let mut args = BackendArgs { gpu: Some("none of this name".into()), ..BackendArgs::default() };
        let cpu = BackendArgs { backend: BackendFlag::Cpu, ..BackendArgs::default() };
        args.settle(&cpu.open().expect("there is a CPU"));
        assert_eq!(args, cpu);
    }

    #[test]
    fn the_cpu_has_no_gpu() {
        let args = BackendArgs { backend: BackendFlag::Cpu, gpu: Some("0".into()), ..BackendArgs::default() };
        assert!(matches!(args.open(), Err(CommandError::Usage(text)) if text.contains("--gpu 0")));
    }
}
