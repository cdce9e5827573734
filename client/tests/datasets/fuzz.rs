//! Damaged data sets, and damaged files of points beside them: every reader answers with a log or with one line that names a path; it never panics and stays small.
//!
//! `BACKLOT_FUZZ_S` gives each reader that many seconds; without it each gets a fixed number of damages.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use backlot_client::inspect::LogReport;
use backlot_client::log_format::{LogFormat, LogInputs};
use backlot_client::read_log::Error;
use backlot_client::sfm_points::{SfmPointInputs, add_sfm_points};
use tempfile::TempDir;

use crate::street::street;
use crate::{argoverse_files, kitti_files, nuscenes_files, sfm_files, waymo_files};

/// Damages of an ordinary test run.
const DAMAGES: u64 = 60;
/// What the whole process may take at its peak; the written data sets have a megabyte.
const MAX_RESIDENT_KIB: u64 = 3 << 20;

/// SplitMix64 by Steele, Lea and Flood.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Below `bound`, which is at least 1.
    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}

#[test]
fn nuscenes() {
    fuzz(
        LogFormat::Nuscenes,
        |root| nuscenes_files::write(&street(), root),
        "",
    );
}

#[test]
fn argoverse() {
    fuzz(
        LogFormat::Argoverse2,
        |root| argoverse_files::write(&street(), root),
        "",
    );
}

#[test]
fn waymo() {
    fuzz(
        LogFormat::Waymo,
        |root| waymo_files::write(&street(), root, false),
        "",
    );
}

#[test]
fn kitti_raw() {
    fuzz(
        LogFormat::KittiRaw,
        |root| {
            kitti_files::write_raw(root);
        },
        kitti_files::DRIVE,
    );
}

#[test]
fn kitti_tracking() {
    fuzz(
        LogFormat::KittiTracking,
        |root| {
            kitti_files::write_tracking(root);
        },
        "",
    );
}

#[test]
fn sfm_points() {
    let folder = TempDir::new().expect("a temporary folder");
    let files = sfm_files::write(&street(), folder.path());
    fuzz_files("sfm-points", folder.path(), || {
        for file in &files {
            let inputs = SfmPointInputs {
                file: file.clone(),
                unit_m: 1.0,
            };
            add_sfm_points(&mut street(), &inputs)?;
        }
        Ok(())
    });
}

fn fuzz(format: LogFormat, write: impl Fn(&Path), log: &str) {
    let folder = TempDir::new().expect("a temporary folder");
    write(folder.path());
    let inputs = LogInputs {
        path: folder.path().join(log),
        ..LogInputs::default()
    };
    let read = || {
        let log = format.read(&inputs)?;
        LogReport::new(&log.drive_log);
        Ok(())
    };
    fuzz_files(&format.to_string(), folder.path(), read);
}

/// Damages the files below `folder`, of which `read` makes sense when they are sound.
fn fuzz_files(name: &str, folder: &Path, read: impl Fn() -> Result<(), Error>) {
    read().expect("the files are sound");
    let files = files_below(folder);
    let seconds = std::env::var("BACKLOT_FUZZ_S").ok();
    let budget =
        seconds.map(|s| Duration::from_secs(s.parse().expect("BACKLOT_FUZZ_S is a number")));
    let start = Instant::now();
    let (mut damages, mut refused) = (0, 0);
    loop {
        let done = budget.map_or(damages >= DAMAGES, |budget| start.elapsed() >= budget);
        if done {
            break;
        }
        damages += 1;
        let mut random = Random(damages);
        let path = &files[random.below(files.len())];
        let sound = fs::read(path).expect("the file is readable");
        let damaged = damage(&sound, &mut random);
        fs::write(path, &damaged).expect("the file is writable");
        let what = format!("damage {damages} of {}", path.display());
        refused += u64::from(!reads_or_explains(&read, folder, &what));
        fs::write(path, &sound).expect("the file is writable");
    }
    println!("{name}: {refused} of {damages} damaged data sets refused");
    assert!(refused > 0, "damage is never seen");
    check_memory();
}

/// False if the log was refused. A panic of the reader fails the test by itself.
///
/// `folder` holds the data set whole: a drive's calibration lies beside the drive.
fn reads_or_explains(read: &impl Fn() -> Result<(), Error>, folder: &Path, what: &str) -> bool {
    match read() {
        Ok(()) => true,
        Err(error) => {
            let text = error.to_string();
            let is_one_line = text.lines().count() == 1 && text.len() < 2000;
            let names_a_file = text.contains(&*folder.to_string_lossy());
            assert!(is_one_line && names_a_file, "{what}: {text}");
            false
        }
    }
}

/// Tables and texts twice as often as images: they have more to break.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder).expect("the folder is readable");
        let mut entries: Vec<PathBuf> = entries.map(|e| e.expect("an entry").path()).collect();
        entries.sort();
        for path in entries {
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
            let times = match extension {
                _ if path.is_dir() => {
                    folders.push(path);
                    continue;
                }
                "jpg" | "png" | "bin" => 1,
                _ => 4,
            };
            files.extend(std::iter::repeat_n(path, times));
        }
    }
    files
}

const EXTREMES: [u64; 8] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff_ffff,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
];
const WORDS: [&str; 8] = [
    "-1",
    "0",
    "1e308",
    "99999999999999999999",
    "nan",
    "null",
    "\"\"",
    "[]",
];

fn damage(sound: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    if bytes.is_empty() {
        return vec![0; 7];
    }
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len());
        let rest = bytes.len() - at;
        match random.below(7) {
            0 => bytes.truncate(at.max(1)),
            1 => bytes[at] ^= 1 << random.below(8),
            2 => {
                let length = 1 + random.below(rest.min(64));
                let fill = [0, 0xff, b' '][random.below(3)];
                bytes[at..at + length].fill(fill);
            }
            3 => {
                let width = [1, 2, 4, 8][random.below(4)].min(rest);
                let value = EXTREMES[random.below(EXTREMES.len())].to_le_bytes();
                bytes[at..at + width].copy_from_slice(&value[..width]);
            }
            4 => {
                let length = 1 + random.below(rest.min(256));
                let copy = bytes[at..at + length].to_vec();
                bytes.splice(at..at, copy);
            }
            5 => {
                bytes.drain(at..at + 1 + random.below(rest.min(256)));
            }
            _ => replace_word(&mut bytes, at, random),
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

/// Puts another word in place of the number at or after a position.
fn replace_word(bytes: &mut Vec<u8>, at: usize, random: &mut Random) {
    let is_number = |b: &u8| b.is_ascii_digit() || b"+-.eE".contains(b);
    let Some(start) = bytes[at..]
        .iter()
        .position(u8::is_ascii_digit)
        .map(|i| at + i)
    else {
        return;
    };
    let end = bytes[start..]
        .iter()
        .position(|b| !is_number(b))
        .map_or(bytes.len(), |i| start + i);
    let word = WORDS[random.below(WORDS.len())];
    bytes.splice(start..end, word.bytes());
}

/// The peak of this process, where the system tells it.
fn check_memory() {
    let Ok(status) = fs::read_to_string("/proc/self/status") else {
        return;
    };
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let peak = peak.and_then(|text| text.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    let peak = peak.expect("the status has the peak");
    println!("peak {} MiB", peak >> 10);
    assert!(peak <= MAX_RESIDENT_KIB, "{peak} KiB");
}
