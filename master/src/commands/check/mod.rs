//! `tessera check`: the hard inputs, on this machine and with everything that renders here.

mod backend;
mod case;
mod cases;
mod pack;
mod report;

use super::backend::BackendFlag;
use super::progress::Progress;
use super::{CommandError, print_json, print_text};
use backend::Renders;
use case::{Case, Effort};
use clap::builder::NonEmptyStringValueParser;
use clap::{ArgMatches, Args};
use report::Report;
use tessera_geometry::mutation::{self, Mutation};

/// What to check, and how thoroughly.
#[derive(Debug, Args)]
#[command(
    long_about = "Check that hard inputs come out right on this machine\n\n\
        Renders and traces small scenes that break careless renderers, and holds what comes out to a formula, to a test of every \
        triangle, to f64 or exact integers, or to what must not change. The CPU's kernels are asked ray by ray and eight at once; a GPU is \
        asked besides: with --backend gpu the one of --gpu, with auto what there is (with --quick a real one only: software drivers \
        take minutes to compile the kernels), with cpu none. Convergence orders are measured and printed with their 95 % confidence. \
        A case that fails does not end the others. Exit code 0 if all pass, 1 if one fails.\n\n\
        tests/HARD_INPUTS.md says what each number stands for, shared/EXACT.md what is exact and what has which bound.",
    after_help = "Examples:\n\
        \x20 tessera check --quick                    under a minute on two cores\n\
        \x20 tessera check --json > check.json        for a report of this machine\n\
        \x20 tessera check --case 14,35 --backend gpu"
)]
pub struct CheckArgs {
    /// Fewer rays and coarser meshes: under a minute on two cores
    #[arg(long)]
    quick: bool,
    /// Run these cases only, by their ids
    #[arg(long, value_name = "ID", value_delimiter = ',', value_parser = NonEmptyStringValueParser::new())]
    case: Vec<String>,
    /// Which of what renders here is checked besides the CPU
    #[arg(long, value_name = "BACKEND", value_enum, default_value_t)]
    backend: BackendFlag,
    /// Which GPU: its number in `tessera doctor`, or a part of its name [default: the best]
    #[arg(long, value_name = "NAME|INDEX", value_parser = NonEmptyStringValueParser::new())]
    gpu: Option<String>,
    /// Print one JSON object: version, machine, backends, quick, seconds, ok, cases
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    planted: Planted,
}

/// The bug that is planted, where this build can: a plain one does not know the flag.
#[derive(Debug)]
struct Planted(Option<Mutation>);

impl clap::FromArgMatches for Planted {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let name = if mutation::ARE_THERE { matches.get_one::<String>("mutation") } else { None };
        let find = |name: &String| Mutation::ALL.iter().copied().find(|m| m.name() == name);
        match name.map(|name| find(name).ok_or(name)).transpose() {
            Ok(found) => Ok(Self(found)),
            Err(name) => Err(clap::Error::raw(
                clap::error::ErrorKind::InvalidValue,
                format!("--mutation: there is none named {name}"),
            )),
        }
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Planted {
    fn augment_args(command: clap::Command) -> clap::Command {
        if !mutation::ARE_THERE {
            return command;
        }
        command.arg(clap::Arg::new("mutation").long("mutation").value_name("NAME").hide(true))
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

pub fn run(args: &CheckArgs, progress: &Progress) -> Result<(), CommandError> {
    let chosen = choose(&args.case)?;
    if let Some(mutation) = args.planted.0 {
        mutation::switch_on(mutation);
    }
    let (backends, left_out) = open_backends(args, progress)?;
    let effort = Effort { quick: args.quick };
    let report = Report::make(&chosen, &backends, left_out, effort, progress);
    if args.json {
        print_json(&report)?;
    } else {
        print_text(&report.text())?;
    }
    match report.failed() {
        0 => Ok(()),
        failed => Err(CommandError::Failed(format!("{failed} of {} cases fail", report.count()))),
    }
}

/// The cases named, or all.
fn choose(ids: &[String]) -> Result<Vec<&'static Case>, CommandError> {
    let all: Vec<&Case> = cases::ALL.iter().copied().flatten().collect();
    if ids.is_empty() {
        return Ok(all);
    }
    for id in ids {
        if !all.iter().any(|case| case.id == id) {
            let known: Vec<_> = all.iter().map(|case| case.id).collect();
            return Err(CommandError::Usage(format!(
                "--case {id}: there is no such case; there are {}",
                known.join(", ")
            )));
        }
    }
    Ok(all.into_iter().filter(|case| ids.iter().any(|id| id == case.id)).collect())
}

/// What renders here.
type Backends = Vec<Box<dyn Renders>>;

/// Everything that is checked, and what is not and why.
fn open_backends(args: &CheckArgs, progress: &Progress) -> Result<(Backends, Vec<String>), CommandError> {
    if let (BackendFlag::Cpu, Some(gpu)) = (args.backend, &args.gpu) {
        let what = format!("--gpu {gpu}: with --backend cpu no GPU is checked; leave one of them out");
        return Err(CommandError::Usage(what));
    }
    let mut backends = backend::cpus();
    let mut left_out = Vec::new();
    let _bar = (args.backend != BackendFlag::Cpu).then(|| progress.step("looking for a GPU"));
    match args.backend {
        BackendFlag::Cpu => left_out.push("GPUs: --backend cpu".into()),
        BackendFlag::Gpu => {
            backends.push(backend::gpu(args.gpu.as_deref()).map_err(CommandError::failed)?);
        }
        BackendFlag::Auto => match backend::gpu(args.gpu.as_deref()) {
            Ok(gpu) if args.quick && gpu.is_software() && args.gpu.is_none() => {
                left_out.push(format!("{}: a software driver, --quick; ask with --backend gpu", gpu.name()));
            }
            Ok(gpu) => backends.push(gpu),
            Err(e) => left_out.push(format!("GPUs: {e}")),
        },
    }
    Ok((backends, left_out))
}
