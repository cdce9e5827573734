//! KITTI object labels.

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec3;

use super::regions::bounding_boxes;
use super::{boxes_of, kitti_type};
use crate::geometry::{rigid_from_wire, vector_from_wire};

/// Visible fractions above which KITTI calls an object fully visible, and partly occluded.
const FULLY_VISIBLE: f64 = 0.8;
const PARTLY_VISIBLE: f64 = 0.4;

/// One line a visible object: `type truncated occluded alpha left top right bottom h w l x y z rotation_y`.
///
/// Positions are bottom centres in the frame of the sample's camera, whose projection matrix is [`kitti_calibration`]'s P2. The 2D box
/// bounds the visible pixels where the renderer knows them and is the clipped projection of the cuboid otherwise. Pixels count
/// from the centre of the first one, as KITTI does, so the boxes lie half a pixel left of and above the wire's. Regions of the ignore mask
/// become `DontCare` lines.
///
/// # Errors
/// If the ignore mask does not decode.
pub fn kitti_labels(
    sample: &v1::Sample,
    frame: &v1::SampleFrame,
) -> Result<String, image::ImageError> {
    let mut lines = String::new();
    for (box_3d, box_2d) in boxes_of(sample, frame) {
        if let Some(fields) = object_fields(frame, box_3d, box_2d) {
            let (class, truncation) = (kitti_type(box_3d.object_class()), box_2d.truncation);
            lines += &format!("{class} {truncation:.2} {fields}\n");
        }
    }
    if !frame.ignore_png.is_empty() {
        let mask = image::load_from_memory(&frame.ignore_png)?.into_luma8();
        for [left, top, right, bottom] in bounding_boxes(&mask) {
            lines += &format!(
                "DontCare -1 -1 -10 {left}.00 {top}.00 {right}.00 {bottom}.00 -1 -1 -1 -1000 -1000 -1000 -10\n"
            );
        }
    }
    Ok(lines)
}

/// The fields of an object's line after type and truncation; `None` without a visible pixel.
pub(super) fn object_fields(
    frame: &v1::SampleFrame,
    box_3d: &v1::SampleBox,
    box_2d: &v1::SampleBox2D,
) -> Option<String> {
    if box_2d.visible_pixels == 0 {
        return None;
    }
    let view = frame.view.unwrap_or_default();
    let last_pixel = [view.width, view.height].map(|n| f64::from(n) - 1.0);
    let bounds = box_2d.visible.or(box_2d.amodal)?;
    let x = [bounds.x_min, bounds.x_max].map(|x| (x - 0.5).clamp(0.0, last_pixel[0]));
    let y = [bounds.y_min, bounds.y_max].map(|y| (y - 0.5).clamp(0.0, last_pixel[1]));
    let size = vector_from_wire(box_3d.cuboid.as_ref().and_then(|c| c.size_m.as_ref()));
    let camera_from_cuboid = rigid_from_wire(box_2d.camera_from_cuboid.as_ref());
    let bottom = camera_from_cuboid.point(DVec3::new(0.0, 0.0, -size.z / 2.0));
    let rotation_y = rotation_y(&camera_from_cuboid);
    let alpha = wrapped(rotation_y - libm::atan2(bottom.x, bottom.z));
    let occluded = match box_2d.visible_fraction {
        f if f >= FULLY_VISIBLE => 0,
        f if f >= PARTLY_VISIBLE => 1,
        _ => 2,
    };
    Some(format!(
        "{occluded} {alpha:.4} {:.2} {:.2} {:.2} {:.2} {:.4} {:.4} {:.4} {:.4} {:.4} {:.4} {rotation_y:.4}",
        x[0], y[0], x[1], y[1], size.z, size.y, size.x, bottom.x, bottom.y, bottom.z,
    ))
}

/// Heading about the camera's y axis: 0 along camera x, pi/2 against camera z.
fn rotation_y(camera_from_cuboid: &Rigid) -> f64 {
    let forward = camera_from_cuboid.direction(DVec3::X);
    libm::atan2(-forward.z, forward.x)
}

fn wrapped(angle: f64) -> f64 {
    libm::remainder(angle, std::f64::consts::TAU)
}

