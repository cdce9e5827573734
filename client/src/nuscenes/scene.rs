//! The rows of one scene, picked out of the tables.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use backlot_engine::camera::Rigid;

use super::tables::{
    CalibratedSensorRow, EgoPoseRow, SampleDataRow, SampleRow, SceneRow, SensorRow, Tables,
};
use crate::read_log::content::{rigid, time_of_micros};
use crate::read_log::{Error, Result, choice};

/// One scene: its keyframe times, its sensors and what they recorded.
#[derive(Debug)]
pub(super) struct Scene {
    pub name: String,
    /// Keyframe times in nanoseconds by sample token.
    pub samples: BTreeMap<String, i64>,
    /// By channel, e.g. `CAM_FRONT`.
    pub sensors: BTreeMap<String, Sensor>,
    /// `world_from_ego` by time; the ego frame is at the middle of the rear axle.
    pub ego_poses: BTreeMap<i64, Rigid>,
}

/// A sensor of the scene and its recordings in time.
#[derive(Debug)]
pub(super) struct Sensor {
    pub modality: String,
    pub ego_from_sensor: Rigid,
    /// Rows of the matrix; empty for sensors that are not cameras.
    pub intrinsic: Vec<[f64; 3]>,
    pub recordings: Vec<Recording>,
}

#[derive(Debug)]
pub(super) struct Recording {
    pub timestamp_ns: i64,
    pub filename: String,
    pub size: (u32, u32),
    pub is_key_frame: bool,
}

impl Scene {
    /// Reads the scene of that name or token; without one the tables must hold a single scene.
    pub(super) fn read(tables: &Tables, root: &Path, wanted: Option<&str>) -> Result<Self> {
        let scene = choose(tables, root, wanted)?;
        let samples = read_samples(tables, &scene)?;
        let recorded = tables.rows("sample_data", |row: &SampleDataRow| {
            samples.contains_key(&row.sample_token)
        })?;
        check_order(
            &tables.path("sample_data"),
            recorded.iter().map(|r| (&*r.token, &*r.next, r.timestamp)),
        )?;
        let (ego_poses, placed) = read_ego_poses(tables, &recorded)?;
        let mut sensors = read_sensors(tables, &recorded)?;
        for row in recorded {
            let (channel, path) = (&row.calibrated_sensor_token, tables.path("sample_data"));
            let sensor = sensors
                .get_mut(channel)
                .expect("sensors of all rows are read");
            if !placed.contains(&row.ego_pose_token) {
                return Err(tables.no_row("ego_pose", &row.ego_pose_token, "sample_data.json"));
            }
            sensor.1.recordings.push(Recording {
                timestamp_ns: time_of_micros(row.timestamp)
                    .map_err(|what| Error::malformed(&path, what))?,
                filename: row.filename,
                size: (row.width.unwrap_or(0), row.height.unwrap_or(0)),
                is_key_frame: row.is_key_frame,
            });
        }
        Ok(Self {
            name: scene.name,
            samples,
            sensors: by_channel(tables, sensors)?,
            ego_poses,
        })
    }
}

fn choose(tables: &Tables, root: &Path, wanted: Option<&str>) -> Result<SceneRow> {
    let mut scenes: Vec<SceneRow> = tables.rows("scene", |_| true)?;
    let by_token = scenes
        .iter()
        .position(|scene| Some(&*scene.token) == wanted);
    let chosen = match by_token {
        Some(chosen) => chosen,
        None => {
            let names: Vec<String> = scenes.iter().map(|scene| scene.name.clone()).collect();
            let name = choice::choose(root, "scene", &names, wanted)?;
            let is_it = |candidate: &String| *candidate == name;
            names
                .iter()
                .position(is_it)
                .expect("the choice is one of them")
        }
    };
    Ok(scenes.swap_remove(chosen))
}

