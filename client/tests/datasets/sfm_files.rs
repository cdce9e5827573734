//! Points of structure from motion in every form that is read.

use std::fs;
use std::path::{Path, PathBuf};

use backlot_client::geometry::rigid_from_wire;
use backlot_client::read_log::ReadLog;
use glam::DVec3;

const POINTS: u32 = 40;

/// Writes the same points around the drive in every form; returns the files to be read.
pub(crate) fn write(log: &ReadLog, folder: &Path) -> Vec<PathBuf> {
    let first = log.drive_log.world_from_ego[0].pose.as_ref();
    let start_m = rigid_from_wire(first).translation_m;
    let offset = |i: u32| DVec3::new(f64::from(i % 9), f64::from(i / 9), f64::from(i % 4));
    let points: Vec<DVec3> = (0..POINTS).map(|i| start_m + offset(i)).collect();
    let put = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        fs::write(&path, content).expect("the file is written");
        path
    };
    put("images.txt", images(log).as_bytes());
    vec![
        put("points3D.txt", colmap(&points).as_bytes()),
        put("points.csv", table(&points).as_bytes()),
        put("text.ply", &ply(&points, "ascii")),
        put("binary.ply", &ply(&points, "binary_little_endian")),
    ]
}

fn colmap(points: &[DVec3]) -> String {
    let line = |(i, p): (usize, &DVec3)| {
        let seen = i % 3 + 1;
        format!(
            "{} {} {} {} 9 8 7 0.5 {seen} 4 {} 0\n",
            i + 1,
            p.x,
            p.y,
            p.z,
            seen + 1
        )
    };
    let lines: String = points.iter().enumerate().map(line).collect();
    format!("# 3D points\n{lines}")
}

fn images(log: &ReadLog) -> String {
    let line = |(i, frame): (usize, &backlot_proto::v1::CameraFrame)| {
        let name = format!("{}/{:06}.png", frame.camera_id, frame.frame_index);
        format!("{} 1 0 0 0 0 0 0 1 {name}\n0.5 0.5 1\n", i + 1)
    };
    log.drive_log.frames.iter().enumerate().map(line).collect()
}

fn table(points: &[DVec3]) -> String {
    let line = |p: &DVec3| format!("{},{},{}\n", p.x, p.y, p.z);
    let lines: String = points.iter().map(line).collect();
    format!("x,y,z\n{lines}")
}

fn ply(points: &[DVec3], form: &str) -> Vec<u8> {
    let count = points.len();
    let mut content = format!(
        "ply\nformat {form} 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\nend_header\n"
    )
    .into_bytes();
    for p in points {
        if form == "ascii" {
            content.extend(format!("{} {} {} 7\n", p.x, p.y, p.z).bytes());
        } else {
            content.extend(p.to_array().iter().flat_map(|v| v.to_le_bytes()));
            content.push(7);
        }
    }
    content
}
