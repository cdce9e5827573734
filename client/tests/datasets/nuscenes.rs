//! The reader of nuScenes.

use std::fs;
use std::path::{Path, PathBuf};

use backlot_client::nuscenes::{NuscenesInputs, is_nuscenes, read_nuscenes};
use backlot_client::read_log::ReadLog;
use backlot_proto::v1;
use serde_json::Value;
use tempfile::TempDir;

use crate::nuscenes_files::{channel, instance_token, keyframe_times_ns, write};
use crate::same_log::{Comparison, Deviation, FLAWS, LIMITS, deviation};
use crate::street::street;

fn read(root: &Path) -> Result<ReadLog, String> {
    let inputs = NuscenesInputs {
        data_root: root.to_owned(),
        scene: None,
    };
    read_nuscenes(&inputs).map_err(|e| e.to_string())
}

/// Writes `log`, reads it and tells how far it is from the street.
fn there_and_back(log: &ReadLog) -> Deviation {
    let folder = TempDir::new().expect("a temporary folder");
    write(log, folder.path());
    let got = read(folder.path()).expect("the log reads");
    let expected = street();
    let how = Comparison {
        box_times_ns: &keyframe_times_ns(&expected.drive_log),
        camera_id: &channel,
        track_id: &instance_token,
    };
    deviation(&expected, &got, &how)
}

#[test]
fn a_log_comes_back_the_same() {
    let found = there_and_back(&street());
    println!("nuscenes: {found:?}");
    assert!(found.is_within(&LIMITS), "{found:?}");
}

#[test]
fn logs_that_differ_are_told_apart() {
    for (flaw, break_it) in FLAWS {
        let mut log = street();
        break_it(&mut log.drive_log);
        let found = there_and_back(&log);
        assert!(!found.is_within(&LIMITS), "{flaw}: {found:?}");
    }
}

#[test]
fn what_the_tables_say_is_in_the_manifest() {
    let folder = TempDir::new().expect("a temporary folder");
    write(&street(), folder.path());
    assert!(is_nuscenes(folder.path()) && !is_nuscenes(&folder.path().join("samples")));
    // The folder of the tables names the same data set.
    let log = read(&folder.path().join("v1.0-mini"))
        .expect("the log reads")
        .drive_log;
    assert_eq!(log.dataset, "nuscenes");
    let track = |id: &str| {
        let id = instance_token(id);
        log.tracks
            .iter()
            .find(|t| t.track_id == id)
            .expect("the track is there")
    };
    for original in &street().drive_log.tracks {
        let read = track(&original.track_id);
        assert_eq!(
            read.object_class, original.object_class,
            "{}",
            read.source_class
        );
        assert_eq!(read.states[0].occlusion(), v1::Occlusion::None);
    }
    assert!(
        log.notes.iter().any(|note| note.contains("scene-0001")),
        "{:?}",
        log.notes
    );
}

#[test]
fn missing_sweeps_between_keyframes_are_noted_and_missing_keyframes_are_errors() {
    let data = Data::new();
    let tables: Vec<Value> = data.table("sample_data");
    let file = |key: bool| {
        let row = tables.iter().find(|row| {
            row["is_key_frame"] == key
                && row["filename"]
                    .as_str()
                    .is_some_and(|f| f.contains("CAM_FRONT"))
        });
        row.expect("there is such a row")["filename"]
            .as_str()
            .expect("a name")
            .to_owned()
    };
    data.remove(&file(false));
    let log = read(data.folder.path()).expect("the log reads").drive_log;
    assert_eq!(log.frames.len(), street().drive_log.frames.len() - 1);
    assert!(
        log.notes
            .iter()
            .any(|note| note.contains("1 recordings of CAM_FRONT")),
        "{:?}",
        log.notes
    );
    data.remove(&file(true));
    assert!(data.error().contains(&file(true)), "{}", data.error());
}

