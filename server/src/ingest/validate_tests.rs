//! A small whole log, and every way of breaking it.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io::Cursor;

use backlot_proto::v1;
use bytes::Bytes;
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, RgbImage};

use super::{LogBlobs, Violations, validate};
use crate::api::convert_drive_log::{drive_log_from_wire, drive_log_to_wire};
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::DriveLog;

#[derive(Default)]
struct Blobs(BTreeMap<Digest, Bytes>);

impl LogBlobs for Blobs {
    type Error = Infallible;

    fn size_bytes(&self, blob: &BlobRef) -> Result<Option<u64>, Infallible> {
        Ok(self.0.get(&blob.digest).map(|b| b.len() as u64))
    }

    fn read(&self, blob: &BlobRef) -> Result<Bytes, Infallible> {
        Ok(self.0[&blob.digest].clone())
    }
}

impl Blobs {
    fn add(&mut self, content: Vec<u8>) -> v1::BlobRef {
        let blob = BlobRef::of(&content);
        self.0.insert(blob.digest, content.into());
        v1::BlobRef {
            digest: blob.digest.to_string(),
            size_bytes: blob.size_bytes,
        }
    }
}

fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.into().write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn image_png(width: u32, height: u32) -> Vec<u8> {
    png(RgbImage::from_fn(width, height, |x, y| {
        image::Rgb([x as u8, y as u8, 7])
    }))
}

fn mask_png(value: u16) -> Vec<u8> {
    let mask: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_pixel(16, 12, Luma([value]));
    png(mask)
}

fn pose(x: f64, y: f64, z: f64) -> v1::RigidTransform {
    v1::RigidTransform {
        rotation: Some(v1::Quaternion {
            w: 1.0,
            ..Default::default()
        }),
        translation_m: Some(v1::Vector3 { x, y, z }),
    }
}

/// Camera x right, y down, z forward on an ego that looks along x.
fn ego_from_camera() -> v1::RigidTransform {
    v1::RigidTransform {
        rotation: Some(v1::Quaternion {
            w: 0.5,
            x: -0.5,
            y: 0.5,
            z: -0.5,
        }),
        ..pose(0.0, 0.0, 1.5)
    }
}

fn log(blobs: &mut Blobs) -> v1::DriveLog {
    let frame = |i: u32, blobs: &mut Blobs| v1::CameraFrame {
        camera_id: "image_02".into(),
        frame_index: 36 + i,
        timestamp_ns: 1_000 * i64::from(i),
        image: Some(blobs.add(image_png(16, 12))),
        instance_mask: Some(blobs.add(mask_png(1))),
        sky_mask: Some(blobs.add(png(image::GrayImage::new(16, 12)))),
        ..Default::default()
    };
    let states = (0..3).map(|i| v1::TrackState {
        timestamp_ns: 1_000 * i,
        world_from_cuboid: Some(pose(10.0, 0.0, 0.8)),
        ..Default::default()
    });
    v1::DriveLog {
        name: "driveLogs/street".into(),
        local_from_world: Some(pose(0.0, 0.0, 0.0)),
        cameras: vec![v1::Camera {
            camera_id: "image_02".into(),
            width: 16,
            height: 12,
            focal_x_px: 16.0,
            focal_y_px: 16.0,
            principal_x_px: 8.0,
            principal_y_px: 6.0,
            distortion: None,
            ego_from_camera: Some(ego_from_camera()),
        }],
        world_from_ego: (0..4)
            .map(|i| v1::TimedPose {
                timestamp_ns: 1_000 * i,
                pose: Some(pose(i as f64, 0.0, 0.0)),
            })
            .collect(),
        frames: (0..3).map(|i| frame(i, blobs)).collect(),
        sweeps: vec![v1::LidarSweep {
            lidar_id: "top".into(),
            timestamp_ns: 500,
            ego_from_lidar: Some(pose(0.0, 0.0, 1.7)),
            points: Some(blobs.add(vec![1; 160])),
            format: v1::PointFormat::XyziF32.into(),
        }],
        tracks: vec![v1::Track {
            track_id: "7".into(),
            object_class: v1::ObjectClass::Car.into(),
            source_class: "Car".into(),
            size_m: Some(v1::Vector3 {
                x: 4.0,
                y: 1.8,
                z: 1.5,
            }),
            states: states.collect(),
        }],
        ..Default::default()
    }
}

