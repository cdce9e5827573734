//! The small drive as a sequence of the tracking benchmark.

use std::fs;

use super::tests::{CAM_TO_CAM, Drive, IMU_TO_VELO, LABELS, VELO_TO_CAM};
use super::*;

/// Sequence 0003 of a tracking split: the same drive in the benchmark's files.
fn tracking_split(drive: &Drive) -> KittiTrackingInputs {
    let row = |rotation: &str, t: [&str; 3]| {
        let r: Vec<&str> = rotation.split(' ').collect();
        let rows =
            (0..3).map(|i| format!("{} {} {} {}", r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]));
        rows.collect::<Vec<_>>().join(" ")
    };
    let value = |file: &'static str, key: &str| {
        let line = file.lines().find_map(|line| line.strip_prefix(key));
        line.unwrap().trim_start_matches(':').trim()
    };
    let velodyne = row(
        value(VELO_TO_CAM, "R"),
        value(VELO_TO_CAM, "T")
            .split(' ')
            .collect::<Vec<_>>()
            .try_into()
            .unwrap(),
    );
    let imu = row(
        value(IMU_TO_VELO, "R"),
        value(IMU_TO_VELO, "T")
            .split(' ')
            .collect::<Vec<_>>()
            .try_into()
            .unwrap(),
    );
    let calibration = format!(
        "P2: {}\nR_rect {}\nTr_velo_cam {velodyne}\nTr_imu_velo {imu}\n",
        value(CAM_TO_CAM, "P_rect_02"),
        value(CAM_TO_CAM, "R_rect_00"),
    );
    drive.write("split/calib/0003.txt", calibration.as_bytes());
    drive.write("split/label_02/0003.txt", LABELS.as_bytes());
    let packets: String = (0_i32..4)
        .map(|i| {
            format!(
                "{} 8.44 115.0 0.01 0.02 1.5 0 0 0\n",
                49.0 + 0.00001 * f64::from(i.max(1))
            )
        })
        .collect();
    drive.write("split/oxts/0003.txt", packets.as_bytes());
    for frame in [1, 2] {
        for (from, to) in [
            ("image_02/data", "image_02/0003"),
            ("velodyne_points/data", "velodyne/0003"),
        ] {
            let extension = if from.starts_with("image") {
                "png"
            } else {
                "bin"
            };
            let content =
                fs::read(drive.path(&format!("day/drive/{from}/000000000{frame}.{extension}")));
            drive.write(
                &format!("split/{to}/00000{frame}.{extension}"),
                &content.unwrap(),
            );
        }
    }
    KittiTrackingInputs {
        root: drive.path("split"),
        sequence: None,
    }
}

/// The same calibration, boxes and sweeps in either form are the same log but for the source of the ego poses.
#[test]
fn a_tracking_sequence_is_the_drive_it_was_cut_from() {
    let drive = Drive::new();
    let inputs = tracking_split(&drive);
    for frame in [0_i32, 1, 2] {
        let packet = format!(
            "{} 8.44 115.0 0.01 0.02 1.5 0 0 0\n",
            49.0 + 0.00001 * f64::from(frame.max(1))
        );
        drive.write(
            &format!("day/drive/oxts/data/000000000{frame}.txt"),
            packet.as_bytes(),
        );
    }
    let raw = KittiInputs {
        poses: None,
        ..drive.inputs()
    };
    let raw = read_kitti_raw(&raw).unwrap().drive_log;
    let tracking = read_kitti_tracking(&inputs).unwrap().drive_log;
    assert_eq!(tracking.dataset, "kitti-tracking");
    assert_eq!(tracking.cameras, raw.cameras);
    assert_eq!(tracking.frames, raw.frames);
    assert_eq!(tracking.sweeps, raw.sweeps);
    assert_eq!(tracking.world_from_ego, raw.world_from_ego);
    assert_eq!(tracking.tracks, raw.tracks);
    assert!(is_kitti_tracking(&inputs.root) && !is_kitti_tracking(&drive.path("day/drive")));
    assert!(is_kitti_raw(&drive.path("day/drive")) && !is_kitti_raw(&inputs.root));
    let calibration = fs::read_to_string(drive.path("split/calib/0003.txt")).unwrap();
    let moved = calibration.replace("4.485728e+00", "9.485728e+00");
    drive.write("split/calib/0003.txt", moved.as_bytes());
    let moved = read_kitti_tracking(&inputs).unwrap().drive_log;
    assert_ne!(moved.cameras, raw.cameras);
}

#[test]
fn errors_of_a_tracking_split_name_file_and_reason() {
    type Break = fn(&Drive);
    let cases: [(Break, &[&str]); 6] = [
        (
            |d| fs::remove_file(d.path("split/calib/0003.txt")).unwrap(),
            &["calib/0003.txt", "not found"],
        ),
        (
            |d| fs::remove_file(d.path("split/oxts/0003.txt")).unwrap(),
            &["oxts/0003.txt", "not found"],
        ),
        (
            |d| d.write("split/oxts/0003.txt", b"49.0 8.44\n"),
            &["oxts/0003.txt:1", "alt is missing"],
        ),
        (
            |d| d.write("split/calib/0003.txt", b"P2: 1 2 3\n"),
            &["calib/0003.txt:1", "3 numbers"],
        ),
        (
            |d| d.write("split/velodyne/0003/000002.bin", b"12345"),
            &["000002.bin", "truncated"],
        ),
        (
            |d| fs::create_dir(d.path("split/image_02/0007")).unwrap(),
            &["0003, 0007", "--scene"],
        ),
    ];
    for (break_it, expected) in cases {
        let drive = Drive::new();
        let inputs = tracking_split(&drive);
        assert!(read_kitti_tracking(&inputs).is_ok());
        break_it(&drive);
        let error = read_kitti_tracking(&inputs).unwrap_err().to_string();
        for text in expected {
            assert!(error.contains(text), "{error:?} does not say {text:?}");
        }
    }
}
