//! Label files of samples.

mod json;

mod kitti;
mod kitti_tracking;
mod regions;

mod coco;
mod mask;

mod nuscenes;
mod token;

mod parquet_file;
mod waymo;

pub use coco::CocoSet;
pub use json::{SampleRecord, sample_record};
pub use kitti::{kitti_calibration, kitti_labels};
pub use kitti_tracking::kitti_tracking_labels;
pub use nuscenes::NuscenesTables;
pub(crate) use nuscenes::{NUSCENES_MAP, NUSCENES_VERSION};
pub use waymo::{waymo_components, waymo_segment};

use backlot_proto::v1;

/// Joins the 2D view of every box of a frame with its 3D box, in the order of instance ids.
fn boxes_of<'a>(
    sample: &'a v1::Sample,
    frame: &'a v1::SampleFrame,
) -> impl Iterator<Item = (&'a v1::SampleBox, &'a v1::SampleBox2D)> {
    frame.boxes_2d.iter().filter_map(|view| {
        let same = |b: &&v1::SampleBox| b.instance_id == view.instance_id;
        Some((sample.boxes_3d.iter().find(same)?, view))
    })
}

/// KITTI's type name of a class.
fn kitti_type(class: v1::ObjectClass) -> &'static str {
    match class {
        v1::ObjectClass::Car => "Car",
        v1::ObjectClass::Van => "Van",
        v1::ObjectClass::Truck => "Truck",
        v1::ObjectClass::Bus => "Bus",
        v1::ObjectClass::Tram => "Tram",
        v1::ObjectClass::Pedestrian => "Pedestrian",
        v1::ObjectClass::Cyclist => "Cyclist",
        v1::ObjectClass::Other | v1::ObjectClass::Unspecified => "Misc",
    }
}

/// The origin in lower case, e.g. "inserted".
pub fn origin_name(origin: v1::BoxOrigin) -> &'static str {
    match origin {
        v1::BoxOrigin::Unspecified => "unspecified",
        v1::BoxOrigin::Inserted => "inserted",
        v1::BoxOrigin::Replaced => "replaced",
        v1::BoxOrigin::Replayed => "replayed",
        v1::BoxOrigin::Recorded => "recorded",
        v1::BoxOrigin::Static => "static",
        v1::BoxOrigin::Moved => "moved",
    }
}

/// JSON as files hold it.
pub(crate) fn pretty(value: &impl serde::Serialize) -> String {
    let mut text = serde_json::to_string_pretty(value).expect("records have string keys");
    text.push('\n');
    text
}
