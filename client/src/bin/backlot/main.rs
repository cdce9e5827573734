//! Command line of Backlot.

mod args;

mod recipe;

mod output;
mod progress;

mod input;
mod inspect;

mod assets;
mod valid_region;

mod augment;
mod demo;
mod devices;
mod jobs;
mod logs;
mod tracks;

use std::io::IsTerminal;
use std::process::ExitCode;

use backlot_client::Connection;
use clap::Parser;

use args::{Arguments, Command};

#[tokio::main]
async fn main() -> ExitCode {
    let arguments = Arguments::parse();
    start_tracing();
    match Box::pin(run(arguments)).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let output = arguments.output;
    let open = async || Connection::open(&arguments.server).await;
    match arguments.command {
        Command::Logs(command) => logs::run(&open, command, output).await,
        Command::Jobs(command) => jobs::run(&open().await?, command, output).await,
        Command::Assets(command) => assets::run(&open().await?, command, output).await,
        Command::Augment(options) => augment::run(&open().await?, &options).await,
        Command::Devices => devices::run(output),
        Command::Demo(options) => demo::run(&options).await,
    }
}

/// Logs go to standard error, warnings and errors by default; `RUST_LOG` chooses otherwise.
fn start_tracing() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,tower_http=error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}
