//! Small drives written in the exact format of the raw data.

use std::fs;

use backlot_engine::camera::Camera;
use glam::{DVec2, DVec3};
use tempfile::TempDir;

use super::*;
use crate::geometry::{box_corners, rigid_from_wire, vector_from_wire};

/// Calibration with a rotated rectification, and a camera 2 that is off camera 0 along all axes.
pub(super) const CAM_TO_CAM: &str = "calib_time: 09-Jan-2012 13:57:47
S_rect_02: 6.400000e+01 3.200000e+01
R_rect_00: 9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 7.402527e-03 4.351614e-03 9.999631e-01
P_rect_02: 5.000000e+01 0.000000e+00 3.200000e+01 4.485728e+00 0.000000e+00 5.000000e+01 1.600000e+01 2.163791e-01 0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
";
pub(super) const VELO_TO_CAM: &str = "calib_time: 15-Mar-2012 11:37:16
R: 7.533745e-03 -9.999714e-01 -6.166020e-04 1.480249e-02 7.280733e-04 -9.998902e-01 9.998621e-01 7.523790e-03 1.480755e-02
T: -4.069766e-03 -7.631618e-02 -2.717806e-01
delta_f: 0.000000e+00 0.000000e+00
";
pub(super) const IMU_TO_VELO: &str = "R: 9.999976e-01 7.553071e-04 -2.035826e-03 -7.854027e-04 9.998898e-01 -1.482298e-02 2.024406e-03 1.482454e-02 9.998881e-01
T: -8.086759e-01 3.195559e-01 -7.997231e-01
";
const POSES: &str = "1 0 0 0 0 1 0 0 0 0 1 0
1 0 0 0 0 1 0 0 0 0 1 0.5
1 0 0 0 0 1 0 0 0 0 1 1.0
1 0 0 0 0 1 0 0 0 0 1 1.5
";
pub(super) const LABELS: &str = "0 -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1
1 7 Car 0 1 -1.57 20.0 10.0 40.0 20.0 1.50 1.60 4.00 1.00 1.65 12.00 -1.570796
2 7 Car 2 0 -1.57 20.0 10.0 40.0 20.0 1.50 1.60 4.00 1.00 1.65 12.00 -1.570796
9 7 Car 0 0 -1.57 20.0 10.0 40.0 20.0 1.50 1.60 4.00 1.00 1.65 12.00 -1.570796
";
const TRACKLETS: &str = r#"<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
  <count>1</count>
  <item_version>1</item_version>
  <item class_id="1" tracking_level="0" version="1">
    <objectType>Van</objectType>
    <h>2.0</h><w>1.9</w><l>4.5</l>
    <first_frame>1</first_frame>
    <poses class_id="2" tracking_level="0" version="0">
      <count>2</count>
      <item_version>2</item_version>
      <item class_id="3" tracking_level="0" version="2">
        <tx>10.0</tx><ty>-2.0</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>0.5</rz>
        <state>2</state><occlusion>1</occlusion><occlusion_kf>0</occlusion_kf><truncation>0</truncation>
      </item>
      <item>
        <tx>9.5</tx><ty>-2.0</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>0.5</rz>
        <state>2</state><occlusion>-1</occlusion><occlusion_kf>0</occlusion_kf><truncation>1</truncation>
      </item>
    </poses>
    <finished>1</finished>
  </item>
</tracklets>
</boost_serialization>
"#;

/// Frames 1 and 2 of a drive whose poses and labels cover more.
pub(super) struct Drive {
    folder: TempDir,
}

