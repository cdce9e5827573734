//! Measures the upload of a large log with the real `backlot` and `backlotd`, beside a plain copy with hashing.
//!
//! `cargo build --release -p backlot-client -p backlot-server && cargo run --release -p backlot-client --example upload`
//!
//! Writes a nuScenes folder of noise in JPEG, which neither compresses nor repeats, into a temporary folder; copies and hashes it with `cp` and
//! `sha256sum`; uploads it; then uploads it to a second, empty server, kills the client in the middle and runs it again. Prints times,
//! peak memory of both processes and what was sent again; everything is removed at the end.

mod dataset;
mod programs;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Parser;

use dataset::Size;
use programs::{Server, folder_bytes, run_client, start_client};

#[derive(Parser)]
struct Arguments {
    /// Folder of `backlot` and `backlotd`.
    #[arg(long, default_value = "target/release")]
    programs: PathBuf,
    /// Where the log, its copy and two servers' data are written; four times the log's size must be free.
    #[arg(long)]
    folder: Option<PathBuf>,
    #[arg(long, default_value_t = 200)]
    frames: u32,
    #[arg(long, default_value_t = 5)]
    cameras: u32,
    /// Images of nuScenes; noise in them takes 2 MB.
    #[arg(long, default_value_t = 1600)]
    width: u32,
    #[arg(long, default_value_t = 900)]
    height: u32,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = match &arguments.folder {
        Some(folder) => tempfile::tempdir_in(folder)?,
        None => tempfile::tempdir()?,
    };
    let log = folder.path().join("log");
    let size = Size {
        frames: arguments.frames,
        cameras: arguments.cameras,
        width: arguments.width,
        height: arguments.height,
    };
    dataset::write(&log, &size)?;
    let log_bytes = folder_bytes(&log)?;
    println!(
        "log: {} frames x {} cameras, {:.1} MB",
        size.frames,
        size.cameras,
        megabytes(log_bytes)
    );
    let plain = copy_and_hash(&log, &folder.path().join("copy"))?;
    println!(
        "plain copy with hashing: {:.1} s without, {:.1} s with flushing it to the disk",
        plain.copied.as_secs_f64(),
        plain.flushed.as_secs_f64()
    );
    upload_whole(&arguments, &folder.path().join("whole"), &log, &plain)?;
    upload_cut(&arguments, &folder.path().join("cut"), &log, log_bytes)
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

struct Plain {
    copied: Duration,
    /// With the copy on stable storage, as an upload's blobs are.
    flushed: Duration,
}

/// `cp -r` and `sha256sum` of the copy. The log was just written, so that every run reads it from memory.
fn copy_and_hash(from: &Path, to: &Path) -> Result<Plain> {
    let started = Instant::now();
    let run = |program: &str, arguments: &[&str]| -> Result<()> {
        let output = Command::new(program).args(arguments).output();
        let output = output.with_context(|| format!("starting {program}"))?;
        ensure!(output.status.success(), "{program} failed: {output:?}");
        Ok(())
    };
    let (from, to) = (from.display().to_string(), to.display().to_string());
    run("cp", &["-r", &from, &to])?;
    run(
        "find",
        &[&to, "-type", "f", "-exec", "sha256sum", "{}", "+"],
    )?;
    let copied = started.elapsed();
    run("sync", &["-f", &to])?;
    let flushed = started.elapsed();
    std::fs::remove_dir_all(&to)?;
    Ok(Plain { copied, flushed })
}

fn upload_whole(arguments: &Arguments, data: &Path, log: &Path, plain: &Plain) -> Result<()> {
    let server = Server::start(&arguments.programs, data)?;
    let started = Instant::now();
    let client = run_client(&arguments.programs, server.url(), log)?;
    let took = started.elapsed();
    println!("upload: {:.1} s; {}", took.as_secs_f64(), client.said);
    if let Some(sending) = client.seconds("sent in") {
        let of = |plain: Duration| 100.0 * plain.as_secs_f64() / sending;
        println!(
            "speed of sending against the plain copy: {:.0} %, against the one that was flushed: {:.0} %; of the whole command: {:.0} %",
            of(plain.copied),
            of(plain.flushed),
            100.0 * plain.copied.as_secs_f64() / took.as_secs_f64()
        );
    }
    println!(
        "peak memory: client {:.0} MiB, server {:.0} MiB",
        client.peak_mib,
        server.peak_mib()?
    );
    server.stop()?;
    std::fs::remove_dir_all(data)?;
    Ok(())
}

/// Kills the client once half of the log is on the server, and runs it again.
fn upload_cut(arguments: &Arguments, data: &Path, log: &Path, log_bytes: u64) -> Result<()> {
    let server = Server::start(&arguments.programs, data)?;
    let mut client = start_client(&arguments.programs, server.url(), log)?;
    let held = |kind: &str| folder_bytes(&data.join(kind));
    while held("blobs")? + held("partial")? < log_bytes / 2 {
        ensure!(client.try_wait()?.is_none(), "the client ended too early");
        std::thread::sleep(Duration::from_millis(20));
    }
    client.kill()?;
    client.wait()?;
    // The server notices the cut when the connection closes.
    std::thread::sleep(Duration::from_secs(1));
    let kept = held("blobs")? + held("partial")?;
    println!(
        "killed the client with {:.1} MB on the server ({:.1} MB of them in unfinished blobs)",
        megabytes(kept),
        megabytes(held("partial")?)
    );
    let again = run_client(&arguments.programs, server.url(), log)?;
    println!("second run: {}", again.said);
    let sent = again
        .megabytes_sent()
        .context("the client says what it sent")?;
    println!(
        "sent again: {:.1} MB",
        (sent + megabytes(kept) - megabytes(log_images(log)?)).max(0.0)
    );
    println!(
        "peak memory: client {:.0} MiB, server {:.0} MiB",
        again.peak_mib,
        server.peak_mib()?
    );
    server.stop()
}

/// What is uploaded of the folder: its tables are not.
fn log_images(log: &Path) -> Result<u64> {
    folder_bytes(&log.join("samples"))
}
