//! Label files of the KITTI tracking benchmark.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1::Occlusion;
use glam::{DMat3, DQuat, DVec3};

use super::boxes::{LabelledBox, LabelledTrack};
use super::text;
use crate::read_log::{Error, Result};

/// Columns before the numbers: frame, track id, type.
const NAMED_COLUMNS: usize = 3;
const NUMBERS: [&str; 14] = [
    "truncated",
    "occluded",
    "alpha",
    "bbox left",
    "bbox top",
    "bbox right",
    "bbox bottom",
    "height",
    "width",
    "length",
    "x",
    "y",
    "z",
    "rotation_y",
];

/// Reads `frame track_id type truncated occluded alpha bbox(4) h w l x y z rotation_y [score]` lines.
///
/// Positions are the bottom centres in rectified camera 0. `DontCare` regions are left out.
pub(super) fn read(path: &Path, velodyne_from_camera0: &Rigid) -> Result<Vec<LabelledTrack>> {
    let content = text::read(path, "--tracks names a KITTI tracking label file")?;
    let mut rows: BTreeMap<i64, Vec<Row>> = BTreeMap::new();
    for (i, line) in content.lines().enumerate() {
        if let Some(row) = Row::parse(path, i + 1, line)? {
            rows.entry(row.track).or_default().push(row);
        }
    }
    rows.into_iter()
        .map(|(track, rows)| assemble(path, track, &rows, velodyne_from_camera0))
        .collect()
}

struct Row {
    line: usize,
    frame: u32,
    track: i64,
    source_class: String,
    values: [f64; NUMBERS.len()],
}

impl Row {
    /// `None` for blank lines and `DontCare`.
    fn parse(path: &Path, line: usize, content: &str) -> Result<Option<Self>> {
        let words: Vec<&str> = content.split_whitespace().collect();
        if words.is_empty() || words.get(2) == Some(&"DontCare") {
            return Ok(None);
        }
        let needed = NAMED_COLUMNS + NUMBERS.len();
        if words.len() < needed {
            let what = format!("{} columns, a tracking label has {needed}", words.len());
            return Err(Error::at_line(path, line, what));
        }
        let integer = |name: &str, word: &str| {
            word.parse::<i64>().map_err(|_| {
                Error::at_line(path, line, format!("{name} is {word:?}, not an integer"))
            })
        };
        let frame = u32::try_from(integer("frame", words[0])?)
            .map_err(|_| Error::at_line(path, line, "frame is negative"))?;
        let mut values = [0.0; NUMBERS.len()];
        for (i, field) in NUMBERS.into_iter().enumerate() {
            values[i] = text::number(path, line, field, words[NAMED_COLUMNS + i])?;
        }
        if values[7..10].iter().any(|size| *size <= 0.0) {
            let what = "height, width and length must be positive";
            return Err(Error::at_line(path, line, what));
        }
        Ok(Some(Self {
            line,
            frame,
            track: integer("track id", words[1])?,
            source_class: words[2].to_owned(),
            values,
        }))
    }

    /// Length, width, height.
    fn size_m(&self) -> DVec3 {
        DVec3::new(self.values[9], self.values[8], self.values[7])
    }

    fn camera0_from_cuboid(&self, height_m: f64) -> Rigid {
        let bottom = DVec3::from_slice(&self.values[10..13]);
        // Camera y points down.
        let centre = bottom - DVec3::Y * (height_m / 2.0);
        Rigid::new(camera_from_cuboid_rotation(self.values[13]), centre)
    }
}

/// The cuboid's axes (x forward, y left, z up) in a camera frame for KITTI's `rotation_y`, which turns about camera y (down).
pub(crate) fn camera_from_cuboid_rotation(rotation_y: f64) -> DQuat {
    let (sin, cos) = (libm::sin(rotation_y), libm::cos(rotation_y));
    let forward = DVec3::new(cos, 0.0, -sin);
    let up = DVec3::NEG_Y;
    DQuat::from_mat3(&DMat3::from_cols(forward, up.cross(forward), up)).normalize()
}

fn assemble(
    path: &Path,
    track: i64,
    rows: &[Row],
    velodyne_from_camera0: &Rigid,
) -> Result<LabelledTrack> {
    let size_m = median_size(rows);
    let mut boxes = BTreeMap::new();
    for row in rows {
        let labelled = LabelledBox {
            velodyne_from_cuboid: *velodyne_from_camera0 * row.camera0_from_cuboid(size_m.z),
            occlusion: match row.values[1] as i64 {
                0 => Occlusion::None,
                1 => Occlusion::Partly,
                2 => Occlusion::Largely,
                _ => Occlusion::Unspecified,
            },
            // The benchmark's files carry a level (0, 1, 2), not a fraction; only "not at all" is a fraction as well.
            truncation: if row.values[0] == 0.0 { 0.0 } else { -1.0 },
        };
        if boxes.insert(row.frame, labelled).is_some() {
            let what = format!("track {track} has a second box in frame {}", row.frame);
            return Err(Error::at_line(path, row.line, what));
        }
    }
    Ok(LabelledTrack {
        track_id: track.to_string(),
        source_class: rows[0].source_class.clone(),
        size_m,
        boxes,
    })
}

/// The manifest keeps one size a track; files may repeat it with small differences.
fn median_size(rows: &[Row]) -> DVec3 {
    let median = |axis: usize| {
        let mut values: Vec<f64> = rows.iter().map(|row| row.size_m()[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    DVec3::new(median(0), median(1), median(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_car_driving_ahead_faces_along_the_camera() {
        let rotation = camera_from_cuboid_rotation(-std::f64::consts::FRAC_PI_2);
        assert!((rotation * DVec3::X - DVec3::Z).length() < 1e-12);
        assert!((rotation * DVec3::Y - DVec3::NEG_X).length() < 1e-12);
        assert!((rotation * DVec3::Z - DVec3::NEG_Y).length() < 1e-12);
    }

    #[test]
    fn rotation_zero_faces_right() {
        let rotation = camera_from_cuboid_rotation(0.0);
        assert!((rotation * DVec3::X - DVec3::X).length() < 1e-12);
        assert!((rotation * DVec3::Y - DVec3::Z).length() < 1e-12);
    }
}