fn check(log: v1::DriveLog, blobs: &Blobs) -> Result<DriveLog, Violations> {
    let log = drive_log_from_wire(log)?;
    let Ok(result) = validate(&log, blobs);
    result.map(|_| log)
}

/// The one violation that `break_it` causes.
fn violation(break_it: impl FnOnce(&mut v1::DriveLog, &mut Blobs)) -> String {
    let mut blobs = Blobs::default();
    let mut broken = log(&mut blobs);
    break_it(&mut broken, &mut blobs);
    check(broken, &blobs).expect_err("broken").to_string()
}

#[test]
fn a_whole_log_is_accepted_and_survives_the_manifest_and_the_wire() {
    let mut blobs = Blobs::default();
    let wire = log(&mut blobs);
    let accepted = check(wire.clone(), &blobs).unwrap();
    let manifest = accepted.to_manifest();
    assert_eq!(DriveLog::from_manifest(&manifest).unwrap(), accepted);
    assert_eq!(drive_log_to_wire(&accepted), wire);
}

#[test]
fn nan_and_missing_fields_are_named() {
    let nan = violation(|log, _| {
        let pose = log.world_from_ego[3].pose.as_mut().unwrap();
        pose.translation_m.as_mut().unwrap().x = f64::NAN;
    });
    assert_eq!(nan, "world_from_ego[3].translation_m.x: is NaN");
    let missing = violation(|log, _| log.frames[1].image = None);
    assert_eq!(
        missing,
        "frames[1].image: (camera image_02, frame 37) is missing"
    );
    let scaled = violation(|log, _| {
        let pose = log.cameras[0].ego_from_camera.as_mut().unwrap();
        pose.rotation.as_mut().unwrap().w = 0.6;
    });
    assert!(
        scaled.contains("cameras[0].ego_from_camera.rotation"),
        "{scaled}"
    );
    assert!(scaled.contains("norm"), "{scaled}");
}

#[test]
fn broken_images_are_named_by_camera_and_frame() {
    let size = violation(|log, blobs| log.frames[1].image = Some(blobs.add(image_png(16, 11))));
    assert_eq!(
        size,
        "frames[1].image: (camera image_02, frame 37) image is 16x11, differs from the camera's 16x12"
    );
    let cut = violation(|log, blobs| {
        let mut png = image_png(16, 12);
        png.truncate(png.len() - 30);
        log.frames[1].image = Some(blobs.add(png));
    });
    assert!(cut.contains("frame 37) image does not decode"), "{cut}");
    let absent = violation(|log, _| {
        log.frames[2].image.as_mut().unwrap().digest = "a".repeat(64);
    });
    assert!(
        absent.contains("frames[2].image") && absent.contains("not uploaded"),
        "{absent}"
    );
    let value = violation(|log, blobs| log.frames[0].instance_mask = Some(blobs.add(mask_png(2))));
    assert!(
        value.contains("mask value 2 at pixel (0, 0) names no track"),
        "{value}"
    );
    let both = violation(|log, blobs| {
        log.frames[1].free_instance_mask = Some(blobs.add(mask_png(9)));
    });
    assert!(
        both.contains("frames[1].free_instance_mask") && both.contains("bring one"),
        "{both}"
    );
    let grey = violation(|log, blobs| {
        log.frames[1].instance_mask = None;
        log.frames[1].free_instance_mask = Some(blobs.add(png(image::GrayImage::new(16, 12))));
    });
    assert!(
        grey.contains("frame 37) mask is L8, not 16-bit grey"),
        "{grey}"
    );
    let unknown = {
        let mut blobs = Blobs::default();
        let mut log = log(&mut blobs);
        log.frames[0].instance_mask = Some(blobs.add(mask_png(u16::MAX)));
        check(log, &blobs)
    };
    assert!(unknown.is_ok());
}

