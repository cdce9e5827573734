//! SIGKILL of a process that writes: whatever it said was done is there afterwards, whole, and the store opens by itself.
//!
//! The parent starts this test binary again as the writer. `BACKLOT_STORE_KILLS` says how often to kill (12 by default).

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use super::*;
use crate::domain::blob::BlobRef;
use crate::domain::clock::UnixMs;
use crate::domain::ids::DriveLogId;

const FOLDER: &str = "BACKLOT_STORE_KILL_FOLDER";

fn open(folder: &Path) -> Store {
    Store::open(&StoreConfig {
        data_dir: folder.to_owned(),
        low_water_bytes: 0,
        ballast_bytes: 0,
    })
    .expect("the store opens by itself")
}

fn content(number: u64) -> Vec<u8> {
    // Over sled's and the file system's block sizes, and different each time.
    (0..20_000_u64)
        .map(|i| (i.wrapping_mul(number + 7) >> 3) as u8)
        .collect()
}

fn record(number: u64) -> DriveLogRecord {
    DriveLogRecord {
        id: DriveLogId::new(&format!("log-{number:06}")).expect("an id"),
        manifest: BlobRef::of(&content(number)),
        dataset: "x".repeat(500),
        synthetic: true,
        camera_count: 0,
        frame_count: 0,
        sweep_count: 0,
        track_count: 0,
        travel_m: number as f64,
        created_at: UnixMs(number as i64),
    }
}

/// The writer: blob, then record, then a line; every third log is deleted again, with another line.
#[test]
#[ignore = "run by the test below in a process of its own"]
fn writer() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else {
        return;
    };
    let store = open(&folder);
    let first = store
        .drive_logs("", usize::MAX)
        .expect("logs are listed")
        .last()
        .map_or(0, |last| last.travel_m as u64 + 1);
    let mut out = std::io::stdout().lock();
    for number in first.. {
        store
            .blobs()
            .put(&content(number))
            .expect("a blob is written");
        let log = store
            .create_drive_log(record(number))
            .expect("a log is committed");
        writeln!(out, "\nhas {number}").expect("the parent reads");
        if number % 3 == 0 {
            store.delete_drive_log(&log.id).expect("a log is deleted");
            writeln!(out, "\nhas not {number}").expect("the parent reads");
        }
    }
}

/// What the writers acknowledged: log by number, whether it is there.
type Acknowledged = BTreeMap<u64, bool>;

fn spawn(folder: &Path) -> (Child, BufReader<ChildStdout>) {
    let mut child = Command::new(std::env::current_exe().expect("tests know their binary"))
        .args([
            "store::kill_tests::writer",
            "--exact",
            "--ignored",
            "--nocapture",
        ])
        .env(FOLDER, folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the writer starts");
    let out = BufReader::new(child.stdout.take().expect("it is piped"));
    (child, out)
}

/// Reads acknowledgements until the writer is gone.
fn listen(out: BufReader<ChildStdout>, acknowledged: &mut Acknowledged) {
    for line in out.lines().map_while(Result::ok) {
        if let Some(number) = line.strip_prefix("has not ") {
            acknowledged.insert(number.parse().expect("a number"), false);
        } else if let Some(number) = line.strip_prefix("has ") {
            acknowledged.insert(number.parse().expect("a number"), true);
        }
    }
}

fn check(folder: &Path, acknowledged: &Acknowledged) {
    let store = open(folder);
    let logs = store.drive_logs("", usize::MAX).expect("logs are listed");
    let mut found: BTreeMap<u64, DriveLogRecord> = BTreeMap::new();
    for log in logs {
        let blob = store.blobs().read(&log.manifest.digest);
        assert!(blob.is_ok(), "{} names a blob that is not there", log.id);
        found.insert(log.travel_m as u64, log);
    }
    let last = acknowledged.keys().last().copied();
    for (number, is_there) in acknowledged {
        // The writer may have gone one step further than its last line.
        if Some(*number) != last {
            assert_eq!(found.contains_key(number), *is_there, "log {number}");
        } else if !is_there {
            assert!(!found.contains_key(number), "log {number} came back");
        } else if number % 3 != 0 {
            assert!(found.contains_key(number), "log {number} is lost");
        }
    }
    for (number, log) in found {
        assert_eq!(log, record(number), "a torn record");
    }
}

#[test]
fn kills_lose_nothing_acknowledged() {
    let kills: u64 = std::env::var("BACKLOT_STORE_KILLS")
        .ok()
        .map_or(12, |count| count.parse().expect("a count"));
    let root = tempfile::tempdir().expect("a folder");
    let folder = root.path().join("data");
    let mut acknowledged = Acknowledged::new();
    let mut hits = 0;
    for kill in 0..kills {
        let (mut child, mut out) = spawn(&folder);
        // The first acknowledgement, so that every kill comes while something is being written.
        let mut line = String::new();
        while !line.starts_with("has ") {
            line.clear();
            assert_ne!(
                out.read_line(&mut line).expect("lines"),
                0,
                "the writer ended"
            );
        }
        let number = line["has ".len()..].trim().parse().expect("a number");
        acknowledged.insert(number, true);
        // Spread over the writes that follow; a prime step visits different phases.
        std::thread::sleep(Duration::from_micros(kill * 7_919 % 60_000));
        let is_writing = child.try_wait().expect("it can be asked").is_none();
        hits += u64::from(is_writing);
        child.kill().expect("it is there");
        child.wait().expect("it ends");
        listen(out, &mut acknowledged);
        check(&folder, &acknowledged);
    }
    assert_eq!(hits, kills, "a writer ended by itself");
}
