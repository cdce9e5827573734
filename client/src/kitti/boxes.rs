//! Labelled boxes of a drive, as the two file formats give them.

use std::collections::BTreeMap;

use backlot_engine::camera::Rigid;
use backlot_proto::v1::{ObjectClass, Occlusion};
use glam::DVec3;

/// A track before its poses are placed in the world.
#[derive(Clone, Debug)]
pub(super) struct LabelledTrack {
    pub track_id: String,
    pub source_class: String,
    /// Length, width, height in metres.
    pub size_m: DVec3,
    pub boxes: BTreeMap<u32, LabelledBox>,
}

/// One box at one frame.
#[derive(Clone, Debug)]
pub(super) struct LabelledBox {
    /// Cuboid frame: origin at the centre, x forward, y left, z up.
    pub velodyne_from_cuboid: Rigid,
    pub occlusion: Occlusion,
    /// Fraction outside the image; negative if unknown.
    pub truncation: f32,
}

/// The class of a KITTI type name.
pub(super) fn object_class(source_class: &str) -> ObjectClass {
    match source_class {
        "Car" => ObjectClass::Car,
        "Van" => ObjectClass::Van,
        "Truck" => ObjectClass::Truck,
        "Bus" => ObjectClass::Bus,
        "Tram" => ObjectClass::Tram,
        "Pedestrian" | "Person" | "Person_sitting" | "Person (sitting)" => ObjectClass::Pedestrian,
        "Cyclist" => ObjectClass::Cyclist,
        _ => ObjectClass::Other,
    }
}
