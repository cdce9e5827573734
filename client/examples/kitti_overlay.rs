//! Draws LiDAR points and labelled cuboids over images of a KITTI raw drive, to check its calibration, poses and tracks by eye:
//! `cargo run --release --example kitti_overlay -- DRIVE OUT_DIR [--poses FILE] [--tracks FILE] FRAME...`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::kitti::{KittiInputs, read_kitti_raw};
use backlot_client::motion::{ego_pose_at, track_pose_at};
use backlot_client::picture::draw_cuboid;
use backlot_client::read_log::{BlobSource, ReadLog};
use backlot_engine::camera::Camera;
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: kitti_overlay DRIVE OUT_DIR [--poses FILE] [--tracks FILE] FRAME...";
    let mut inputs = KittiInputs {
        drive_dir: arguments.next().context(usage)?.into(),
        calib_dir: None,
        poses: None,
        tracks: None,
    };
    let out = PathBuf::from(arguments.next().context(usage)?);
    std::fs::create_dir_all(&out)?;
    let mut frames: Vec<u32> = Vec::new();
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--poses" => inputs.poses = arguments.next().map(PathBuf::from),
            "--tracks" => inputs.tracks = arguments.next().map(PathBuf::from),
            frame => frames.push(frame.parse().context(usage)?),
        }
    }
    let log = read_kitti_raw(&inputs)?;
    for note in &log.drive_log.notes {
        println!("{note}");
    }
    for frame in log.drive_log.frames.iter() {
        if frames.contains(&frame.frame_index) {
            let path = out.join(format!("{:06}.png", frame.frame_index));
            overlay(&log, frame)?.save(path)?;
        }
    }
    Ok(())
}

fn overlay(log: &ReadLog, frame: &v1::CameraFrame) -> Result<RgbImage> {
    let mut image = image::load_from_memory(&content(log, frame.image.as_ref())?)?.into_rgb8();
    let wire = &log.drive_log.cameras[0];
    let camera = Camera {
        width: wire.width,
        height: wire.height,
        focal_px: DVec2::new(wire.focal_x_px, wire.focal_y_px),
        principal_px: DVec2::new(wire.principal_x_px, wire.principal_y_px),
        distortion: Default::default(),
    };
    let ego_from_camera = rigid_from_wire(wire.ego_from_camera.as_ref());
    let at = |ns| ego_pose_at(&log.drive_log.world_from_ego, ns).context("outside the trajectory");
    let camera_from_world = (at(frame.timestamp_ns)? * ego_from_camera).inverse();
    let nearest = log
        .drive_log
        .sweeps
        .iter()
        .min_by_key(|sweep| (sweep.timestamp_ns - frame.timestamp_ns).abs());
    if let Some(sweep) = nearest {
        let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
        let camera_from_lidar = camera_from_world * at(sweep.timestamp_ns)? * ego_from_lidar;
        for point in content(log, sweep.points.as_ref())?.chunks_exact(16) {
            let value =
                |k: usize| f32::from_le_bytes(point[4 * k..4 * k + 4].try_into().expect("4 bytes"));
            let p = camera_from_lidar.point(DVec3::new(
                value(0).into(),
                value(1).into(),
                value(2).into(),
            ));
            let Some(pixel) = camera.project(p) else {
                continue;
            };
            let inside = pixel.cmpge(DVec2::ZERO).all()
                && pixel.x < f64::from(camera.width)
                && pixel.y < f64::from(camera.height);
            if inside {
                image.put_pixel(pixel.x as u32, pixel.y as u32, distance_color(p.length()));
            }
        }
    }
    for track in &log.drive_log.tracks {
        if let Some(pose) = track_pose_at(track, frame.timestamp_ns) {
            let size = vector_from_wire(track.size_m.as_ref());
            let camera_from_cuboid = camera_from_world * pose;
            draw_cuboid(
                &mut image,
                &camera,
                &camera_from_cuboid,
                size,
                Rgb([60, 255, 90]),
            );
        }
    }
    Ok(image)
}

fn content(log: &ReadLog, blob: Option<&v1::BlobRef>) -> Result<Vec<u8>> {
    let digest = &blob.context("no blob")?.digest;
    match log.blobs.get(digest).context("an unknown blob")? {
        BlobSource::File(path) => Ok(std::fs::read(path)?),
        BlobSource::Memory(content) => Ok(content.to_vec()),
    }
}

/// Red is near, blue is far.
fn distance_color(distance_m: f64) -> Rgb<u8> {
    let far = (distance_m / 40.0).clamp(0.0, 1.0);
    Rgb([(255.0 * (1.0 - far)) as u8, 80, (255.0 * far) as u8])
}