impl Drive {
    pub(super) fn new() -> Self {
        let drive = Self {
            folder: TempDir::new().unwrap(),
        };
        for (name, content) in [
            ("day/calib_cam_to_cam.txt", CAM_TO_CAM),
            ("day/calib_velo_to_cam.txt", VELO_TO_CAM),
            ("day/calib_imu_to_velo.txt", IMU_TO_VELO),
            ("poses.txt", POSES),
            ("labels.txt", LABELS),
            ("tracklets.xml", TRACKLETS),
        ] {
            drive.write(name, content.as_bytes());
        }
        for frame in [1, 2] {
            let image = image::RgbImage::from_pixel(64, 32, image::Rgb([frame, 20, 30]));
            let path = drive.path(&format!("day/drive/image_02/data/000000000{frame}.png"));
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            image.save(path).unwrap();
            let point: Vec<u8> = [10.0f32, 0.5, -1.0, 0.3]
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect();
            drive.write(
                &format!("day/drive/velodyne_points/data/000000000{frame}.bin"),
                &point,
            );
        }
        drive
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(super) fn write(&self, name: &str, content: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }

    pub(super) fn inputs(&self) -> KittiInputs {
        KittiInputs {
            drive_dir: self.path("day/drive"),
            calib_dir: None,
            poses: Some(self.path("poses.txt")),
            tracks: Some(self.path("labels.txt")),
        }
    }

    pub(super) fn error(&self) -> String {
        read_kitti_raw(&self.inputs()).unwrap_err().to_string()
    }
}

pub(super) fn wire_camera_model(camera: &v1::Camera) -> Camera {
    Camera {
        width: camera.width,
        height: camera.height,
        focal_px: DVec2::new(camera.focal_x_px, camera.focal_y_px),
        principal_px: DVec2::new(camera.principal_x_px, camera.principal_y_px),
        distortion: Default::default(),
    }
}

#[test]
fn poses_and_labels_of_a_pose_file_drive() {
    let log = read_kitti_raw(&Drive::new().inputs()).unwrap().drive_log;
    assert_eq!(log.frames.len(), 2);
    assert_eq!(log.frames[0].frame_index, 1);
    assert_eq!(
        log.frames[1].timestamp_ns - log.frames[0].timestamp_ns,
        103_300_000
    );
    assert_eq!(log.sweeps.len(), 2);
    // The world is the ego frame of frame 1; half a metre along the camera axis is half a metre along ego x.
    let first = rigid_from_wire(log.world_from_ego[0].pose.as_ref());
    assert!(first.translation_m.length() < 1e-9);
    let second = rigid_from_wire(log.world_from_ego[1].pose.as_ref());
    assert!((second.translation_m - DVec3::new(0.5, 0.0, 0.0)).length() < 0.02);
    assert!((second.translation_m.length() - 0.5).abs() < 1e-9);
    let track = &log.tracks[0];
    assert_eq!(track.track_id, "7");
    assert_eq!(track.states.len(), 2);
    assert_eq!(
        vector_from_wire(track.size_m.as_ref()),
        DVec3::new(4.0, 1.6, 1.5)
    );
    for text in ["0.1033", "2 poses", "1 boxes"] {
        assert!(
            log.notes.iter().any(|note| note.contains(text)),
            "{:?}",
            log.notes
        );
    }
}

/// A label's cuboid, taken through world and ego into camera 2, must land where `P_rect_02` puts its corners.
#[test]
fn cuboids_project_as_the_projection_matrix_does() {
    let log = read_kitti_raw(&Drive::new().inputs()).unwrap().drive_log;
    let camera = &log.cameras[0];
    let ego_from_camera = rigid_from_wire(camera.ego_from_camera.as_ref());
    let world_from_ego = rigid_from_wire(log.world_from_ego[0].pose.as_ref());
    let world_from_cuboid = rigid_from_wire(log.tracks[0].states[0].world_from_cuboid.as_ref());
    let camera_from_cuboid = (world_from_ego * ego_from_camera).inverse() * world_from_cuboid;
    let size = vector_from_wire(log.tracks[0].size_m.as_ref());
    for corner in box_corners(size) {
        // rotation_y = -pi/2: the car's x is camera z, its y is camera -x.
        let rect0 = DVec3::new(1.0 - corner.y, 1.65 - 0.75 - corner.z, 12.0 + corner.x);
        let w = rect0.z + 2.745884e-3;
        let expected = DVec2::new(
            (50.0 * rect0.x + 32.0 * rect0.z + 4.485728) / w + 0.5,
            (50.0 * rect0.y + 16.0 * rect0.z + 0.2163791) / w + 0.5,
        );
        let got = wire_camera_model(camera)
            .project(camera_from_cuboid.point(corner))
            .unwrap();
        assert!((got - expected).length() < 1e-4, "{got} {expected}");
        // Without the fourth column of P the result is far outside the tolerance.
        let without_offset = DVec2::new(
            50.0 * rect0.x / rect0.z + 32.5,
            50.0 * rect0.y / rect0.z + 16.5,
        );
        assert!((got - without_offset).length() > 0.1);
    }
}

#[test]
fn tracklets_are_bottom_centres_in_the_velodyne_frame() {
    let drive = Drive::new();
    let inputs = KittiInputs {
        tracks: Some(drive.path("tracklets.xml")),
        ..drive.inputs()
    };
    let log = read_kitti_raw(&inputs).unwrap().drive_log;
    let track = &log.tracks[0];
    assert_eq!(track.object_class(), v1::ObjectClass::Van);
    assert_eq!(track.states.len(), 2);
    let pose = rigid_from_wire(track.states[0].world_from_cuboid.as_ref());
    assert!((pose.translation_m - DVec3::new(10.0, -2.0, -0.7)).length() < 1e-9);
    assert!((pose.heading_rad() - 0.5).abs() < 1e-9);
    assert_eq!(track.states[0].occlusion(), v1::Occlusion::Partly);
    assert_eq!(track.states[1].truncation, -1.0);
}

#[test]
fn oxts_poses_follow_the_development_kit() {
    let drive = Drive::new();
    let packet = |lat: f64, yaw: f64| format!("{lat} 8.44 115.0 0.01 0.02 {yaw} 0 0 0\n");
    // A ten-thousandth of a degree of latitude is 11.1 m north.
    for (frame, lat) in [(1, 49.0), (2, 49.0001)] {
        let name = format!("day/drive/oxts/data/000000000{frame}.txt");
        drive.write(&name, packet(lat, 1.5).as_bytes());
    }
    drive.write(
        "day/drive/image_02/timestamps.txt",
        b"2011-09-26 13:02:25.0\n2011-09-26 13:02:25.1\n2011-09-26 13:02:25.2\n",
    );
    drive.write(
        "day/drive/oxts/timestamps.txt",
        b"2011-09-26 13:02:25.0\n2011-09-26 13:02:25.11\n2011-09-26 13:02:25.19\n",
    );
    let inputs = KittiInputs {
        poses: None,
        ..drive.inputs()
    };
    let log = read_kitti_raw(&inputs).unwrap().drive_log;
    // The images reach past the packets, so both ends are extrapolated.
    assert_eq!(log.world_from_ego.len(), 4);
    let poses: Vec<_> = log
        .world_from_ego
        .iter()
        .map(|timed| rigid_from_wire(timed.pose.as_ref()))
        .collect();
    let step = poses[2].translation_m - poses[1].translation_m;
    assert!(
        (step - DVec3::new(0.0, 11.13, 0.0)).length() < 0.01,
        "{step}"
    );
    let local_from_world = rigid_from_wire(log.local_from_world.as_ref());
    let heading = (local_from_world * poses[1]).heading_rad();
    assert!(heading.abs() < 1e-3, "{heading}");
}

#[test]
fn errors_name_file_line_and_field() {
    type Break = fn(&Drive);
    let cases: [(Break, &[&str]); 9] = [
        (
            |d| fs::remove_file(d.path("day/calib_cam_to_cam.txt")).unwrap(),
            &["calib_cam_to_cam.txt", "--calib-dir"],
        ),
        (
            |d| d.write("day/calib_cam_to_cam.txt", b"S_rect_02: 64 32\n"),
            &["calib_cam_to_cam.txt", "P_rect_02"],
        ),
        (
            |d| d.write("poses.txt", POSES.replace("0.5", "nan").as_bytes()),
            &["poses.txt:2", "pose[11]", "finite"],
        ),
        (
            |d| d.write("poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n1 2\n"),
            &["poses.txt:2", "2 numbers"],
        ),
        (
            |d| d.write("poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n"),
            &["poses.txt", "frame 1"],
        ),
        (
            |d| d.write("labels.txt", b"1 7 Car 0 1\n"),
            &["labels.txt:1", "5 columns"],
        ),
        (
            |d| d.write("day/drive/velodyne_points/data/0000000002.bin", b"12345"),
            &["0000000002.bin", "truncated"],
        ),
        (
            |d| d.write("day/drive/image_02/timestamps.txt", b"\nyesterday\n"),
            &["timestamps.txt:2", "yesterday"],
        ),
        (
            |d| fs::remove_dir_all(d.path("day/drive/image_02")).unwrap(),
            &["image_02/data", "KITTI raw"],
        ),
    ];
    for (break_it, expected) in cases {
        let drive = Drive::new();
        assert!(read_kitti_raw(&drive.inputs()).is_ok());
        break_it(&drive);
        let error = drive.error();
        for text in expected {
            assert!(error.contains(text), "{error:?} does not say {text:?}");
        }
    }
}

#[test]
fn a_truncated_image_is_named() {
    let drive = Drive::new();
    let name = "day/drive/image_02/data/0000000002.png";
    let content = fs::read(drive.path(name)).unwrap();
    drive.write(name, &content[..content.len() / 2]);
    let error = drive.error();
    assert!(
        error.contains("0000000002.png") && error.contains("does not decode"),
        "{error}"
    );
}
