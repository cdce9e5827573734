//! A `backlotd` process on a data directory.

use std::fs::File;
use std::net::{Ipv4Addr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use backlot_client::Connection;

use crate::programs::backlotd;

/// A machine that trains on every core may take this long to answer for the first time.
const START_LIMIT: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(20);

/// A running server; dropping it kills the process.
#[derive(Debug)]
pub struct Server {
    process: Child,
    port: u16,
    log: PathBuf,
}

impl Server {
    /// Starts a server on `data_dir` and waits until it answers.
    ///
    /// # Panics
    /// If it does not; shows its log.
    pub async fn start(data_dir: &Path) -> Self {
        Self::start_on(data_dir, free_port(), &[]).await
    }

    /// As [`Self::start`], on a given port and with further arguments.
    pub async fn start_on(data_dir: &Path, port: u16, arguments: &[&str]) -> Self {
        let log = log_path(data_dir);
        let mut server = Self {
            process: spawn(data_dir, port, arguments, &log),
            port,
            log,
        };
        server.wait_until_it_answers().await;
        server
    }

    async fn wait_until_it_answers(&mut self) {
        let begun = Instant::now();
        loop {
            if let Ok(connection) = Connection::open(&self.url()).await
                && backlot_client::listing::drive_logs(&connection)
                    .await
                    .is_ok()
            {
                return;
            }
            if let Some(status) = self.process.try_wait().expect("the process can be asked") {
                panic!("backlotd ended with {status}:\n{}", self.log_text());
            }
            assert!(
                begun.elapsed() < START_LIMIT,
                "backlotd does not answer:\n{}",
                self.log_text()
            );
            tokio::time::sleep(POLL).await;
        }
    }

    /// Address for clients.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    /// # Panics
    /// If the server does not take connections.
    pub async fn connect(&self) -> Connection {
        Connection::open(&self.url())
            .await
            .expect("the server takes connections")
    }

    /// Whether the process is still there.
    pub fn is_running(&mut self) -> bool {
        matches!(self.process.try_wait(), Ok(None))
    }

    /// Kills the process as a power switch would: it cannot clean up.
    pub fn kill(mut self) {
        self.process.kill().expect("the process can be killed");
        self.process.wait().expect("the process ends");
    }

    /// Asks the process to end, as a supervisor would.
    pub fn stop(mut self) -> ExitStatus {
        // SAFETY: kill(2) with a process id that is ours and has not been waited for.
        let sent = unsafe { libc::kill(self.process.id() as libc::pid_t, libc::SIGTERM) };
        assert_eq!(sent, 0, "the process takes signals");
        self.process.wait().expect("the process ends")
    }

    /// What the server has logged.
    pub fn log_text(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already, and then there is nothing to do.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Starts a server that is expected to refuse; returns its exit status and everything it said.
///
/// # Panics
/// If it is still running after a minute.
pub fn refused_start(data_dir: &Path) -> (ExitStatus, String) {
    refused_start_with(data_dir, &[])
}

/// As [`refused_start`], with further arguments.
///
/// # Panics
/// As [`refused_start`].
pub fn refused_start_with(data_dir: &Path, arguments: &[&str]) -> (ExitStatus, String) {
    let log = log_path(data_dir);
    let mut process = spawn(data_dir, free_port(), arguments, &log);
    let begun = Instant::now();
    loop {
        if let Some(status) = process.try_wait().expect("the process can be asked") {
            return (status, std::fs::read_to_string(&log).unwrap_or_default());
        }
        if begun.elapsed() > START_LIMIT {
            process.kill().expect("the process can be killed");
            panic!("backlotd started where it should have refused");
        }
        std::thread::sleep(POLL);
    }
}

/// A port that was free a moment ago. Fixed rather than chosen by the server, so that clients find it again after a restart.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a loopback port is free");
    listener
        .local_addr()
        .expect("a bound socket has an address")
        .port()
}

fn spawn(data_dir: &Path, port: u16, arguments: &[&str], log: &Path) -> Child {
    let out = File::options()
        .create(true)
        .append(true)
        .open(log)
        .expect("the log can be written");
    let error = out.try_clone().expect("a file can be shared");
    let mut command: Command = backlotd();
    command
        .arg("--data-dir")
        .arg(data_dir)
        .arg("--listen")
        .arg(format!("127.0.0.1:{port}"))
        .args(arguments);
    command.stdin(Stdio::null()).stdout(out).stderr(error);
    command.spawn().expect("backlotd starts")
}

/// Beside the data directory, so that the directory holds only what the server wrote.
fn log_path(data_dir: &Path) -> PathBuf {
    data_dir.with_extension("log")
}
