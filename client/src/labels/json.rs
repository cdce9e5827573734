//! Everything a sample says, as JSON.

use std::collections::BTreeMap;

use backlot_proto::v1;
use serde::Serialize;

use super::mask::compressed;
use super::{boxes_of, kitti_type, origin_name};
use crate::geometry::{rigid_from_wire, vector_from_wire};

/// One sample, one frame a record. Frames, units and names are those of `backlot.v1`; quaternions are w, x, y, z and boxes
/// x_min, y_min, x_max, y_max in continuous pixels.
#[derive(Clone, Debug, Serialize)]
pub struct SampleRecord {
    pub index: u64,
    /// Position in a clip.
    pub frame_id: usize,
    pub camera_id: String,
    pub frame_index: u32,
    pub timestamp_ns: i64,
    pub camera: CameraRecord,
    pub world_from_ego: PoseRecord,
    pub depth_unit_m: f64,
    pub objects: Vec<ObjectRecord>,
    pub provenance: ProvenanceRecord,
    /// Placement attempts rejected, by reason.
    pub rejections: BTreeMap<String, u32>,
}

#[derive(Clone, Debug, Serialize)]
pub struct CameraRecord {
    pub width: u32,
    pub height: u32,
    pub focal_px: [f64; 2],
    pub principal_px: [f64; 2],
    pub world_from_camera: PoseRecord,
}

