//! Rigid transforms in columns, and the ego poses of a log.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;

use super::feather::Columns;
use crate::read_log::content::rigid;
use crate::read_log::trajectory::Trajectory;
use crate::read_log::{Error, Result};

pub(super) const POSE_COLUMNS: [&str; 7] = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"];

pub(super) const EGO_POSES: &str = "city_SE3_egovehicle.feather";

/// The rigid transform of every row.
pub(super) fn rigids(columns: &Columns) -> Result<Vec<Rigid>> {
    let values: Vec<Vec<f64>> = POSE_COLUMNS
        .iter()
        .map(|column| columns.numbers(column))
        .collect::<Result<_>>()?;
    (0..values[0].len())
        .map(|i| {
            let [w, x, y, z, tx, ty, tz] = std::array::from_fn(|column| values[column][i]);
            rigid([w, x, y, z], [tx, ty, tz]).map_err(|what| columns.bad_row(i, what))
        })
        .collect()
}

/// Reads the trajectory of the ego vehicle in the city's frame.
pub(super) fn read_trajectory(log_dir: &Path) -> Result<Trajectory> {
    let path = log_dir.join(EGO_POSES);
    let wanted: Vec<&str> = POSE_COLUMNS.into_iter().chain(["timestamp_ns"]).collect();
    let columns = Columns::read(&path, &wanted, "")?;
    let times = columns.integers("timestamp_ns")?;
    let mut poses = BTreeMap::new();
    for (i, (time, pose)) in times.into_iter().zip(rigids(&columns)?).enumerate() {
        let later = poses.last_key_value().is_none_or(|(&last, _)| time > last);
        if time < 0 || !later {
            let what =
                format!("timestamps are out of order: {time} is not later than the row before");
            return Err(columns.bad_row(i, what));
        }
        poses.insert(time, pose);
    }
    if poses.is_empty() {
        return Err(Error::malformed(&path, "holds no pose"));
    }
    Ok(Trajectory::new(poses))
}
