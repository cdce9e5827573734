//! The reader of Argoverse 2.

use std::fs;
use std::path::{Path, PathBuf};

use arrow_ipc::CompressionType;
use backlot_client::argoverse::{ArgoverseInputs, is_argoverse, read_argoverse};
use backlot_client::read_log::ReadLog;
use backlot_proto::v1;
use tempfile::TempDir;

use crate::argoverse_files::{LOG, feather, floats, integers, put_feather, rounded, write};
use crate::same_log::{Comparison, Deviation, FLAWS, LIMITS, deviation};
use crate::street::street;

fn read(path: &Path) -> Result<ReadLog, String> {
    let inputs = ArgoverseInputs {
        path: path.to_owned(),
        log: None,
    };
    read_argoverse(&inputs).map_err(|e| e.to_string())
}

fn sweep_times_ns(log: &v1::DriveLog) -> Vec<i64> {
    log.sweeps.iter().map(|sweep| sweep.timestamp_ns).collect()
}

fn there_and_back(log: &ReadLog) -> Deviation {
    let folder = TempDir::new().expect("a temporary folder");
    write(log, folder.path());
    let got = read(folder.path()).expect("the log reads");
    let expected = rounded(street());
    let how = Comparison {
        box_times_ns: &sweep_times_ns(&expected.drive_log),
        camera_id: &str::to_owned,
        track_id: &str::to_owned,
    };
    deviation(&expected, &got, &how)
}

#[test]
fn a_log_comes_back_the_same() {
    let found = there_and_back(&rounded(street()));
    println!("argoverse: {found:?}");
    assert!(found.is_within(&LIMITS), "{found:?}");
}

#[test]
fn logs_that_differ_are_told_apart() {
    for (flaw, break_it) in FLAWS {
        let mut log = rounded(street());
        break_it(&mut log.drive_log);
        let found = there_and_back(&log);
        assert!(!found.is_within(&LIMITS), "{flaw}: {found:?}");
    }
}

#[test]
fn a_split_is_asked_for_its_log() {
    let data = Data::new();
    assert!(is_argoverse(data.folder.path()) && is_argoverse(&data.path("")));
    assert!(!is_argoverse(&data.path("sensors")));
    assert_eq!(
        read(&data.path(""))
            .expect("the log reads")
            .drive_log
            .dataset,
        "argoverse2"
    );
    fs::create_dir(data.folder.path().join("other")).expect("a folder");
    fs::copy(
        data.path("city_SE3_egovehicle.feather"),
        data.folder.path().join("other/city_SE3_egovehicle.feather"),
    )
    .expect("a copy");
    let error = data.error();
    assert!(
        error.contains("other, street-log") && error.contains("--scene"),
        "{error}"
    );
}

#[test]
fn every_compression_is_read() {
    let data = Data::new();
    let expected = read(&data.path("")).expect("the log reads").drive_log;
    let mut read_back = Vec::new();
    for compression in [
        None,
        Some(CompressionType::ZSTD),
        Some(CompressionType::LZ4_FRAME),
    ] {
        let poses: Vec<_> = expected
            .world_from_ego
            .iter()
            .map(|p| (p.timestamp_ns, p.pose.expect("a pose")))
            .collect();
        let column = |of: &dyn Fn(&v1::RigidTransform) -> f64| {
            floats(poses.iter().map(|(_, p)| of(p)).collect())
        };
        let q = |p: &v1::RigidTransform| p.rotation.expect("a rotation");
        let t = |p: &v1::RigidTransform| p.translation_m.expect("a translation");
        let columns = vec![
            (
                "timestamp_ns",
                integers(poses.iter().map(|(at, _)| *at).collect()),
            ),
            ("qw", column(&|p| q(p).w)),
            ("qx", column(&|p| q(p).x)),
            ("qy", column(&|p| q(p).y)),
            ("qz", column(&|p| q(p).z)),
            ("tx_m", column(&|p| t(p).x)),
            ("ty_m", column(&|p| t(p).y)),
            ("tz_m", column(&|p| t(p).z)),
        ];
        data.put(
            "city_SE3_egovehicle.feather",
            &feather(columns, compression),
        );
        let got = read(&data.path("")).expect("the log reads").drive_log;
        read_back.push(got.world_from_ego);
    }
    assert_eq!(read_back[0].len(), expected.world_from_ego.len());
    assert_eq!(read_back[1], read_back[0]);
    assert_eq!(read_back[2], read_back[0]);
}

struct Data {
    folder: TempDir,
}