#[derive(Clone, Debug, Serialize)]
pub struct PoseRecord {
    pub rotation_wxyz: [f64; 4],
    pub translation_m: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
pub struct ObjectRecord {
    pub instance_id: u32,
    pub origin: &'static str,
    pub class: &'static str,
    /// Length, width, height.
    pub size_m: [f64; 3],
    pub world_from_cuboid: PoseRecord,
    pub camera_from_cuboid: PoseRecord,
    pub ego_from_cuboid: PoseRecord,
    /// In the world; `None` where the log does not tell.
    pub velocity_mps: Option<[f64; 3]>,
    pub box_amodal: Option<[f64; 4]>,
    pub box_visible: Option<[f64; 4]>,
    pub visible_pixels: u32,
    /// Its pixels, in COCO's compressed run lengths.
    pub mask: MaskRecord,
    pub visible_fraction: f64,
    pub truncation: f64,
    pub occluder_instance_id: Option<u32>,
    pub lidar_points: u32,
    pub beyond_coverage: bool,
    pub asset: Option<String>,
    pub track_id: Option<String>,
    pub source_log: Option<String>,
    pub source_track_id: Option<String>,
    /// How the asset's colours were matched to the frame.
    pub tone: Option<ToneRecord>,
    /// How it was moved from its source's sunlight into that of its place.
    pub relight: Option<RelightRecord>,
}

/// Mean parts of the sun that reach an object, 0..1.
#[derive(Clone, Debug, Serialize)]
pub struct RelightRecord {
    pub source_sun: f64,
    pub place_sun: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct MaskRecord {
    /// Height, width.
    pub size: [u32; 2],
    pub counts: String,
}

/// sRGB channel c became gain * c + offset: red, green, blue.
#[derive(Clone, Debug, Serialize)]
pub struct ToneRecord {
    pub gain: Vec<f64>,
    pub offset: Vec<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub struct ProvenanceRecord {
    pub library_snapshot: String,
    pub background: String,
    pub seed: u64,
    pub render_class: String,
    pub insert_shadows: bool,
    /// Unit vector towards the sun in the log's world frame.
    pub sun_direction_world: Option<[f64; 3]>,
    /// "recipe", "log" or "estimated"; absent without a direction.
    pub sun_source: Option<&'static str>,
    pub synthetic: bool,
    pub objects: Vec<String>,
}

/// The record of frame `position` of a sample.
pub fn sample_record(sample: &v1::Sample, position: usize) -> SampleRecord {
    let frame = &sample.frames[position];
    let view = frame.view.unwrap_or_default();
    let provenance = sample.provenance.clone().unwrap_or_default();
    let sun_source = sun_source(provenance.sun_source());
    SampleRecord {
        index: sample.index,
        frame_id: position,
        camera_id: frame.camera_id.clone(),
        frame_index: frame.frame_index,
        timestamp_ns: frame.timestamp_ns,
        camera: CameraRecord {
            width: view.width,
            height: view.height,
            focal_px: [view.focal_x_px, view.focal_y_px],
            principal_px: [view.principal_x_px, view.principal_y_px],
            world_from_camera: pose(view.world_from_camera.as_ref()),
        },
        world_from_ego: pose(frame.world_from_ego.as_ref()),
        depth_unit_m: frame.depth_unit_m,
        objects: boxes_of(sample, frame)
            .map(|(box_3d, box_2d)| object_record(&view, box_3d, box_2d))
            .collect(),
        provenance: ProvenanceRecord {
            library_snapshot: provenance.library_snapshot,
            background: provenance.background,
            seed: provenance.seed,
            render_class: provenance.render_class,
            insert_shadows: provenance.insert_shadows,
            sun_direction_world: provenance.sun_direction_world.map(|d| [d.x, d.y, d.z]),
            sun_source,
            synthetic: provenance.synthetic,
            objects: provenance.objects,
        },
        // The wire's map has no order; files must be equal byte for byte.
        rejections: sample.rejections.clone().into_iter().collect(),
    }
}

fn sun_source(source: v1::SunSource) -> Option<&'static str> {
    match source {
        v1::SunSource::Unspecified => None,
        v1::SunSource::Recipe => Some("recipe"),
        v1::SunSource::Log => Some("log"),
        v1::SunSource::Estimated => Some("estimated"),
    }
}

fn object_record(
    view: &v1::CameraView,
    box_3d: &v1::SampleBox,
    box_2d: &v1::SampleBox2D,
) -> ObjectRecord {
    let cuboid = box_3d.cuboid.unwrap_or_default();
    let some = |text: &String| (!text.is_empty()).then(|| text.clone());
    ObjectRecord {
        instance_id: box_3d.instance_id,
        origin: origin_name(box_3d.origin()),
        class: kitti_type(box_3d.object_class()),
        size_m: vector_from_wire(cuboid.size_m.as_ref()).to_array(),
        world_from_cuboid: pose(box_2d.world_from_cuboid.as_ref()),
        camera_from_cuboid: pose(box_2d.camera_from_cuboid.as_ref()),
        ego_from_cuboid: pose(box_2d.ego_from_cuboid.as_ref()),
        velocity_mps: box_2d.velocity_mps.map(|v| [v.x, v.y, v.z]),
        box_amodal: box_2d.amodal.as_ref().map(bounds),
        box_visible: box_2d.visible.as_ref().map(bounds),
        visible_pixels: box_2d.visible_pixels,
        mask: MaskRecord {
            size: [view.height, view.width],
            counts: compressed(&box_2d.mask_runs),
        },
        visible_fraction: box_2d.visible_fraction,
        truncation: box_2d.truncation,
        occluder_instance_id: Some(box_2d.occluder_instance_id).filter(|id| *id != 0),
        lidar_points: box_2d.lidar_points,
        beyond_coverage: box_3d.beyond_coverage,
        asset: some(&box_3d.asset),
        track_id: some(&box_3d.track_id),
        source_log: some(&box_3d.source_log),
        source_track_id: some(&box_3d.source_track_id),
        tone: box_3d.tone.as_ref().map(|tone| ToneRecord {
            gain: tone.gain.clone(),
            offset: tone.offset.clone(),
        }),
        relight: box_3d.relight.map(|relight| RelightRecord {
            source_sun: relight.source_sun,
            place_sun: relight.place_sun,
        }),
    }
}

fn pose(rigid: Option<&v1::RigidTransform>) -> PoseRecord {
    let rigid = rigid_from_wire(rigid);
    let q = rigid.rotation;
    PoseRecord {
        rotation_wxyz: [q.w, q.x, q.y, q.z],
        translation_m: rigid.translation_m.to_array(),
    }
}

fn bounds(b: &v1::Box2D) -> [f64; 4] {
    [b.x_min, b.y_min, b.x_max, b.y_max]
}
