//! The JSON tables of a `v1.0-*` folder, read row by row: those of the whole set are larger than memory.

use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, Error as _, SeqAccess, Visitor};

use crate::read_log::{Error, Result};

#[derive(Debug, Deserialize)]
pub(super) struct SceneRow {
    pub token: String,
    pub name: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct SampleRow {
    pub token: String,
    /// Microseconds.
    pub timestamp: i64,
    pub scene_token: String,
    #[serde(default)]
    pub next: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct SampleDataRow {
    pub token: String,
    pub sample_token: String,
    pub ego_pose_token: String,
    pub calibrated_sensor_token: String,
    pub filename: String,
    /// Absent or 0 for point clouds.
    pub width: Option<u32>,
    pub height: Option<u32>,
    /// Microseconds.
    pub timestamp: i64,
    pub is_key_frame: bool,
    #[serde(default)]
    pub next: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct EgoPoseRow {
    pub token: String,
    pub translation: [f64; 3],
    /// w, x, y, z.
    pub rotation: [f64; 4],
    /// Microseconds.
    pub timestamp: i64,
}

#[derive(Debug, Deserialize)]
pub(super) struct CalibratedSensorRow {
    pub token: String,
    pub sensor_token: String,
    pub translation: [f64; 3],
    /// w, x, y, z.
    pub rotation: [f64; 4],
    /// Empty for sensors that are not cameras.
    pub camera_intrinsic: Vec<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
pub(super) struct SensorRow {
    pub token: String,
    pub channel: String,
    pub modality: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct AnnotationRow {
    pub sample_token: String,
    pub instance_token: String,
    #[serde(default)]
    pub visibility_token: String,
    /// Centre in the world.
    pub translation: [f64; 3],
    /// Width, length, height.
    pub size: [f64; 3],
    /// w, x, y, z.
    pub rotation: [f64; 4],
}

#[derive(Debug, Deserialize)]
pub(super) struct InstanceRow {
    pub token: String,
    pub category_token: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct CategoryRow {
    pub token: String,
    pub name: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct VisibilityRow {
    pub token: String,
    pub level: String,
}

/// The folder of the tables.
#[derive(Clone, Debug)]
pub(super) struct Tables {
    folder: PathBuf,
}

impl Tables {
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    pub(super) fn path(&self, table: &str) -> PathBuf {
        self.folder.join(format!("{table}.json"))
    }

    /// Calls `visit` for every row; its error is the table's.
    pub(super) fn each<T: DeserializeOwned>(
        &self,
        table: &str,
        mut visit: impl FnMut(T) -> Result<(), String>,
    ) -> Result<()> {
        let path = self.path(table);
        let hint = "a nuScenes folder v1.0-* holds the tables scene, sample, sample_data, ego_pose, calibrated_sensor, \
                    sensor, sample_annotation, instance, category and visibility";
        let file = File::open(&path).map_err(|e| Error::io(&path, e, hint))?;
        let mut json = serde_json::Deserializer::from_reader(BufReader::new(file));
        let rows = Rows {
            visit: &mut visit,
            row: PhantomData::<T>,
        };
        rows.deserialize(&mut json)
            .and_then(|()| json.end())
            .map_err(|e| table_error(&path, e))
    }

    /// The rows that `keep` wants.
    pub(super) fn rows<T: DeserializeOwned>(
        &self,
        table: &str,
        mut keep: impl FnMut(&T) -> bool,
    ) -> Result<Vec<T>> {
        let mut rows = Vec::new();
        self.each(table, |row| {
            if keep(&row) {
                rows.push(row);
            }
            Ok(())
        })?;
        Ok(rows)
    }

    /// The error of a row that another table names and this one lacks.
    pub(super) fn no_row(&self, table: &str, token: &str, named_by: &str) -> Error {
        let what = format!("no row has the token {token:?}, which {named_by} names");
        Error::malformed(&self.path(table), what)
    }
}

fn table_error(path: &Path, error: serde_json::Error) -> Error {
    match error.io_error_kind() {
        Some(kind) => Error::io(path, kind.into(), ""),
        None => Error::malformed(path, error.to_string()),
    }
}

/// A JSON array whose elements go to `visit` one at a time.
struct Rows<'f, T> {
    visit: &'f mut dyn FnMut(T) -> Result<(), String>,
    row: PhantomData<T>,
}

impl<'de, T: DeserializeOwned> DeserializeSeed<'de> for Rows<'_, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: DeserializeOwned> Visitor<'de> for Rows<'_, T> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<(), A::Error> {
        while let Some(row) = rows.next_element()? {
            (self.visit)(row).map_err(A::Error::custom)?;
        }
        Ok(())
    }
}