impl Data {
    fn new() -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        write(&street(), folder.path());
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(LOG).join(name)
    }

    fn put(&self, name: &str, content: &[u8]) {
        fs::write(self.path(name), content).expect("the file is writable");
    }

    fn content(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).expect("the file is there")
    }

    fn remove(&self, name: &str) {
        fs::remove_file(self.path(name)).expect("the file is there");
    }

    /// The first file of a folder.
    fn first_in(&self, folder: &str) -> String {
        let files = fs::read_dir(self.path(folder)).expect("the folder is there");
        let names = files.map(|f| {
            f.expect("a file")
                .file_name()
                .to_string_lossy()
                .into_owned()
        });
        format!("{folder}/{}", names.min().expect("the folder has a file"))
    }

    fn error(&self) -> String {
        read(self.folder.path()).expect_err("the data is bad")
    }
}

#[test]
fn errors_name_file_and_reason() {
    type Break = fn(&Data);
    const POSES: &str = "city_SE3_egovehicle.feather";
    let cases: [(&str, Break, &[&str]); 13] = [
        (
            "no layout",
            |d| d.remove(POSES),
            &[POSES, "must be an Argoverse 2"],
        ),
        (
            "no calibration",
            |d| d.remove("calibration/intrinsics.feather"),
            &["intrinsics.feather", "not found"],
        ),
        (
            "no calibration of a camera",
            |d| {
                fs::rename(
                    d.path("sensors/cameras/side"),
                    d.path("sensors/cameras/rear"),
                )
                .expect("the folder is there");
            },
            &["calibration", "no calibration of rear"],
        ),
        (
            "no images",
            |d| fs::remove_dir_all(d.path("sensors/cameras")).expect("the folder is there"),
            &["sensors/cameras", "not found"],
        ),
        (
            "a cut table",
            |d| d.put(POSES, &d.content(POSES)[..700]),
            &[POSES, "cut off"],
        ),
        ("an empty table", |d| d.put(POSES, b""), &[POSES, "cut off"]),
        (
            "a damaged table",
            |d| {
                let mut content = d.content(POSES);
                let middle = content.len() / 2;
                content[middle..middle + 40].fill(0xff);
                d.put(POSES, &content);
            },
            &[POSES],
        ),
        (
            "times out of order",
            |d| {
                put_feather(
                    &d.path(""),
                    POSES,
                    vec![
                        ("timestamp_ns", integers(vec![2, 1])),
                        ("qw", floats(vec![1.0, 1.0])),
                        ("qx", floats(vec![0.0, 0.0])),
                        ("qy", floats(vec![0.0, 0.0])),
                        ("qz", floats(vec![0.0, 0.0])),
                        ("tx_m", floats(vec![0.0, 0.0])),
                        ("ty_m", floats(vec![0.0, 0.0])),
                        ("tz_m", floats(vec![0.0, 0.0])),
                    ],
                )
            },
            &[POSES, "row 1", "out of order"],
        ),
        (
            "a column too few",
            |d| {
                put_feather(
                    &d.path(""),
                    POSES,
                    vec![("timestamp_ns", integers(vec![1]))],
                )
            },
            &[POSES, "no column qw"],
        ),
        (
            "boxes without tracks",
            |d| {
                put_feather(
                    &d.path(""),
                    "annotations.feather",
                    vec![("timestamp_ns", integers(vec![1]))],
                )
            },
            &["annotations.feather", "no column"],
        ),
        (
            "an image that does not decode",
            |d| d.put(&d.first_in("sensors/cameras/side"), b"\xff\xd8\xff\xe0"),
            &["side", ".jpg", "does not decode"],
        ),
        (
            "an empty sweep",
            |d| d.put(&d.first_in("sensors/lidar"), b""),
            &["sensors/lidar", "cut off"],
        ),
        (
            "a bomb",
            |d| d.put(&d.first_in("sensors/lidar"), &bomb()),
            &["sensors/lidar", "unpacks to", "at most"],
        ),
    ];
    for (case, break_it, expected) in cases {
        let data = Data::new();
        break_it(&data);
        let error = data.error();
        for text in expected {
            assert!(
                error.contains(text),
                "{case}: {error:?} does not say {text:?}"
            );
        }
        assert_eq!(error.lines().count(), 1, "{case}: {error:?}");
    }
}

/// A sweep of a few bytes that says it unpacks to a gigabyte and more a column.
fn bomb() -> Vec<u8> {
    const ROWS: usize = 5000;
    let zeros = || floats(vec![0.0; ROWS]);
    let columns = vec![
        ("x", zeros()),
        ("y", zeros()),
        ("z", zeros()),
        ("intensity", zeros()),
    ];
    let mut content = feather(columns, Some(CompressionType::ZSTD));
    let declared = (8 * ROWS as u64).to_le_bytes();
    let lengths: Vec<usize> = content
        .windows(8)
        .enumerate()
        .filter(|(_, w)| *w == declared)
        .map(|(i, _)| i)
        .collect();
    assert!(lengths.len() >= 4, "every column has its length");
    for at in lengths {
        content[at..at + 8].copy_from_slice(&(1_u64 << 30).to_le_bytes());
    }
    content
}