/// A written data set to break.
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
        self.folder.path().join(name)
    }

    fn table(&self, name: &str) -> Vec<Value> {
        let text =
            fs::read(self.path(&format!("v1.0-mini/{name}.json"))).expect("the table is there");
        serde_json::from_slice(&text).expect("the table is JSON")
    }

    fn change(&self, name: &str, change: impl FnOnce(&mut Vec<Value>)) {
        let mut rows = self.table(name);
        change(&mut rows);
        let text = serde_json::to_string(&rows).expect("rows are JSON");
        self.put(&format!("v1.0-mini/{name}.json"), text.as_bytes());
    }

    fn put(&self, name: &str, content: &[u8]) {
        fs::write(self.path(name), content).expect("the file is writable");
    }

    fn remove(&self, name: &str) {
        fs::remove_file(self.path(name)).expect("the file is there");
    }

    /// The first file of a sensor.
    fn file_of(&self, channel: &str) -> String {
        let rows = self.table("sample_data");
        let mut names = rows.iter().filter_map(|row| row["filename"].as_str());
        names
            .find(|name| name.contains(channel))
            .expect("the sensor recorded")
            .to_owned()
    }

    fn error(&self) -> String {
        read(self.folder.path()).expect_err("the data is bad")
    }
}

#[test]
fn errors_name_file_and_reason() {
    type Break = fn(&Data);
    let cases: [(&str, Break, &[&str]); 16] = [
        (
            "no table",
            |d| d.remove("v1.0-mini/ego_pose.json"),
            &["ego_pose.json", "not found", "sample_annotation"],
        ),
        (
            "no layout",
            |d| d.remove("v1.0-mini/sample_data.json"),
            &["v1.0-*", "must be a nuScenes folder"],
        ),
        (
            "not JSON",
            |d| d.put("v1.0-mini/sample.json", b"[{\"token\": "),
            &["sample.json", "line 1"],
        ),
        (
            "a row without a field",
            |d| {
                d.change("calibrated_sensor", |rows| {
                    rows[0].as_object_mut().expect("a row").remove("rotation");
                })
            },
            &["calibrated_sensor.json", "missing field `rotation`"],
        ),
        (
            "no calibration",
            |d| d.change("calibrated_sensor", Vec::clear),
            &["calibrated_sensor.json", "no row"],
        ),
        (
            "no pose",
            |d| {
                d.change("ego_pose", |rows| {
                    rows.pop();
                })
            },
            &["ego_pose.json", "no row"],
        ),
        (
            "no instance",
            |d| {
                d.change("instance", |rows| {
                    rows.pop();
                })
            },
            &["instance.json", "no row"],
        ),
        (
            "a rotation that is none",
            |d| {
                d.change("ego_pose", |rows| {
                    rows[0]["rotation"] = serde_json::json!([1.0, 1.0, 0.0, 0.0])
                })
            },
            &["ego_pose.json", "unit quaternion"],
        ),
        (
            "times out of order",
            |d| {
                d.change("sample", |rows| {
                    rows[1]["timestamp"] = rows[0]["timestamp"].clone()
                })
            },
            &["sample.json", "out of order"],
        ),
        (
            "a box twice",
            |d| {
                d.change("sample_annotation", |rows| {
                    let row = rows[0].clone();
                    rows.push(row);
                })
            },
            &["sample_annotation.json", "second box"],
        ),
        (
            "a file outside",
            |d| {
                d.change("sample_data", |rows| {
                    rows[0]["filename"] = "../../secret.jpg".into()
                })
            },
            &["../../secret.jpg", "not below"],
        ),
        (
            "two scenes",
            |d| {
                d.change("scene", |rows| {
                    let mut row = rows[0].clone();
                    row["name"] = "scene-0002".into();
                    rows.push(row);
                })
            },
            &["scene-0001, scene-0002", "--scene"],
        ),
        (
            "an image that does not decode",
            |d| d.put(&d.file_of("CAM_FRONT"), b"\xff\xd8\xff\xe0 no image"),
            &["CAM_FRONT", ".jpg", "does not decode"],
        ),
        (
            "a cut image",
            |d| {
                let file = d.file_of("CAM_FRONT");
                let content = fs::read(d.path(&file)).expect("the image is there");
                d.put(&file, &content[..content.len() * 2 / 3]);
            },
            &["CAM_FRONT", ".jpg", "cut off"],
        ),
        (
            "an empty sweep",
            |d| d.put(&d.file_of("LIDAR"), b""),
            &["LIDAR_TOP", ".pcd.bin", "empty or truncated"],
        ),
        (
            "a cut sweep",
            |d| d.put(&d.file_of("LIDAR"), &[0; 33]),
            &["LIDAR_TOP", ".pcd.bin", "33 bytes"],
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
