//! Range images to points.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DQuat, DVec3, EulerRot};

use super::cameras::FRAME_TIME;
use super::table::{Row, Rows, Table};
use super::transform::rigid;
use crate::geometry::rigid_to_wire;
use crate::read_log::content::{push_point, time_of_micros};
use crate::read_log::{ReadLog, Result, SpoolWriter};

const LASER: &str = "key.laser_name";
const RETURNS: [[&str; 2]; 2] = [
    [
        "[LiDARComponent].range_image_return1.values",
        "[LiDARComponent].range_image_return1.shape",
    ],
    [
        "[LiDARComponent].range_image_return2.values",
        "[LiDARComponent].range_image_return2.shape",
    ],
];
const PIXEL_POSES: [&str; 2] = [
    "[LiDARPoseComponent].range_image_return1.values",
    "[LiDARPoseComponent].range_image_return1.shape",
];
const EXTRINSIC: &str = "[LiDARCalibrationComponent].extrinsic.transform";
const INCLINATION_MIN: &str = "[LiDARCalibrationComponent].beam_inclination.min";
const INCLINATION_MAX: &str = "[LiDARCalibrationComponent].beam_inclination.max";
const INCLINATIONS: &str = "[LiDARCalibrationComponent].beam_inclination.values";
/// Range, intensity, elongation, no-label zone.
const RANGE_CHANNELS: usize = 4;
/// Roll, pitch, yaw, x, y, z.
const POSE_CHANNELS: usize = 6;
/// Pixel poses kept until the range image they belong to comes; the files have the same order.
const MAX_WAITING: usize = 16;

/// A scanner of the segment.
struct Scanner {
    name: String,
    vehicle_from_lidar: Rigid,
    inclination_min_rad: f64,
    inclination_max_rad: f64,
    /// Lowest first; none if they are uniform.
    inclinations_rad: Vec<f64>,
}

/// Adds a sweep for each scanner and frame; `world_from_vehicle` has the pose of each frame.
pub(super) fn add_sweeps(
    log: &mut ReadLog,
    spool: &mut SpoolWriter,
    root: &Path,
    segment: &str,
    world_from_vehicle: &BTreeMap<i64, Rigid>,
) -> Result<()> {
    let Some(table) = Table::open(root, "lidar", segment)? else {
        log.drive_log.notes.push("no LiDAR".to_owned());
        return Ok(());
    };
    let scanners = read_calibration(root, segment)?;
    let pose_table = Table::open(root, "lidar_pose", segment)?;
    let pose_names = [FRAME_TIME, LASER, PIXEL_POSES[0], PIXEL_POSES[1]];
    let mut pixel_poses = match &pose_table {
        Some(table) => Some(PixelPoses::new(table.rows(&pose_names, &[])?)),
        None => {
            let note = "no lidar_pose: the top scanner's points are not compensated for ego motion";
            log.drive_log.notes.push(note.to_owned());
            None
        }
    };
    let mut names = vec![FRAME_TIME, LASER];
    names.extend(RETURNS.as_flattened());
    let mut rows = table.rows(&names, &RETURNS[1])?;
    while let Some(row) = rows.next_row()? {
        let key = key(&row)?;
        let scanner = scanners.get(&key.1);
        let scanner =
            scanner.ok_or_else(|| row.bad(format!("laser {} has no calibration", key.1)))?;
        let pose = world_from_vehicle.get(&key.0);
        let pose = pose.ok_or_else(|| row.bad(format!("no vehicle_pose at {} ns", key.0)))?;
        let poses = match &mut pixel_poses {
            Some(poses) => poses.of(key)?,
            None => None,
        };
        let points = points(&row, scanner, pose, poses.as_ref())?;
        if points.is_empty() {
            continue;
        }
        let blob = log.add_spooled(spool, &points).map_err(|e| row.bad(e))?;
        log.drive_log.sweeps.push(v1::LidarSweep {
            lidar_id: scanner.name.clone(),
            timestamp_ns: key.0,
            ego_from_lidar: Some(rigid_to_wire(&scanner.vehicle_from_lidar)),
            points: Some(blob),
            format: v1::PointFormat::XyziF32.into(),
        });
    }
    log.drive_log.sweeps.sort_by_key(|sweep| sweep.timestamp_ns);
    Ok(())
}

