//! KITTI tracking labels of clips.

use backlot_proto::v1;

use super::kitti::object_fields;
use super::{boxes_of, kitti_type};

/// Truncations from which on KITTI's tracking labels call an object partly and largely truncated: the limits of its difficulties.
const PARTLY_TRUNCATED: f64 = 0.15;
const LARGELY_TRUNCATED: f64 = 0.5;

/// The label file of a clip: `frame track_id type truncated occluded alpha left top right bottom h w l x y z rotation_y` for every visible
/// object. Frames count from 0, a track id is the instance id, `truncated` is a level from 0 to 2, the rest as in [`super::kitti_labels`].
pub fn kitti_tracking_labels(sample: &v1::Sample) -> String {
    let mut lines = String::new();
    for (position, frame) in sample.frames.iter().enumerate() {
        for (box_3d, box_2d) in boxes_of(sample, frame) {
            let Some(fields) = object_fields(frame, box_3d, box_2d) else {
                continue;
            };
            let truncation = box_2d.truncation;
            let truncated = u8::from(truncation >= PARTLY_TRUNCATED)
                + u8::from(truncation >= LARGELY_TRUNCATED);
            let class = kitti_type(box_3d.object_class());
            let track = box_3d.instance_id;
            lines += &format!("{position} {track} {class} {truncated} {fields}\n");
        }
    }
    lines
}