/// A KITTI calibration file of a frame: every P is the frame's camera, rectification is the identity, and the
/// Velodyne frame is the ego frame.
pub fn kitti_calibration(frame: &v1::SampleFrame) -> String {
    let view = frame.view.unwrap_or_default();
    let (cx, cy) = (view.principal_x_px - 0.5, view.principal_y_px - 0.5);
    let projection = format!(
        "{:.9e} 0 {cx:.9e} 0 0 {:.9e} {cy:.9e} 0 0 0 1 0",
        view.focal_x_px, view.focal_y_px
    );
    let mut lines = String::new();
    for camera in 0..4 {
        lines += &format!("P{camera}: {projection}\n");
    }
    lines += "R0_rect: 1 0 0 0 1 0 0 0 1\n";
    let world_from_camera = rigid_from_wire(view.world_from_camera.as_ref());
    let world_from_ego = rigid_from_wire(frame.world_from_ego.as_ref());
    let camera_from_ego = world_from_camera.inverse() * world_from_ego;
    let rows = camera_from_ego.rotation_matrix().transpose();
    lines += "Tr_velo_to_cam:";
    for i in 0..3 {
        let (row, t) = (rows.col(i), camera_from_ego.translation_m[i]);
        lines += &format!(" {:.9e} {:.9e} {:.9e} {t:.9e}", row.x, row.y, row.z);
    }
    lines += "\nTr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n";
    lines
}

#[cfg(test)]
mod tests {
    use crate::geometry::{rigid_to_wire, vector_to_wire};
    use crate::kitti::camera_from_cuboid_rotation;

    use super::*;

    fn sample(rotation: f64, bottom: DVec3, size: DVec3) -> v1::Sample {
        let centre = bottom - DVec3::Y * (size.z / 2.0);
        let camera_from_cuboid = Rigid::new(camera_from_cuboid_rotation(rotation), centre);
        let bounds = v1::Box2D {
            x_min: 100.5,
            y_min: 50.5,
            x_max: 300.0,
            y_max: 384.0,
        };
        v1::Sample {
            boxes_3d: vec![v1::SampleBox {
                instance_id: 1,
                object_class: v1::ObjectClass::Van.into(),
                cuboid: Some(v1::Cuboid {
                    world_from_cuboid: None,
                    size_m: Some(vector_to_wire(size)),
                }),
                ..Default::default()
            }],
            frames: vec![v1::SampleFrame {
                view: Some(v1::CameraView {
                    width: 640,
                    height: 384,
                    ..Default::default()
                }),
                boxes_2d: vec![v1::SampleBox2D {
                    instance_id: 1,
                    visible: Some(bounds),
                    visible_pixels: 10,
                    visible_fraction: 0.5,
                    truncation: 0.25,
                    camera_from_cuboid: Some(rigid_to_wire(&camera_from_cuboid)),
                    ..Default::default()
                }],
                ..Default::default()
            }],
            ..Default::default()
        }
    }

    /// Position, size and heading read back from a line are what went in, for every heading.
    #[test]
    fn lines_round_trip() {
        let size = DVec3::new(4.5, 1.9, 2.0);
        let bottom = DVec3::new(-3.0, 1.6, 12.0);
        for step in -8..8 {
            let rotation = 0.39 * f64::from(step);
            let sample = sample(rotation, bottom, size);
            let line = kitti_labels(&sample, &sample.frames[0]).unwrap();
            let words: Vec<&str> = line.split_whitespace().collect();
            let v: Vec<f64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
            assert_eq!((words[0], words.len(), v[1]), ("Van", 15, 1.0));
            assert_eq!(v[3..7], [100.0, 50.0, 299.5, 383.0]);
            assert_eq!(v[7..10], [2.0, 1.9, 4.5]);
            assert!((DVec3::from_slice(&v[10..13]) - bottom).length() < 1e-3);
            assert!(wrapped(v[13] - rotation).abs() < 1e-3, "{rotation} {line}");
            let alpha = wrapped(rotation - libm::atan2(-3.0, 12.0));
            assert!(wrapped(v[2] - alpha).abs() < 1e-3);
        }
    }

    #[test]
    fn objects_without_a_visible_pixel_have_no_label() {
        let mut sample = sample(0.0, DVec3::Z * 10.0, DVec3::ONE);
        sample.frames[0].boxes_2d[0].visible_pixels = 0;
        assert_eq!(kitti_labels(&sample, &sample.frames[0]).unwrap(), "");
    }
}
