//! Finding and running the programs under test.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::SystemTime;

/// What a program left behind.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// A command that runs the server.
pub fn backlotd() -> Command {
    Command::new(program("backlotd"))
}

/// A command that runs the client with `arguments` against `server_url`, without the caller's environment of it.
pub fn backlot(server_url: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(program("backlot"));
    command
        .arg("--server")
        .arg(server_url)
        .args(arguments)
        .env_remove("BACKLOT_SERVER")
        .stdin(Stdio::null());
    command
}

/// Runs to the end.
///
/// # Panics
/// If the program cannot be started.
pub fn finish(command: &mut Command) -> Finished {
    let Output {
        status,
        stdout,
        stderr,
    } = command.output().expect("the program starts");
    Finished {
        code: status.code(),
        stdout: String::from_utf8_lossy(&stdout).into_owned(),
        stderr: String::from_utf8_lossy(&stderr).into_owned(),
    }
}

impl Finished {
    /// # Panics
    /// If the program did not succeed; shows what it said.
    pub fn succeeded(self) -> Self {
        assert_eq!(
            self.code,
            Some(0),
            "stdout:\n{}\nstderr:\n{}",
            self.stdout,
            self.stderr
        );
        self
    }
}

/// Path of a program of this workspace, beside the running test. Cargo builds it for `cargo test --workspace`; where it is missing
/// or older than the sources (a run of this crate's tests alone), it is built here.
fn program(name: &str) -> PathBuf {
    static FRESH: OnceLock<()> = OnceLock::new();
    let test = std::env::current_exe().expect("a running test has a path");
    let folder = test
        .parent()
        .and_then(Path::parent)
        .expect("tests lie in target/<profile>/deps");
    let path = |name: &str| folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    FRESH.get_or_init(|| {
        let built = ["backlot", "backlotd"].map(|name| modified(&path(name)));
        let stale = built
            .iter()
            .any(|built| built.is_none_or(|built| built < newest_source()));
        if stale {
            build(folder);
        }
    });
    path(name)
}

fn build(folder: &Path) {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(workspace()).args([
        "build",
        "--quiet",
        "-p",
        "backlot-server",
        "-p",
        "backlot-client",
        "--bins",
    ]);
    cargo.env(
        "CARGO_TARGET_DIR",
        folder
            .parent()
            .expect("a profile lies in the target folder"),
    );
    if folder.ends_with("release") {
        cargo.arg("--release");
    }
    assert!(
        cargo.status().expect("cargo starts").success(),
        "the programs do not build"
    );
}

/// Root of the workspace.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the crate lies in the workspace")
        .to_owned()
}

/// Time of the last change to what the programs are made of.
fn newest_source() -> SystemTime {
    let mut folders: Vec<PathBuf> = [
        "proto",
        "shaders/src",
        "shaders/wgsl",
        "engine/src",
        "migrations/src",
        "server/src",
        "client/src",
    ]
    .map(|folder| workspace().join(folder))
    .into();
    let mut newest = SystemTime::UNIX_EPOCH;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if let Some(modified) = modified(&path) {
                newest = newest.max(modified);
            }
        }
    }
    newest
}

fn modified(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(path)
        .and_then(|found| found.modified())
        .ok()
}
