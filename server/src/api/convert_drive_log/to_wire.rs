//! A driving log as it is sent back. Output-only fields (create time, manifest) are the caller's.

use backlot_engine::camera::{Distortion, Rigid};
use backlot_engine::class::ObjectClass;
use backlot_proto::v1;
use glam::DVec3;

use crate::domain::blob::BlobRef;
use crate::domain::drive_log::{
    CameraFrame, DepthMap, DepthMapKind, DriveLog, LidarSweep, LogCamera, Occlusion, PointFormat,
    ReadoutDirection, SfmPoints, Track, TrackState,
};

/// Converts a stored log; the inverse of `drive_log_from_wire` up to the norms of quaternions.
pub fn drive_log_to_wire(log: &DriveLog) -> v1::DriveLog {
    v1::DriveLog {
        name: log.id.to_string(),
        dataset: log.dataset.clone(),
        synthetic: log.synthetic,
        local_from_world: Some(rigid_to_wire(&log.local_from_world)),
        cameras: log.cameras.iter().map(camera).collect(),
        world_from_ego: log
            .world_from_ego
            .poses()
            .iter()
            .map(|p| v1::TimedPose {
                timestamp_ns: p.timestamp_ns,
                pose: Some(rigid_to_wire(&p.pose)),
            })
            .collect(),
        frames: log.frames.iter().map(frame).collect(),
        sweeps: log.sweeps.iter().map(sweep).collect(),
        tracks: log.tracks.iter().map(track).collect(),
        notes: log.notes.clone(),
        sun_direction_world: log.sun_direction_world.map(vector_to_wire),
        sfm_points: log.sfm_points.as_ref().map(sfm_points),
        create_time: None,
        manifest: None,
    }
}

/// The wire's enum value of a class.
pub fn object_class_to_wire(class: ObjectClass) -> v1::ObjectClass {
    match class {
        ObjectClass::Car => v1::ObjectClass::Car,
        ObjectClass::Van => v1::ObjectClass::Van,
        ObjectClass::Truck => v1::ObjectClass::Truck,
        ObjectClass::Bus => v1::ObjectClass::Bus,
        ObjectClass::Tram => v1::ObjectClass::Tram,
        ObjectClass::Pedestrian => v1::ObjectClass::Pedestrian,
        ObjectClass::Cyclist => v1::ObjectClass::Cyclist,
        ObjectClass::Other => v1::ObjectClass::Other,
    }
}

pub(crate) fn vector_to_wire(v: DVec3) -> v1::Vector3 {
    v1::Vector3 {
        x: v.x,
        y: v.y,
        z: v.z,
    }
}

pub(crate) fn rigid_to_wire(transform: &Rigid) -> v1::RigidTransform {
    let q = transform.rotation;
    v1::RigidTransform {
        rotation: Some(v1::Quaternion {
            w: q.w,
            x: q.x,
            y: q.y,
            z: q.z,
        }),
        translation_m: Some(vector_to_wire(transform.translation_m)),
    }
}

fn blob(blob: &BlobRef) -> v1::BlobRef {
    v1::BlobRef {
        digest: blob.digest.to_string(),
        size_bytes: blob.size_bytes,
    }
}

fn camera(camera: &LogCamera) -> v1::Camera {
    let model = &camera.camera;
    let distortion = match model.distortion {
        Distortion::None => None,
        Distortion::BrownConrady { k } => Some((v1::DistortionModel::BrownConrady, k.to_vec())),
        Distortion::KannalaBrandt { k } => Some((v1::DistortionModel::KannalaBrandt, k.to_vec())),
    };
    v1::Camera {
        camera_id: camera.camera_id.clone(),
        width: model.width,
        height: model.height,
        focal_x_px: model.focal_px.x,
        focal_y_px: model.focal_px.y,
        principal_x_px: model.principal_px.x,
        principal_y_px: model.principal_px.y,
        distortion: distortion.map(|(model, coefficients)| v1::Distortion {
            model: model.into(),
            coefficients,
        }),
        ego_from_camera: Some(rigid_to_wire(&camera.ego_from_camera)),
    }
}

fn frame(frame: &CameraFrame) -> v1::CameraFrame {
    let direction = match frame.readout_direction {
        ReadoutDirection::Unknown => v1::ReadoutDirection::Unspecified,
        ReadoutDirection::TopToBottom => v1::ReadoutDirection::TopToBottom,
        ReadoutDirection::BottomToTop => v1::ReadoutDirection::BottomToTop,
        ReadoutDirection::LeftToRight => v1::ReadoutDirection::LeftToRight,
        ReadoutDirection::RightToLeft => v1::ReadoutDirection::RightToLeft,
    };
    v1::CameraFrame {
        camera_id: frame.camera_id.clone(),
        frame_index: frame.frame_index,
        timestamp_ns: frame.timestamp_ns,
        exposure_ns: frame.exposure_ns,
        readout_ns: frame.readout_ns,
        readout_direction: direction.into(),
        image: Some(blob(&frame.image)),
        instance_mask: frame.instance_mask.as_ref().map(blob),
        sky_mask: frame.sky_mask.as_ref().map(blob),
        depth_map: frame.depth_map.as_ref().map(depth_map),
        free_instance_mask: frame.free_instance_mask.as_ref().map(blob),
    }
}

fn depth_map(map: &DepthMap) -> v1::DepthMap {
    let kind = match map.kind {
        DepthMapKind::Stereo => v1::DepthMapKind::Stereo,
        DepthMapKind::Monocular => v1::DepthMapKind::Monocular,
    };
    v1::DepthMap {
        image: Some(blob(&map.image)),
        unit_m: map.unit_m,
        kind: kind.into(),
        weight: map.weight.unwrap_or(0.0),
    }
}

fn sfm_points(sfm: &SfmPoints) -> v1::SfmPoints {
    v1::SfmPoints {
        points: Some(blob(&sfm.points)),
        observations: sfm.observations.as_ref().map(blob),
        weight: sfm.weight.unwrap_or(0.0),
    }
}

fn sweep(sweep: &LidarSweep) -> v1::LidarSweep {
    let format = match sweep.format {
        PointFormat::XyziF32 => v1::PointFormat::XyziF32,
        PointFormat::XyzitF32 => v1::PointFormat::XyzitF32,
    };
    v1::LidarSweep {
        lidar_id: sweep.lidar_id.clone(),
        timestamp_ns: sweep.timestamp_ns,
        ego_from_lidar: Some(rigid_to_wire(&sweep.ego_from_lidar)),
        points: Some(blob(&sweep.points)),
        format: format.into(),
    }
}

fn track(track: &Track) -> v1::Track {
    v1::Track {
        track_id: track.track_id.clone(),
        object_class: object_class_to_wire(track.class).into(),
        source_class: track.source_class.clone(),
        size_m: Some(vector_to_wire(track.size_m)),
        states: track.states.iter().map(track_state).collect(),
    }
}

fn track_state(state: &TrackState) -> v1::TrackState {
    let occlusion = match state.occlusion {
        Occlusion::Unknown => v1::Occlusion::Unspecified,
        Occlusion::None => v1::Occlusion::None,
        Occlusion::Partly => v1::Occlusion::Partly,
        Occlusion::Largely => v1::Occlusion::Largely,
    };
    v1::TrackState {
        timestamp_ns: state.timestamp_ns,
        world_from_cuboid: Some(rigid_to_wire(&state.world_from_cuboid)),
        occlusion: occlusion.into(),
        truncation: state.truncation,
    }
}
