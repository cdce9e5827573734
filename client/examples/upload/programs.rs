//! The programs being measured, as processes.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

/// How often a running client's memory is looked at.
const LOOK: Duration = Duration::from_millis(20);

/// A server with an empty data directory.
pub(crate) struct Server {
    process: Child,
    url: String,
}

impl Server {
    pub(crate) fn start(programs: &Path, data: &Path) -> Result<Self> {
        let program = programs.join("backlotd");
        let mut process = Command::new(&program)
            .arg("--data-dir")
            .arg(data)
            .args(["--listen", "127.0.0.1:0"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .with_context(|| format!("starting {}", program.display()))?;
        let stdout = process.stdout.take().context("standard output is piped")?;
        for line in BufReader::new(stdout).lines() {
            if let Some((_, address)) = line?.split_once("listening on ") {
                let url = format!("http://{}", address.trim());
                return Ok(Self { process, url });
            }
        }
        bail!("{} ended without an address", program.display())
    }

    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    pub(crate) fn peak_mib(&self) -> Result<f64> {
        peak_mib(self.process.id()).context("the server's memory cannot be read")
    }

    pub(crate) fn stop(mut self) -> Result<()> {
        self.process.kill()?;
        self.process.wait()?;
        Ok(())
    }
}

/// What an upload said and took.
pub(crate) struct Client {
    /// Its last line.
    pub said: String,
    pub peak_mib: f64,
}

impl Client {
    /// The number of seconds behind these words of its last line.
    pub(crate) fn seconds(&self, behind: &str) -> Option<f64> {
        let (_, rest) = self.said.split_once(behind)?;
        rest.trim_start().split(' ').next()?.parse().ok()
    }

    pub(crate) fn megabytes_sent(&self) -> Option<f64> {
        let (before, _) = self.said.split_once(" MB;")?;
        before.rsplit(' ').next()?.parse().ok()
    }
}

pub(crate) fn start_client(programs: &Path, url: &str, log: &Path) -> Result<Child> {
    let program = programs.join("backlot");
    Command::new(&program)
        .args(["--server", url, "logs", "upload", "--name", "large"])
        .arg(log)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("starting {}", program.display()))
}

pub(crate) fn run_client(programs: &Path, url: &str, log: &Path) -> Result<Client> {
    let mut process = start_client(programs, url, log)?;
    let mut peak: f64 = 0.0;
    let status = loop {
        if let Some(status) = process.try_wait()? {
            break status;
        }
        peak = peak.max(peak_mib(process.id()).unwrap_or(0.0));
        std::thread::sleep(LOOK);
    };
    let mut text = String::new();
    let mut stderr = process.stderr.take().context("standard error is piped")?;
    stderr.read_to_string(&mut text)?;
    ensure!(status.success(), "the upload failed: {text}");
    let said = text.lines().find(|line| line.contains("blobs were sent"));
    Ok(Client {
        said: said
            .context("the client says what it sent")?
            .trim()
            .to_owned(),
        peak_mib: peak,
    })
}

/// Largest resident memory of a running process so far, as Linux counts it.
fn peak_mib(process: u32) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Bytes of all files below a folder; 0 if it is not there. Files that go meanwhile are not counted.
pub(crate) fn folder_bytes(folder: &Path) -> Result<u64> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(0);
    };
    let mut bytes = 0;
    for entry in entries {
        let entry = entry?;
        bytes += match entry.metadata() {
            Ok(found) if found.is_dir() => folder_bytes(&entry.path())?,
            Ok(found) => found.len(),
            Err(_) => 0,
        };
    }
    Ok(bytes)
}
