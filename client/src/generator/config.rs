//! What a generated street looks like and how it is recorded.

use backlot_engine::ErrorKind;

/// A generated driving log. The same configuration always gives the same bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct StreetConfig {
    pub seed: u64,
    /// Camera frames, evenly spaced over `travel_m`.
    pub frames: u32,
    /// Image size in pixels.
    pub width: u32,
    pub height: u32,
    /// Path of the ego vehicle along the street.
    pub travel_m: f64,
    /// Horizontal field of view of the front camera.
    pub horizontal_fov_rad: f64,
    /// Ego speed, which sets the time between frames.
    pub ego_speed_m_s: f64,
    /// Cars parked along both kerbs.
    pub parked_cars: u32,
    /// Cars that drive: a lead car, then oncoming ones.
    pub moving_cars: u32,
    /// Samples per side of a pixel on edges; 1 turns anti-aliasing off.
    pub supersample: u32,
    /// Fraction of instance-mask pixels at an instance edge that take a neighbour's label.
    pub mask_edge_noise: f64,
    /// Standard deviations added to the recorded ego poses (the images are taken from the true ones).
    pub pose_noise: PoseNoise,
    pub depth: DepthRecording,
    /// The scanner, for [`DepthRecording::Lidar`].
    pub lidar: LidarConfig,
}

/// What a generated log says about depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthRecording {
    /// Sweeps of a scanner.
    #[default]
    Lidar,
    /// A monocular depth map for every image.
    Maps,
    /// Points of structure from motion.
    Points,
    None,
}

/// Gaussian noise of recorded poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseNoise {
    pub translation_m: f64,
    pub rotation_rad: f64,
}

/// A spinning scanner on the roof, recorded only inside a forward sector to keep logs small.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarConfig {
    pub beams: u32,
    /// Elevation of the lowest and highest beam.
    pub elevation_min_rad: f64,
    pub elevation_max_rad: f64,
    /// Half the recorded sector around straight ahead.
    pub half_sector_rad: f64,
    pub azimuth_step_rad: f64,
    /// Standard deviation of the measured range.
    pub range_noise_m: f64,
    pub max_range_m: f64,
    /// Time of one turn of the scanner.
    pub turn_s: f64,
}

impl Default for LidarConfig {
    fn default() -> Self {
        Self {
            beams: 64,
            elevation_min_rad: -24.0_f64.to_radians(),
            elevation_max_rad: 12.0_f64.to_radians(),
            half_sector_rad: 50.0_f64.to_radians(),
            azimuth_step_rad: 0.35_f64.to_radians(),
            range_noise_m: 0.015,
            max_range_m: 80.0,
            turn_s: 0.1,
        }
    }
}

impl Default for StreetConfig {
    /// The log of `backlot demo`.
    fn default() -> Self {
        Self {
            seed: 1,
            frames: 30,
            width: 640,
            height: 384,
            travel_m: 60.0,
            horizontal_fov_rad: 62.0_f64.to_radians(),
            ego_speed_m_s: 12.0,
            parked_cars: 9,
            moving_cars: 3,
            supersample: 2,
            mask_edge_noise: 0.0,
            pose_noise: PoseNoise::default(),
            depth: DepthRecording::default(),
            lidar: LidarConfig::default(),
        }
    }
}

/// Why no log can be generated or rendered.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("generator: {field} = {value} is outside {range}")]
    OutOfRange {
        field: &'static str,
        value: f64,
        range: &'static str,
    },
    #[error("generator: no track {track_id:?}")]
    UnknownTrack { track_id: String },
    #[error("generator: encode png: {0}")]
    Encode(#[from] image::ImageError),
}

impl Error {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::OutOfRange { .. } => ErrorKind::Invalid,
            Self::UnknownTrack { .. } => ErrorKind::NotFound,
            Self::Encode(_) => ErrorKind::Internal,
        }
    }
}

impl StreetConfig {
    /// Checks every bound that the generator relies on.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] naming the field.
    pub fn validate(&self) -> Result<(), Error> {
        let checks: [(
            &'static str,
            f64,
            std::ops::RangeInclusive<f64>,
            &'static str,
        ); 14] = [
            ("frames", f64::from(self.frames), 2.0..=2000.0, "2..=2000"),
            ("width", f64::from(self.width), 16.0..=4096.0, "16..=4096"),
            ("height", f64::from(self.height), 16.0..=4096.0, "16..=4096"),
            // The hills around the street begin 300 m out.
            ("travel_m", self.travel_m, 1.0..=200.0, "1..=200"),
            (
                "horizontal_fov_rad",
                self.horizontal_fov_rad,
                0.2..=2.4,
                "0.2..=2.4",
            ),
            ("ego_speed_m_s", self.ego_speed_m_s, 0.5..=40.0, "0.5..=40"),
            (
                "parked_cars",
                f64::from(self.parked_cars),
                0.0..=32.0,
                "0..=32",
            ),
            (
                "moving_cars",
                f64::from(self.moving_cars),
                0.0..=4.0,
                "0..=4",
            ),
            (
                "supersample",
                f64::from(self.supersample),
                1.0..=8.0,
                "1..=8",
            ),
            ("mask_edge_noise", self.mask_edge_noise, 0.0..=1.0, "0..=1"),
            (
                "pose_noise.translation_m",
                self.pose_noise.translation_m,
                0.0..=1.0,
                "0..=1",
            ),
            (
                "pose_noise.rotation_rad",
                self.pose_noise.rotation_rad,
                0.0..=0.2,
                "0..=0.2",
            ),
            (
                "lidar.beams",
                f64::from(self.lidar.beams),
                1.0..=256.0,
                "1..=256",
            ),
            (
                "lidar.azimuth_step_rad",
                self.lidar.azimuth_step_rad,
                0.0005..=0.2,
                "0.0005..=0.2",
            ),
        ];
        for (field, value, range, text) in checks {
            if !range.contains(&value) {
                return Err(Error::OutOfRange {
                    field,
                    value,
                    range: text,
                });
            }
        }
        Ok(())
    }

    /// Parked cars that line a street for a drive of this length as densely as the default ones do, and never fewer.
    pub fn parked_along(travel_m: f64) -> u32 {
        let default = Self::default();
        let longer = (travel_m / default.travel_m).max(1.0);
        (f64::from(default.parked_cars) * longer).round() as u32
    }

    /// Time between frames.
    pub fn frame_period_s(&self) -> f64 {
        self.travel_m / f64::from(self.frames - 1) / self.ego_speed_m_s
    }
}
