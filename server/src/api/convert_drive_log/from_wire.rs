//! A driving log as it arrives.

use backlot_engine::camera::{Camera, Distortion};
use backlot_proto::v1;
use glam::DVec2;

use super::depth::{depth_map, sfm_points};
use super::fields::{FieldReader, Place};
use crate::domain::drive_log::{
    CameraFrame, DriveLog, LidarSweep, LogCamera, MANIFEST_VERSION, Occlusion, PointFormat,
    ReadoutDirection, TimedPose, Track, TrackState, Trajectory,
};
use crate::domain::ids::{DriveLogId, NameError};
use crate::ingest::Violations;

/// Converts a log, normalising its quaternions. Relations between fields and the content of blobs are checked by
/// [`crate::ingest::validate`].
///
/// # Errors
/// Every missing, non-finite or malformed field by its path; camera frames are also named by camera and index.
pub fn drive_log_from_wire(log: v1::DriveLog) -> Result<DriveLog, Violations> {
    let mut fields = FieldReader::default();
    let sun_direction_world = log.sun_direction_world.map(|sun| {
        let place = Place::new("sun_direction_world");
        let direction = fields.vector(&place, Some(sun));
        if direction.length() <= 1e-6 {
            fields.reject(&place, "has no direction");
        }
        direction.normalize_or_zero()
    });
    let id: DriveLogId = match log.name.parse() {
        Ok(id) => id,
        Err(error) => {
            let error: NameError = error;
            fields.reject(&Place::new("name"), &error.to_string());
            return Err(fields.violations);
        }
    };
    let converted = DriveLog {
        version: MANIFEST_VERSION,
        id,
        dataset: log.dataset,
        synthetic: log.synthetic,
        local_from_world: fields.rigid(&Place::new("local_from_world"), log.local_from_world),
        cameras: each(log.cameras, |i, c| camera(&mut fields, i, c)),
        world_from_ego: Trajectory::new(each(log.world_from_ego, |i, p| TimedPose {
            timestamp_ns: p.timestamp_ns,
            pose: fields.rigid(&Place::new(format!("world_from_ego[{i}]")), p.pose),
        })),
        frames: each(log.frames, |i, f| frame(&mut fields, i, f)),
        sweeps: each(log.sweeps, |i, s| sweep(&mut fields, i, s)),
        tracks: each(log.tracks, |i, t| track(&mut fields, i, t)),
        sfm_points: log.sfm_points.map(|sfm| sfm_points(&mut fields, sfm)),
        notes: log.notes,
        sun_direction_world,
    };
    fields.violations.into_result(converted)
}

fn each<A, B>(items: Vec<A>, mut convert: impl FnMut(usize, A) -> B) -> Vec<B> {
    items
        .into_iter()
        .enumerate()
        .map(|(i, item)| convert(i, item))
        .collect()
}

fn camera(fields: &mut FieldReader, i: usize, camera: v1::Camera) -> LogCamera {
    let place = Place::of(
        format!("cameras[{i}]"),
        format!("camera {}", camera.camera_id),
    );
    let distortion = distortion(fields, &place.field("distortion"), camera.distortion);
    let mut number = |name: &str, value| fields.finite(&place.field(name), value);
    let focal_px = DVec2::new(
        number("focal_x_px", camera.focal_x_px),
        number("focal_y_px", camera.focal_y_px),
    );
    let principal_px = DVec2::new(
        number("principal_x_px", camera.principal_x_px),
        number("principal_y_px", camera.principal_y_px),
    );
    LogCamera {
        ego_from_camera: fields.rigid(&place.field("ego_from_camera"), camera.ego_from_camera),
        camera_id: camera.camera_id,
        camera: Camera {
            width: camera.width,
            height: camera.height,
            focal_px,
            principal_px,
            distortion,
        },
    }
}

fn distortion(
    fields: &mut FieldReader,
    place: &Place,
    distortion: Option<v1::Distortion>,
) -> Distortion {
    let Some(distortion) = distortion else {
        return Distortion::None;
    };
    let k = &distortion.coefficients;
    for (i, &value) in k.iter().enumerate() {
        fields.finite(&place.field(&format!("coefficients[{i}]")), value);
    }
    let model = v1::DistortionModel::try_from(distortion.model);
    match (model, k.as_slice()) {
        (Ok(v1::DistortionModel::Unspecified), []) => Distortion::None,
        (Ok(v1::DistortionModel::BrownConrady), &[k1, k2, p1, p2, k3]) => {
            Distortion::BrownConrady {
                k: [k1, k2, p1, p2, k3],
            }
        }
        (Ok(v1::DistortionModel::KannalaBrandt), &[k1, k2, k3, k4]) => Distortion::KannalaBrandt {
            k: [k1, k2, k3, k4],
        },
        (Ok(model), k) => {
            let name = model.as_str_name();
            fields.reject(
                place,
                &format!("{name} does not take {} coefficients", k.len()),
            );
            Distortion::None
        }
        (Err(_), _) => {
            fields.reject(
                &place.field("model"),
                &format!("is {}, not a DistortionModel", distortion.model),
            );
            Distortion::None
        }
    }
}

