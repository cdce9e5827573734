//! Depth maps and points of structure from motion as they arrive.

use backlot_proto::v1;

use super::fields::{FieldReader, Place};
use crate::domain::drive_log::{DepthMap, DepthMapKind, SfmPoints};

/// Largest weight relative to a LiDAR return's: more would drown every other loss.
const MAX_WEIGHT: f64 = 10.0;

pub(super) fn depth_map(fields: &mut FieldReader, place: &Place, map: v1::DepthMap) -> DepthMap {
    if !(map.unit_m.is_finite() && map.unit_m > 0.0) {
        let what = format!(
            "is {}, not finite and positive: give the metres of camera z in one unit of the map",
            map.unit_m
        );
        fields.reject(&place.field("unit_m"), &what);
    }
    let kind = match v1::DepthMapKind::try_from(map.kind) {
        Ok(v1::DepthMapKind::Stereo) => DepthMapKind::Stereo,
        Ok(v1::DepthMapKind::Monocular) => DepthMapKind::Monocular,
        Ok(v1::DepthMapKind::Unspecified) | Err(_) => {
            let what = format!("is {}, neither STEREO nor MONOCULAR", map.kind);
            fields.reject(&place.field("kind"), &what);
            DepthMapKind::Monocular
        }
    };
    DepthMap {
        image: fields.blob(&place.field("image"), map.image),
        unit_m: map.unit_m,
        kind,
        weight: weight(fields, place, map.weight),
    }
}

pub(super) fn sfm_points(fields: &mut FieldReader, sfm: v1::SfmPoints) -> SfmPoints {
    let place = Place::new("sfm_points");
    SfmPoints {
        points: fields.blob(&place.field("points"), sfm.points),
        observations: sfm
            .observations
            .map(|b| fields.blob_ref(&place.field("observations"), b)),
        weight: weight(fields, &place, sfm.weight),
    }
}

fn weight(fields: &mut FieldReader, place: &Place, weight: f64) -> Option<f64> {
    if !(0.0..=MAX_WEIGHT).contains(&weight) {
        let what = format!("is {weight}, not within 0 to {MAX_WEIGHT}");
        fields.reject(&place.field("weight"), &what);
    }
    (weight > 0.0).then_some(weight)
}
