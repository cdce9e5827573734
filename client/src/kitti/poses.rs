//! Ego poses: a KITTI odometry file or the oxts packets of the drive.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

use backlot_engine::camera::Rigid;
use glam::{DMat3, DQuat, DVec3};

use super::text;
use crate::read_log::{Error, Result};

/// Radius of the sphere of the KITTI development kit's Mercator projection, in metres.
const EARTH_RADIUS_M: f64 = 6_378_137.0;

/// Reads `world_from_camera0` by frame: line `i` of the file is frame `i`, twelve numbers row by row.
pub(super) fn read_odometry(path: &Path) -> Result<BTreeMap<u32, Rigid>> {
    let content = text::read(path, "--poses names a file in KITTI odometry format")?;
    let mut poses = BTreeMap::new();
    for (i, line) in content.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let m = text::numbers::<12>(path, i + 1, "pose", line)?;
        let rows = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        let rotation = text::rotation(path, i + 1, "pose", &rows)?;
        let pose = Rigid::new(rotation, DVec3::new(m[3], m[7], m[11]));
        poses.insert(i as u32, pose);
    }
    if poses.is_empty() {
        return Err(Error::malformed(path, "holds no pose"));
    }
    Ok(poses)
}

/// Reads `world_from_imu` by frame from a file for each packet.
pub(super) fn read_oxts(files: &BTreeMap<u32, impl AsRef<Path>>) -> Result<BTreeMap<u32, Rigid>> {
    let packets = files.iter().map(|(&frame, path)| {
        let path = path.as_ref();
        Ok((frame, Packet::parse(path, 1, &text::read(path, "")?)?))
    });
    place(packets)
}

/// Reads `world_from_imu` by frame from a file whose line `i` is the packet of frame `i`.
pub(super) fn read_oxts_lines(path: &Path) -> Result<BTreeMap<u32, Rigid>> {
    let content = text::read(
        path,
        "a tracking sequence has its ego poses in oxts/<sequence>.txt",
    )?;
    let packets = content
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    place(packets.map(|(i, line)| Ok((i as u32, Packet::parse(path, i + 1, line)?))))
}

/// The world is east, north, up. As the KITTI development kit does: a Mercator projection scaled at the first packet's latitude,
/// altitude as z, and the rotation Rz(yaw) Ry(pitch) Rx(roll).
fn place(packets: impl Iterator<Item = Result<(u32, Packet)>>) -> Result<BTreeMap<u32, Rigid>> {
    let mut scale = None;
    let mut poses = BTreeMap::new();
    for packet in packets {
        let (frame, packet) = packet?;
        let scale = *scale.get_or_insert_with(|| libm::cos(packet.latitude_deg * PI / 180.0));
        poses.insert(frame, packet.world_from_imu(scale));
    }
    Ok(poses)
}

/// The first six fields of an oxts line.
struct Packet {
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: f64,
    roll_rad: f64,
    pitch_rad: f64,
    yaw_rad: f64,
}

impl Packet {
    fn parse(path: &Path, line: usize, content: &str) -> Result<Self> {
        const FIELDS: [&str; 6] = ["lat", "lon", "alt", "roll", "pitch", "yaw"];
        let words: Vec<&str> = content.split_whitespace().collect();
        let mut values = [0.0; FIELDS.len()];
        for (i, field) in FIELDS.into_iter().enumerate() {
            let word = words
                .get(i)
                .ok_or_else(|| Error::at_line(path, line, format!("{field} is missing")))?;
            values[i] = text::number(path, line, field, word)?;
        }
        let [
            latitude_deg,
            longitude_deg,
            altitude_m,
            roll_rad,
            pitch_rad,
            yaw_rad,
        ] = values;
        if latitude_deg.abs() > 89.0 {
            let what = format!("lat is {latitude_deg}; the projection ends at 89 degrees");
            return Err(Error::at_line(path, line, what));
        }
        Ok(Self {
            latitude_deg,
            longitude_deg,
            altitude_m,
            roll_rad,
            pitch_rad,
            yaw_rad,
        })
    }

    fn world_from_imu(&self, scale: f64) -> Rigid {
        let east = scale * EARTH_RADIUS_M * self.longitude_deg * PI / 180.0;
        let north =
            scale * EARTH_RADIUS_M * libm::log(libm::tan((90.0 + self.latitude_deg) * PI / 360.0));
        let rotation = DMat3::from_rotation_z(self.yaw_rad)
            * DMat3::from_rotation_y(self.pitch_rad)
            * DMat3::from_rotation_x(self.roll_rad);
        Rigid::new(
            DQuat::from_mat3(&rotation).normalize(),
            DVec3::new(east, north, self.altitude_m),
        )
    }
}