fn frame(fields: &mut FieldReader, i: usize, frame: v1::CameraFrame) -> CameraFrame {
    let place = Place::of(
        format!("frames[{i}]"),
        format!("camera {}, frame {}", frame.camera_id, frame.frame_index),
    );
    for (name, value) in [
        ("exposure_ns", frame.exposure_ns),
        ("readout_ns", frame.readout_ns),
    ] {
        if value < 0 {
            fields.reject(&place.field(name), &format!("is {value}, below 0"));
        }
    }
    let readout_direction = match v1::ReadoutDirection::try_from(frame.readout_direction) {
        Ok(v1::ReadoutDirection::Unspecified) => ReadoutDirection::Unknown,
        Ok(v1::ReadoutDirection::TopToBottom) => ReadoutDirection::TopToBottom,
        Ok(v1::ReadoutDirection::BottomToTop) => ReadoutDirection::BottomToTop,
        Ok(v1::ReadoutDirection::LeftToRight) => ReadoutDirection::LeftToRight,
        Ok(v1::ReadoutDirection::RightToLeft) => ReadoutDirection::RightToLeft,
        Err(_) => {
            let what = format!("is {}, not a ReadoutDirection", frame.readout_direction);
            fields.reject(&place.field("readout_direction"), &what);
            ReadoutDirection::Unknown
        }
    };
    CameraFrame {
        frame_index: frame.frame_index,
        timestamp_ns: frame.timestamp_ns,
        exposure_ns: frame.exposure_ns,
        readout_ns: frame.readout_ns,
        readout_direction,
        image: fields.blob(&place.field("image"), frame.image),
        instance_mask: frame
            .instance_mask
            .map(|b| fields.blob_ref(&place.field("instance_mask"), b)),
        sky_mask: frame
            .sky_mask
            .map(|b| fields.blob_ref(&place.field("sky_mask"), b)),
        depth_map: frame
            .depth_map
            .map(|map| depth_map(fields, &place.field("depth_map"), map)),
        free_instance_mask: frame
            .free_instance_mask
            .map(|b| fields.blob_ref(&place.field("free_instance_mask"), b)),
        camera_id: frame.camera_id,
    }
}

fn sweep(fields: &mut FieldReader, i: usize, sweep: v1::LidarSweep) -> LidarSweep {
    let place = Place::of(format!("sweeps[{i}]"), format!("lidar {}", sweep.lidar_id));
    let format = match v1::PointFormat::try_from(sweep.format) {
        Ok(v1::PointFormat::XyziF32) => PointFormat::XyziF32,
        Ok(v1::PointFormat::XyzitF32) => PointFormat::XyzitF32,
        Ok(v1::PointFormat::Unspecified) | Err(_) => {
            let what = format!("is {}, not a PointFormat", sweep.format);
            fields.reject(&place.field("format"), &what);
            PointFormat::XyziF32
        }
    };
    LidarSweep {
        timestamp_ns: sweep.timestamp_ns,
        ego_from_lidar: fields.rigid(&place.field("ego_from_lidar"), sweep.ego_from_lidar),
        points: fields.blob(&place.field("points"), sweep.points),
        format,
        lidar_id: sweep.lidar_id,
    }
}

fn track(fields: &mut FieldReader, i: usize, track: v1::Track) -> Track {
    let place = Place::of(format!("tracks[{i}]"), format!("track {}", track.track_id));
    let states = each(track.states, |j, state| {
        track_state(fields, &place.field(&format!("states[{j}]")), state)
    });
    Track {
        class: fields.object_class(&place.field("object_class"), track.object_class),
        size_m: fields.vector(&place.field("size_m"), track.size_m),
        track_id: track.track_id,
        source_class: track.source_class,
        states,
    }
}

fn track_state(fields: &mut FieldReader, place: &Place, state: v1::TrackState) -> TrackState {
    fields.finite(&place.field("truncation"), f64::from(state.truncation));
    let occlusion = match v1::Occlusion::try_from(state.occlusion) {
        Ok(v1::Occlusion::Unspecified) => Occlusion::Unknown,
        Ok(v1::Occlusion::None) => Occlusion::None,
        Ok(v1::Occlusion::Partly) => Occlusion::Partly,
        Ok(v1::Occlusion::Largely) => Occlusion::Largely,
        Err(_) => {
            let what = format!("is {}, not an Occlusion", state.occlusion);
            fields.reject(&place.field("occlusion"), &what);
            Occlusion::Unknown
        }
    };
    TrackState {
        timestamp_ns: state.timestamp_ns,
        world_from_cuboid: fields.rigid(&place.field("world_from_cuboid"), state.world_from_cuboid),
        occlusion,
        truncation: state.truncation,
    }
}
