//! Labelled boxes put together to tracks.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec3;

use super::{Error, Result};
use crate::geometry::{rigid_to_wire, vector_to_wire};

/// A box that differs by more than this from its track's size is told about.
const SIZE_TOLERANCE_M: f64 = 0.1;
/// No road user is larger.
const MAX_SIZE_M: f64 = 100.0;

/// One labelled box.
#[derive(Clone, Debug)]
pub(crate) struct Observation {
    pub track_id: String,
    pub source_class: String,
    pub object_class: v1::ObjectClass,
    /// Length, width, height.
    pub size_m: DVec3,
    pub timestamp_ns: i64,
    pub world_from_cuboid: Rigid,
    pub occlusion: v1::Occlusion,
}

/// Tracks by id, their states by time. A track has the median size of its boxes, and the class of its first one.
///
/// # Errors
/// Names the file and a box without a track, a size that is none, or two boxes of a track at one time.
pub(crate) fn tracks(
    path: &Path,
    observations: Vec<Observation>,
    notes: &mut Vec<String>,
) -> Result<Vec<v1::Track>> {
    let mut by_track: BTreeMap<String, BTreeMap<i64, Observation>> = BTreeMap::new();
    for observation in observations {
        let at = observation.timestamp_ns;
        let id = observation.track_id.clone();
        if id.is_empty() {
            let what = format!("a {} box has no track", observation.source_class);
            return Err(Error::malformed(path, what));
        }
        let size = observation.size_m;
        // Minima pass over NaN.
        let fits = size.min_element() > 0.0 && size.max_element() <= MAX_SIZE_M;
        if !(size.is_finite() && fits) {
            let what = format!("track {id}: size {size} is not within 0 to {MAX_SIZE_M} m");
            return Err(Error::malformed(path, what));
        }
        let states = by_track.entry(id.clone()).or_default();
        if states.insert(at, observation).is_some() {
            let what = format!("track {id} has a second box at {at} ns");
            return Err(Error::malformed(path, what));
        }
    }
    let resized = by_track
        .values()
        .filter(|states| is_resized(states))
        .count();
    if resized > 0 {
        notes.push(format!(
            "{resized} tracks have boxes of changing size; each has the median of its boxes"
        ));
    }
    Ok(by_track.into_values().map(assemble).collect())
}

fn is_resized(states: &BTreeMap<i64, Observation>) -> bool {
    let size = median_size(states);
    let off = |o: &Observation| (o.size_m - size).abs().max_element() > SIZE_TOLERANCE_M;
    states.values().any(off)
}

fn assemble(states: BTreeMap<i64, Observation>) -> v1::Track {
    let size_m = median_size(&states);
    let first = states.values().next().expect("a track has a box");
    v1::Track {
        track_id: first.track_id.clone(),
        object_class: first.object_class.into(),
        source_class: first.source_class.clone(),
        size_m: Some(vector_to_wire(size_m)),
        states: states
            .values()
            .map(|observation| v1::TrackState {
                timestamp_ns: observation.timestamp_ns,
                world_from_cuboid: Some(rigid_to_wire(&observation.world_from_cuboid)),
                occlusion: observation.occlusion.into(),
                truncation: -1.0,
            })
            .collect(),
    }
}

fn median_size(states: &BTreeMap<i64, Observation>) -> DVec3 {
    let median = |axis: usize| {
        let mut values: Vec<f64> = states.values().map(|o| o.size_m[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    DVec3::new(median(0), median(1), median(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(track_id: &str, timestamp_ns: i64, length_m: f64) -> Observation {
        Observation {
            track_id: track_id.to_owned(),
            source_class: "car".to_owned(),
            object_class: v1::ObjectClass::Car,
            size_m: DVec3::new(length_m, 2.0, 1.5),
            timestamp_ns,
            world_from_cuboid: Rigid::IDENTITY,
            occlusion: v1::Occlusion::Unspecified,
        }
    }

    fn read(observations: &[Observation]) -> (Result<Vec<v1::Track>>, Vec<String>) {
        let mut notes = Vec::new();
        let tracks = tracks(Path::new("boxes"), observations.to_vec(), &mut notes);
        (tracks, notes)
    }

    #[test]
    fn boxes_become_tracks_in_time() {
        let boxes = [
            ("a", 20, 4.0),
            ("b", 10, 5.0),
            ("a", 10, 4.0),
            ("a", 30, 4.5),
        ]
        .map(|(id, at, length)| observation(id, at, length));
        let (tracks, notes) = read(&boxes);
        let tracks = tracks.unwrap();
        let times: Vec<i64> = tracks[0].states.iter().map(|s| s.timestamp_ns).collect();
        assert_eq!((tracks.len(), times), (2, vec![10, 20, 30]));
        assert_eq!(tracks[0].size_m.unwrap().x, 4.0);
        assert_eq!(notes.len(), 1);
    }

    #[test]
    fn boxes_that_make_no_track_are_named() {
        for (boxes, expected) in [
            ([("", 10, 4.0), ("a", 10, 4.0)], "has no track"),
            ([("a", 10, 4.0), ("a", 10, 4.0)], "second box at 10 ns"),
            ([("a", 10, 4.0), ("a", 20, 0.0)], "size"),
            ([("a", 10, 4.0), ("a", 20, f64::NAN)], "size"),
        ] {
            let (tracks, _) = read(&boxes.map(|(id, at, length)| observation(id, at, length)));
            let error = tracks.unwrap_err().to_string();
            assert!(
                error.starts_with("boxes: ") && error.contains(expected),
                "{error}"
            );
        }
    }
}
