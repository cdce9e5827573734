//! `backlotd`: the Backlot service as a process.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use backlot_server::config::{Config, RawConfig};
use backlot_server::server::Server;
use backlot_server::telemetry;
use clap::Parser;

/// Serves a library of driving assets: takes driving logs, trains radiance fields and renders labelled scenes over gRPC.
///
/// BACKLOT_LOG filters the log on standard error (e.g. "debug"), BACKLOT_LOG_FORMAT=json makes it JSON.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// Folder of everything that is kept; made if it is missing.
    #[arg(long, value_name = "DIR")]
    data_dir: Option<PathBuf>,
    /// Address and port of the gRPC listener; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Jobs that run at once [default: 1]
    #[arg(long, value_name = "N")]
    workers: Option<usize>,
    /// Engine threads; 0 means one a core [default: 0]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// What renders: auto, cpu, gpu, gpu:NUMBER or gpu:NAME as `backlot devices` lists them; auto never takes a software
    /// adapter [default: auto]
    #[arg(long, value_name = "DEVICE")]
    device: Option<String>,
    /// TOML file with the same values and the limits; the command line wins.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl Args {
    fn config(self) -> anyhow::Result<Config> {
        let file = match &self.config {
            Some(path) => RawConfig::read(path)?,
            None => RawConfig::default(),
        };
        let line = RawConfig {
            data_dir: self.data_dir,
            listen: self.listen,
            workers: self.workers,
            threads: self.threads,
            device: self.device,
            ..RawConfig::default()
        };
        Ok(line.over(file).check()?)
    }
}

fn main() -> ExitCode {
    telemetry::init();
    match Args::parse().config().and_then(run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("backlotd: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(config: Config) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .thread_name("rpc")
        .build()
        .context("start the runtime")?;
    let grace = config.drain_grace;
    let outcome = runtime.block_on(async {
        let mut server = Server::start(config).await?;
        // The one line on standard output, for whoever asked for port 0.
        println!("listening on {}", server.local_addr());
        tokio::select! {
            error = server.failed() => return Err(error.into()),
            signal = stop_signal() => tracing::info!(signal = signal?, "stopping"),
        }
        server.shutdown(grace).await;
        anyhow::Ok(())
    });
    // Work that outlived the grace is left: the next start takes it up.
    runtime.shutdown_background();
    outcome
}

#[cfg(unix)]
async fn stop_signal() -> anyhow::Result<&'static str> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate()).context("listen for SIGTERM")?;
    let mut interrupt = signal(SignalKind::interrupt()).context("listen for SIGINT")?;
    Ok(tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "SIGINT",
    })
}

#[cfg(not(unix))]
async fn stop_signal() -> anyhow::Result<&'static str> {
    tokio::signal::ctrl_c().await.context("listen for ctrl-c")?;
    Ok("ctrl-c")
}