/// Time of the frame in nanoseconds, and number of the laser.
type Key = (i64, i64);

fn key(row: &Row<'_>) -> Result<Key> {
    let time = time_of_micros(row.integer(FRAME_TIME)?).map_err(|e| row.bad(e))?;
    Ok((time, row.integer(LASER)?))
}

/// A grid of pixels with a few values each.
struct Grid {
    width: usize,
    values: Vec<f64>,
}

impl Grid {
    /// Reads a grid of `channels`; `None` if the row has none.
    fn read(row: &Row<'_>, [values, shape]: [&str; 2], channels: usize) -> Result<Option<Self>> {
        let numbers = row.numbers(values)?;
        if numbers.is_empty() {
            return Ok(None);
        }
        let [height, width, depth] = row.array::<3>(shape)?;
        let count = height * width * channels as f64;
        let whole = width >= 1.0 && width.fract() == 0.0 && height.fract() == 0.0;
        let fits = whole && depth == channels as f64 && count == numbers.len() as f64;
        if !fits {
            return Err(row.bad(format!(
                "{values} has {} values, its shape is {height} x {width} x {depth}",
                numbers.len()
            )));
        }
        Ok(Some(Self {
            width: width as usize,
            values: numbers.to_vec(),
        }))
    }
}

/// The poses of the vehicle at every pixel of the top scanner's range images.
struct PixelPoses<'t> {
    rows: Rows<'t>,
    waiting: BTreeMap<Key, Grid>,
    ended: bool,
}

impl<'t> PixelPoses<'t> {
    fn new(rows: Rows<'t>) -> Self {
        Self {
            rows,
            waiting: BTreeMap::new(),
            ended: false,
        }
    }

    /// The poses of a range image; `None` if it has none: its points are in the frame's vehicle frame already.
    fn of(&mut self, key: Key) -> Result<Option<Grid>> {
        // Only the top scanner, number 1, has them.
        while key.1 == 1 && !self.ended && !self.waiting.contains_key(&key) {
            let Some(row) = self.rows.next_row()? else {
                self.ended = true;
                break;
            };
            if let Some(grid) = Grid::read(&row, PIXEL_POSES, POSE_CHANNELS)? {
                self.waiting.insert(self::key(&row)?, grid);
            }
            if self.waiting.len() > MAX_WAITING {
                return Err(row.bad("is not in the order of the lidar component"));
            }
        }
        Ok(self.waiting.remove(&key))
    }
}

/// XYZI points in the LiDAR frame at the frame's time.
fn points(
    row: &Row<'_>,
    scanner: &Scanner,
    world_from_vehicle: &Rigid,
    poses: Option<&Grid>,
) -> Result<Vec<u8>> {
    let lidar_from_world = (*world_from_vehicle * scanner.vehicle_from_lidar).inverse();
    let mut points = Vec::new();
    for names in RETURNS {
        let Some(ranges) = Grid::read(row, names, RANGE_CHANNELS)? else {
            continue;
        };
        let pixels = ranges.values.len() / RANGE_CHANNELS;
        if poses
            .is_some_and(|p| p.values.len() != pixels * POSE_CHANNELS || p.width != ranges.width)
        {
            return Err(row.bad("its range image and that of lidar_pose differ in size"));
        }
        let inclinations = scanner
            .inclinations(pixels / ranges.width)
            .map_err(|e| row.bad(e))?;
        let azimuths = scanner.azimuths(ranges.width);
        for (i, pixel) in ranges.values.chunks_exact(RANGE_CHANNELS).enumerate() {
            let (range_m, intensity) = (pixel[0], pixel[1]);
            if !(range_m > 0.0 && range_m.is_finite()) {
                continue;
            }
            let mut p =
                direction(inclinations[i / ranges.width], azimuths[i % ranges.width]) * range_m;
            if let Some(poses) = poses {
                let pose = pixel_pose(&poses.values[i * POSE_CHANNELS..][..POSE_CHANNELS]);
                p = lidar_from_world.point((pose * scanner.vehicle_from_lidar).point(p));
            }
            push_point(&mut points, p, intensity.clamp(0.0, 1.0) as f32);
        }
    }
    Ok(points)
}