fn read_samples(tables: &Tables, scene: &SceneRow) -> Result<BTreeMap<String, i64>> {
    let path = tables.path("sample");
    let rows: Vec<SampleRow> =
        tables.rows("sample", |row: &SampleRow| row.scene_token == scene.token)?;
    check_order(
        &path,
        rows.iter().map(|r| (&*r.token, &*r.next, r.timestamp)),
    )?;
    if rows.is_empty() {
        let what = format!("scene {} has no sample", scene.name);
        return Err(Error::malformed(&path, what));
    }
    rows.into_iter()
        .map(|row| {
            let time =
                time_of_micros(row.timestamp).map_err(|what| Error::malformed(&path, what))?;
            Ok((row.token, time))
        })
        .collect()
}

/// Every row's `next` must be later than the row.
fn check_order<'a>(
    path: &Path,
    rows: impl Iterator<Item = (&'a str, &'a str, i64)> + Clone,
) -> Result<()> {
    let times: BTreeMap<&str, i64> = rows.clone().map(|(token, _, time)| (token, time)).collect();
    for (token, next, time) in rows {
        if times.get(next).is_some_and(|&later| later <= time) {
            let what = format!(
                "timestamps are out of order: {next:?} follows {token:?} ({time}) but is not later"
            );
            return Err(Error::malformed(path, what));
        }
    }
    Ok(())
}

/// The poses that the recordings name, by time, and the tokens found.
fn read_ego_poses(
    tables: &Tables,
    recorded: &[SampleDataRow],
) -> Result<(BTreeMap<i64, Rigid>, BTreeSet<String>)> {
    let wanted: BTreeSet<&str> = recorded.iter().map(|r| r.ego_pose_token.as_str()).collect();
    let mut poses = BTreeMap::new();
    let mut found = BTreeSet::new();
    tables.each("ego_pose", |row: EgoPoseRow| {
        if wanted.contains(row.token.as_str()) {
            let pose = rigid(row.rotation, row.translation)
                .map_err(|what| format!("row {}: {what}", row.token))?;
            poses.entry(time_of_micros(row.timestamp)?).or_insert(pose);
            found.insert(row.token);
        }
        Ok(())
    })?;
    Ok((poses, found))
}

/// Sensors by the token of their calibration, with the token of the sensor row.
fn read_sensors(
    tables: &Tables,
    recorded: &[SampleDataRow],
) -> Result<BTreeMap<String, (String, Sensor)>> {
    let wanted: BTreeSet<&str> = recorded
        .iter()
        .map(|r| r.calibrated_sensor_token.as_str())
        .collect();
    let mut sensors = BTreeMap::new();
    tables.each("calibrated_sensor", |row: CalibratedSensorRow| {
        if wanted.contains(row.token.as_str()) {
            let sensor = Sensor {
                modality: String::new(),
                ego_from_sensor: rigid(row.rotation, row.translation)
                    .map_err(|what| format!("row {}: {what}", row.token))?,
                intrinsic: row.camera_intrinsic,
                recordings: Vec::new(),
            };
            sensors.insert(row.token, (row.sensor_token, sensor));
        }
        Ok(())
    })?;
    match wanted.iter().find(|token| !sensors.contains_key(**token)) {
        Some(token) => Err(tables.no_row("calibrated_sensor", token, "sample_data.json")),
        None => Ok(sensors),
    }
}

fn by_channel(
    tables: &Tables,
    sensors: BTreeMap<String, (String, Sensor)>,
) -> Result<BTreeMap<String, Sensor>> {
    let rows: Vec<SensorRow> = tables.rows("sensor", |_| true)?;
    let mut named = BTreeMap::new();
    for (sensor_token, mut sensor) in sensors.into_values() {
        let row = rows
            .iter()
            .find(|row| row.token == sensor_token)
            .ok_or_else(|| tables.no_row("sensor", &sensor_token, "calibrated_sensor.json"))?;
        sensor.modality.clone_from(&row.modality);
        sensor.recordings.sort_by_key(|r| r.timestamp_ns);
        if named.insert(row.channel.clone(), sensor).is_some() {
            let what = format!("{} has two calibrations in one scene", row.channel);
            return Err(Error::malformed(&tables.path("calibrated_sensor"), what));
        }
    }
    Ok(named)
}
