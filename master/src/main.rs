//! The `tessera` command: flags, logging, exit codes.

mod commands;

use clap::Parser;
use clap::error::ErrorKind;
use commands::{Cli, CommandError, LogArgs, LogFormat};
use std::io::IsTerminal;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    quieten_driver_layers();
    let result = Cli::try_parse().map_err(usage_error).and_then(|cli| {
        start_logging(&cli.log, cli.command.is_service())?;
        cli.run()
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            commands::say(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Keeps Mesa's layer that chooses among GPUs out of this process and those that it starts: it looks for a display, and complains on stderr
/// where there is none. `--gpu` chooses here. Who has set that layer up keeps it.
#[expect(unsafe_code, reason = "the environment is set before any other thread is there")]
fn quieten_driver_layers() {
    const OFF: &str = "NODEVICE_SELECT";
    if ["MESA_VK_DEVICE_SELECT", OFF].iter().all(|name| std::env::var_os(name).is_none()) {
        // SAFETY: nothing has been started yet, so nobody else reads or writes the environment.
        unsafe { std::env::set_var(OFF, "1") };
    }
}

/// Prints help and version as clap does; turns everything else into one line.
fn usage_error(error: clap::Error) -> CommandError {
    match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => error.exit(),
        _ => {
            let text = error.render().to_string();
            let message: Vec<_> = text
                .lines()
                .take_while(|line| !line.starts_with("Usage:"))
                .filter(|line| !line.starts_with("For more information"))
                .collect();
            let message = message.join(" ");
            let message = message.trim().trim_start_matches("error: ").trim_end();
            CommandError::Usage(format!("{message} (see --help)"))
        }
    }
}

/// Logs go to stderr: warnings, of a service what happens too, and with `-v` and `-vv` more; `RUST_LOG` decides if it is set.
fn start_logging(args: &LogArgs, is_service: bool) -> Result<(), CommandError> {
    let filter = match std::env::var("RUST_LOG") {
        Ok(filter) if !filter.is_empty() => EnvFilter::try_new(filter)
            .map_err(|e| CommandError::Usage(format!("RUST_LOG cannot be read: {e}")))?,
        _ => EnvFilter::new(match args.verbose + u8::from(is_service) {
            0 => "warn",
            1 => "warn,tessera=info,tessera_master=info,tessera_worker=info,tessera_scene=info",
            _ => "info,tessera=debug,tessera_master=debug,tessera_worker=debug,tessera_scene=debug",
        }),
    };
    let colour = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
    let logs =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(colour);
    // A full or closed stderr is no reason to stop: by default such an error is itself printed there, which panics.
    let logs = logs.log_internal_errors(false);
    match args.log_format {
        LogFormat::Text => logs.init(),
        LogFormat::Json => logs.json().init(),
    }
    Ok(())
}
