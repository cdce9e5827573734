//! Sparse points of structure from motion from a file beside a log: COLMAP's text model, PLY, or a table of x, y and z.

mod colmap;
mod ply;
mod table;

use std::path::{Path, PathBuf};

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec3;

use crate::geometry::rigid_from_wire;
use crate::read_log::{Error, ReadLog, Result};

/// What a server accepts of one log.
pub const MOST_POINTS: usize = 2_000_000;
/// Larger files hold more than that.
const MOST_BYTES: u64 = 1 << 30;
/// A cloud that nowhere comes this close to the drive is in another frame or of another scale.
const REACH_M: f64 = 200.0;

/// Where the points are and what they hold.
#[derive(Clone, Debug)]
pub struct SfmPointInputs {
    /// `points3D.txt` of COLMAP, with `images.txt` beside it if it is known which image saw which point; or `.ply`; or `.csv`.
    pub file: PathBuf,
    /// Metres in one unit of the file. Axes and origin are those of the log's world frame.
    pub unit_m: f64,
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
struct Cloud {
    /// In the file's units.
    points: Vec<DVec3>,
    /// Index of a point and of a frame of the log that saw it; `None` if the file does not say.
    observations: Option<Vec<(u32, u32)>>,
    /// For the log's notes.
    notes: Vec<String>,
}

/// Adds the file's points to the log in place of those it has.
///
/// # Errors
/// A unit that is not positive; a file of another form, without points, with too many, or damaged, by line where it is text; points that
/// lie nowhere near the drive.
pub fn add_sfm_points(log: &mut ReadLog, inputs: &SfmPointInputs) -> Result<()> {
    let (path, unit_m) = (&*inputs.file, inputs.unit_m);
    if !(unit_m.is_finite() && unit_m > 0.0) {
        let what = format!("the unit of {unit_m} m is not finite and positive");
        return Err(Error::choice(path, what));
    }
    let cloud = read(path, &log.drive_log)?;
    let world_m: Vec<DVec3> = cloud.points.iter().map(|p| *p * unit_m).collect();
    if world_m.is_empty() {
        return Err(Error::malformed(path, "it holds no point"));
    }
    require_near(path, &world_m, &log.drive_log)?;
    let numbers = world_m.iter().flat_map(|p| p.to_array());
    let points: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
    let points = log.add_bytes(points);
    let observations = cloud.observations.map(|seen| {
        let pairs = seen.iter().flat_map(|&(point, frame)| [point, frame]);
        let bytes: Vec<u8> = pairs.flat_map(u32::to_le_bytes).collect();
        log.add_bytes(bytes)
    });
    let seen = match &observations {
        Some(_) => "which image saw which is known",
        None => "which image saw which is guessed",
    };
    let count = world_m.len();
    let note = format!("{count} points of structure from motion, {seen}");
    log.drive_log.notes.push(note);
    log.drive_log.notes.extend(cloud.notes);
    log.drive_log.sfm_points = Some(v1::SfmPoints {
        points: Some(points),
        observations,
        weight: 0.0,
    });
    Ok(())
}

fn read(path: &Path, log: &v1::DriveLog) -> Result<Cloud> {
    let content = content(path)?;
    let points_alone = |points| Cloud {
        points,
        ..Cloud::default()
    };
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("txt") => colmap::read(path, text(path, &content)?, log),
        Some("ply") => ply::read(path, &content).map(points_alone),
        Some("csv") => table::read(path, text(path, &content)?).map(points_alone),
        _ => {
            let what = "points are read from COLMAP's points3D.txt, from .ply or from .csv";
            Err(Error::choice(path, what))
        }
    }
}

fn content(path: &Path) -> Result<Vec<u8>> {
    let found = std::fs::metadata(path).map_err(|e| Error::io(path, e, ""))?;
    if found.len() > MOST_BYTES {
        let what = format!("{} bytes, at most {MOST_BYTES} are read", found.len());
        return Err(Error::malformed(path, what));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e, ""))
}

fn text<'a>(path: &Path, content: &'a [u8]) -> Result<&'a str> {
    std::str::from_utf8(content).map_err(|e| Error::malformed(path, format!("it is no text: {e}")))
}

/// A point from three numbers of a text; the error says which is unusable.
fn point(numbers: [Option<&str>; 3]) -> Result<DVec3, String> {
    let mut point = DVec3::ZERO;
    for (axis, number) in numbers.into_iter().enumerate() {
        let name = ["x", "y", "z"][axis];
        let number = number.ok_or_else(|| format!("{name} is missing"))?.trim();
        let value: f64 = number
            .parse()
            .map_err(|_| format!("{name} is \"{number}\", not a number"))?;
        if !value.is_finite() {
            return Err(format!("{name} is {value}, not finite"));
        }
        point[axis] = value;
    }
    Ok(point)
}

fn require_room(path: &Path, count: usize) -> Result<()> {
    if count <= MOST_POINTS {
        return Ok(());
    }
    let what = format!("more than {MOST_POINTS} points; thin them out");
    Err(Error::malformed(path, what))
}

fn require_near(path: &Path, world_m: &[DVec3], log: &v1::DriveLog) -> Result<()> {
    let poses = log.world_from_ego.iter();
    let path_m: Vec<DVec3> = poses
        .map(|pose| {
            let world_from_ego: Rigid = rigid_from_wire(pose.pose.as_ref());
            world_from_ego.translation_m
        })
        .collect();
    let Some(first) = path_m.first() else {
        return Ok(());
    };
    let is_near = |p: &DVec3| path_m.iter().any(|ego| ego.distance(*p) < REACH_M);
    if world_m.iter().any(is_near) {
        return Ok(());
    }
    let nearest = world_m.iter().map(|p| first.distance(*p));
    let nearest = nearest.fold(f64::INFINITY, f64::min);
    let what = format!(
        "no point lies within {REACH_M} m of the drive, the nearest {nearest:.0} m from where it begins: points are in the log's world frame, whose drive begins at ({:.1}, {:.1}, {:.1}) m; align them, or state their unit",
        first.x, first.y, first.z
    );
    Err(Error::malformed(path, what))
}

#[cfg(test)]
mod tests;