#[test]
fn times_and_identities_are_checked() {
    let order = violation(|log, _| log.world_from_ego[2].timestamp_ns = 1_000);
    assert!(
        order.starts_with("world_from_ego[2].timestamp_ns: 1000 is not after"),
        "{order}"
    );
    let outside = violation(|log, _| log.frames[2].timestamp_ns = 3_001);
    assert!(
        outside.contains("outside the ego trajectory, 0 to 3000"),
        "{outside}"
    );
    let twice = violation(|log, _| log.frames[2].frame_index = 36);
    assert!(
        twice.contains("(camera image_02, frame 36) is not unique"),
        "{twice}"
    );
    let camera = violation(|log, _| log.frames[2].camera_id = "rear".into());
    assert!(camera.contains("names no camera"), "{camera}");
    let states = violation(|log, _| log.tracks[0].states.swap(0, 1));
    assert!(
        states.starts_with("tracks[0].states[1].timestamp_ns"),
        "{states}"
    );
    let name = violation(|log, _| log.name = "street".into());
    assert!(name.starts_with("name:"), "{name}");
}

#[test]
fn sweeps_must_be_whole() {
    let cut = violation(|log, blobs| log.sweeps[0].points = Some(blobs.add(vec![1; 100])));
    assert!(
        cut.contains("sweeps[0].points: (lidar top) sweep of 100 bytes is cut off"),
        "{cut}"
    );
    let empty = violation(|log, blobs| log.sweeps[0].points = Some(blobs.add(vec![0; 160])));
    assert!(empty.contains("no usable point"), "{empty}");
}

#[test]
fn a_track_that_no_camera_sees_is_a_warning() {
    let mut blobs = Blobs::default();
    let mut log = log(&mut blobs);
    for state in &mut log.tracks[0].states {
        state.world_from_cuboid = Some(pose(-50.0, 0.0, 0.0));
    }
    let log = drive_log_from_wire(log).unwrap();
    let Ok(accepted) = validate(&log, &blobs);
    assert_eq!(accepted.unwrap().warnings, ["no camera sees track 7"]);
}

fn depth_map(image: v1::BlobRef) -> v1::DepthMap {
    v1::DepthMap {
        image: Some(image),
        unit_m: 1.0 / 256.0,
        kind: v1::DepthMapKind::Stereo.into(),
        weight: 0.0,
    }
}

fn sfm_bytes(points: &[[f64; 3]]) -> Vec<u8> {
    let numbers = points.as_flattened().iter();
    numbers.flat_map(|v| v.to_le_bytes()).collect()
}

fn observation_bytes(pairs: &[[u32; 2]]) -> Vec<u8> {
    let numbers = pairs.as_flattened().iter();
    numbers.flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn depth_without_lidar_is_accepted_and_comes_back_and_named_in_a_warning() {
    type Edit = fn(&mut v1::DriveLog, &mut Blobs);
    let maps: Edit = |log, blobs| {
        let map = depth_map(blobs.add(mask_png(900)));
        log.frames[1].depth_map = Some(map);
    };
    let points: Edit = |log, blobs| {
        let points = sfm_bytes(&[[9.0, 1.0, 0.5], [8.0, 0.0, 0.1]]);
        let observations = observation_bytes(&[[1, 0], [0, 2]]);
        log.sfm_points = Some(v1::SfmPoints {
            points: Some(blobs.add(points)),
            observations: Some(blobs.add(observations)),
            weight: 0.4,
        });
    };
    let cases: [(&[Edit], &str); 4] = [
        (&[], "no LiDAR, depth map or SfM point"),
        (&[maps], "its depth maps"),
        (&[points], "its SfM points"),
        (&[maps, points], "its depth maps and SfM points"),
    ];
    for (edits, named) in cases {
        let mut blobs = Blobs::default();
        let mut log = log(&mut blobs);
        log.sweeps.clear();
        edits.iter().for_each(|edit| edit(&mut log, &mut blobs));
        let read = drive_log_from_wire(log.clone()).unwrap();
        let Ok(accepted) = validate(&read, &blobs);
        let warnings = accepted.unwrap().warnings;
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains(named), "{warnings:?}");
        let back = drive_log_to_wire(&read);
        assert_eq!(back.frames, log.frames);
        assert_eq!(back.sfm_points, log.sfm_points);
        assert_eq!(
            DriveLog::from_manifest(&read.to_manifest()).unwrap(),
            read,
            "stored and read again"
        );
    }
}