fn direction(inclination_rad: f64, azimuth_rad: f64) -> DVec3 {
    let (rise, flat) = libm::sincos(inclination_rad);
    let (left, ahead) = libm::sincos(azimuth_rad);
    DVec3::new(flat * ahead, flat * left, rise)
}

/// `world_from_vehicle` of a pixel: yaw about z, then pitch about y, then roll about x.
fn pixel_pose(pose: &[f64]) -> Rigid {
    let rotation = DQuat::from_euler(EulerRot::ZYX, pose[2], pose[1], pose[0]);
    Rigid::new(rotation, DVec3::new(pose[3], pose[4], pose[5]))
}

impl Scanner {
    /// Inclination of each row of a range image; the first row is the highest beam.
    fn inclinations(&self, height: usize) -> Result<Vec<f64>, String> {
        let (low, high) = (self.inclination_min_rad, self.inclination_max_rad);
        let count = self.inclinations_rad.len();
        if count == 0 {
            let share = |row: usize| ((height - row) as f64 - 0.5) / height as f64;
            return Ok((0..height)
                .map(|row| low + (high - low) * share(row))
                .collect());
        }
        if count != height {
            return Err(format!(
                "its range image has {height} rows, lidar_calibration {count} beams"
            ));
        }
        Ok(self.inclinations_rad.iter().rev().copied().collect())
    }

    /// Azimuth of each column in the LiDAR frame; the first one looks back along the vehicle's x axis, then they go clockwise.
    fn azimuths(&self, width: usize) -> Vec<f64> {
        let heading = self.vehicle_from_lidar.heading_rad();
        let share = |column: usize| ((width - column) as f64 - 0.5) / width as f64;
        (0..width)
            .map(|column| (2.0 * share(column) - 1.0) * PI - heading)
            .collect()
    }
}

fn read_calibration(root: &Path, segment: &str) -> Result<BTreeMap<i64, Scanner>> {
    const NAMES: [&str; 6] = ["UNKNOWN", "TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"];
    let table = Table::required(root, "lidar_calibration", segment)?;
    let names = [
        LASER,
        EXTRINSIC,
        INCLINATION_MIN,
        INCLINATION_MAX,
        INCLINATIONS,
    ];
    let mut rows = table.rows(&names, &[INCLINATIONS])?;
    let mut scanners = BTreeMap::new();
    while let Some(row) = rows.next_row()? {
        let number = row.integer(LASER)?;
        let name = usize::try_from(number).ok().and_then(|i| NAMES.get(i));
        let scanner = Scanner {
            name: name.map_or_else(|| format!("LASER_{number}"), |name| (*name).to_owned()),
            vehicle_from_lidar: rigid(&row.array(EXTRINSIC)?).map_err(|e| row.bad(e))?,
            inclination_min_rad: row.number(INCLINATION_MIN)?,
            inclination_max_rad: row.number(INCLINATION_MAX)?,
            inclinations_rad: row.numbers(INCLINATIONS)?.to_vec(),
        };
        let bounds = [scanner.inclination_min_rad, scanner.inclination_max_rad];
        if !scanner
            .inclinations_rad
            .iter()
            .chain(&bounds)
            .all(|v| v.abs() <= PI)
        {
            return Err(row.bad("a beam inclination is no angle in radians"));
        }
        scanners.insert(number, scanner);
    }
    Ok(scanners)
}
