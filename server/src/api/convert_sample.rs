//! Samples as they are sent.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::scene::{Daylight, FrameLabel, Origin, PixelBox, SunSource};
use backlot_proto::v1;

use super::convert_drive_log::{object_class_to_wire, rigid_to_wire, vector_to_wire};
use crate::domain::blob::Digest;
use crate::samples::{DEPTH_UNIT_M, Sample, SampleBox, SampleFrame, SamplePlan};

/// Where a sample comes from, besides what it knows itself.
#[derive(Clone, Debug)]
pub(super) struct Origins {
    pub snapshot: Digest,
    /// Empty if there is none.
    pub background: String,
    pub seed: u64,
}

pub(super) fn sample_to_wire(sample: Sample, index: u64, origins: &Origins) -> v1::Sample {
    let boxes_3d: Vec<v1::SampleBox> = sample.boxes.iter().map(box_to_wire).collect();
    let mut objects: Vec<String> = boxes_3d.iter().map(|b| b.asset.clone()).collect();
    objects.retain(|asset| !asset.is_empty());
    objects.sort();
    objects.dedup();
    let weakest_usage = match sample.has_replay_only {
        true => v1::AssetUsage::ReplayOnly,
        false => v1::AssetUsage::Library,
    };
    v1::Sample {
        index,
        boxes_3d,
        provenance: Some(v1::SampleProvenance {
            library_snapshot: format!("librarySnapshots/{}", origins.snapshot),
            background: origins.background.clone(),
            seed: origins.seed,
            render_class: sample.render_class.clone(),
            insert_shadows: sample.insert_shadows,
            synthetic: sample.synthetic,
            objects,
            weakest_usage: weakest_usage.into(),
            sun_direction_world: sample
                .daylight
                .map(|day| vector_to_wire(day.sun_direction_local)),
            sun_source: sun_source(sample.daylight.as_ref()).into(),
            sun_share: sample
                .daylight
                .map_or_else(Vec::new, |day| day.sun_share.to_vec()),
        }),
        rejections: sample.rejections.into_iter().collect(),
        frames: sample
            .frames
            .into_iter()
            .map(|frame| frame_to_wire(frame, &sample.world_from_local))
            .collect(),
    }
}

pub(super) fn plan_to_wire(plan: SamplePlan, index: u64) -> v1::SamplePlan {
    v1::SamplePlan {
        index,
        camera_id: plan.camera_id,
        frame_index: plan.frame_index,
        view: Some(view_to_wire(&plan.camera, &plan.world_from_camera)),
        world_from_ego: Some(rigid_to_wire(&plan.world_from_ego)),
        boxes_3d: plan.boxes.iter().map(box_to_wire).collect(),
        rejections: plan.rejections.into_iter().collect(),
    }
}

fn sun_source(daylight: Option<&Daylight>) -> v1::SunSource {
    match daylight.map(|day| day.source) {
        None => v1::SunSource::Unspecified,
        Some(SunSource::Recipe) => v1::SunSource::Recipe,
        Some(SunSource::Log) => v1::SunSource::Log,
        Some(SunSource::Estimated) => v1::SunSource::Estimated,
    }
}

fn frame_to_wire(frame: SampleFrame, world_from_local: &Rigid) -> v1::SampleFrame {
    let labels = frame.labels.iter();
    v1::SampleFrame {
        boxes_2d: labels
            .map(|label| label_to_wire(label, world_from_local))
            .collect(),
        camera_id: frame.camera_id,
        timestamp_ns: frame.timestamp_ns,
        frame_index: frame.frame_index,
        view: Some(view_to_wire(&frame.camera, &frame.world_from_camera)),
        world_from_ego: Some(rigid_to_wire(&frame.world_from_ego)),
        image_png: frame.image_png,
        depth_png: frame.depth_png,
        depth_unit_m: DEPTH_UNIT_M,
        instance_png: frame.instance_png,
        ignore_png: frame.ignore_png,
        filled_pixels: frame.filled_px,
    }
}

fn view_to_wire(camera: &Camera, world_from_camera: &Rigid) -> v1::CameraView {
    v1::CameraView {
        width: camera.width,
        height: camera.height,
        focal_x_px: camera.focal_px.x,
        focal_y_px: camera.focal_px.y,
        principal_x_px: camera.principal_px.x,
        principal_y_px: camera.principal_px.y,
        world_from_camera: Some(rigid_to_wire(world_from_camera)),
    }
}

fn box_to_wire(sample_box: &SampleBox) -> v1::SampleBox {
    let origin = match sample_box.origin {
        Origin::Inserted => v1::BoxOrigin::Inserted,
        Origin::Replaced => v1::BoxOrigin::Replaced,
        Origin::Replayed => v1::BoxOrigin::Replayed,
        Origin::Recorded => v1::BoxOrigin::Recorded,
        Origin::Static => v1::BoxOrigin::Static,
        Origin::Moved => v1::BoxOrigin::Moved,
    };
    let object = sample_box.object.clone();
    let (asset, source_log, source_track_id) = object.map_or_else(Default::default, |object| {
        (object.asset, object.source_log, object.source_track_id)
    });
    v1::SampleBox {
        instance_id: sample_box.instance_id.into(),
        origin: origin.into(),
        object_class: object_class_to_wire(sample_box.class).into(),
        cuboid: Some(v1::Cuboid {
            world_from_cuboid: Some(rigid_to_wire(&sample_box.world_from_object)),
            size_m: Some(vector_to_wire(sample_box.size_m)),
        }),
        asset,
        track_id: sample_box.track_id.clone(),
        source_log,
        source_track_id,
        beyond_coverage: sample_box.beyond_coverage,
        tone: sample_box.tone.map(|tone| v1::Tone {
            gain: tone.gain.map(f64::from).to_vec(),
            offset: tone.offset.map(f64::from).to_vec(),
        }),
        relight: sample_box.relit.map(|relit| v1::Relight {
            source_sun: relit.source_sun,
            place_sun: relit.place_sun,
        }),
    }
}

fn label_to_wire(label: &FrameLabel, world_from_local: &Rigid) -> v1::SampleBox2D {
    let world_from_object = *world_from_local * label.local_from_object;
    v1::SampleBox2D {
        instance_id: label.instance_id.into(),
        amodal: label.amodal.as_ref().map(pixels_to_wire),
        visible: Some(pixels_to_wire(&label.visible)),
        visible_pixels: label.visible_px,
        visible_fraction: label.visible_fraction,
        truncation: label.truncation,
        occluder_instance_id: label.occluder.into(),
        camera_from_cuboid: Some(rigid_to_wire(&label.camera_from_object)),
        lidar_points: label.lidar_points,
        ego_from_cuboid: Some(rigid_to_wire(&label.ego_from_object)),
        world_from_cuboid: Some(rigid_to_wire(&world_from_object)),
        velocity_mps: label
            .velocity_mps
            .map(|v| vector_to_wire(world_from_local.direction(v))),
        mask_runs: label.mask_runs.clone(),
    }
}

fn pixels_to_wire(pixels: &PixelBox) -> v1::Box2D {
    v1::Box2D {
        x_min: pixels.min.x,
        y_min: pixels.min.y,
        x_max: pixels.max.x,
        y_max: pixels.max.y,
    }
}