#[test]
fn the_stored_form_of_a_log_without_depth_maps_is_what_it_was() {
    let mut blobs = Blobs::default();
    let read = drive_log_from_wire(log(&mut blobs)).unwrap();
    let stored = String::from_utf8(read.to_manifest()).unwrap();
    assert!(!stored.contains("depth_map") && !stored.contains("sfm"));
}

#[test]
fn a_depth_map_that_cannot_be_used_is_refused() {
    type Break = fn(&mut v1::DepthMap, &mut Blobs);
    let cases: [(&str, Break); 9] = [
        (
            "image: (camera image_02, frame 37) depth map is 8x6, differs from the camera's 16x12",
            |m, b| {
                let small: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_pixel(8, 6, Luma([9]));
                m.image = Some(b.add(png(small)));
            },
        ),
        ("depth map is L8, not 16-bit grey", |m, b| {
            m.image = Some(b.add(png(image::GrayImage::new(16, 12))));
        }),
        ("depth map has no known pixel", |m, b| {
            m.image = Some(b.add(mask_png(0)))
        }),
        ("does not decode", |m, b| {
            m.image = Some(b.add(mask_png(7)[..60].to_vec()));
        }),
        (
            "unit_m: (camera image_02, frame 37) is 0, not finite and positive",
            |m, _| {
                m.unit_m = 0.0;
            },
        ),
        ("unit_m: (camera image_02, frame 37) is NaN", |m, _| {
            m.unit_m = f64::NAN
        }),
        ("unit_m: (camera image_02, frame 37) is -1", |m, _| {
            m.unit_m = -1.0
        }),
        ("kind: (camera image_02, frame 37) is 0, neither", |m, _| {
            m.kind = 0
        }),
        (
            "weight: (camera image_02, frame 37) is 11, not within",
            |m, _| m.weight = 11.0,
        ),
    ];
    for (named, break_it) in cases {
        let error = violation(|log, blobs| {
            let mut map = depth_map(blobs.add(mask_png(900)));
            break_it(&mut map, blobs);
            log.frames[1].depth_map = Some(map);
        });
        assert!(
            error.starts_with("frames[1].depth_map") && error.contains(named),
            "{error} does not say {named}"
        );
    }
}

#[test]
fn sfm_points_that_cannot_be_used_are_refused() {
    type Break = fn(&mut v1::SfmPoints, &mut Blobs);
    let cases: [(&str, Break); 7] = [
        ("sfm_points.points: has no point", |s, b| {
            s.points = Some(b.add(Vec::new()))
        }),
        ("sfm_points.points: 47 bytes are cut off", |s, b| {
            s.points = Some(b.add(vec![0; 47]));
        }),
        (
            "sfm_points.points: point 1 is [0, NaN, 0], not finite",
            |s, b| {
                s.points = Some(b.add(sfm_bytes(&[[1.0; 3], [0.0, f64::NAN, 0.0]])));
            },
        ),
        ("sfm_points.observations: 12 bytes are cut off", |s, b| {
            s.observations = Some(b.add(vec![0; 12]));
        }),
        (
            "sfm_points.observations: observation 1 names point 2 and frame 0, the log has 2 points",
            |s, b| {
                s.observations = Some(b.add(observation_bytes(&[[0, 0], [2, 0]])));
            },
        ),
        ("names point 0 and frame 3", |s, b| {
            s.observations = Some(b.add(observation_bytes(&[[0, 3]])));
        }),
        ("sfm_points.weight: is -1, not within", |s, _| {
            s.weight = -1.0
        }),
    ];
    for (named, break_it) in cases {
        let error = violation(|log, blobs| {
            let mut sfm = v1::SfmPoints {
                points: Some(blobs.add(sfm_bytes(&[[1.0; 3], [2.0; 3]]))),
                observations: None,
                weight: 0.0,
            };
            break_it(&mut sfm, blobs);
            log.sfm_points = Some(sfm);
        });
        assert!(error.contains(named), "{error} does not say {named}");
    }
}
