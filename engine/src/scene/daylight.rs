//! The light of a scene: where the sun stands and how much of the light is its.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Where a sun direction comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SunSource {
    /// The recipe says so.
    Recipe,
    /// The log says so.
    Log,
    /// Found in the shadows that the background shows.
    Estimated,
}

/// Sunlight over a background, in its local frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Daylight {
    /// Unit vector from the ground towards the sun.
    pub sun_direction_local: DVec3,
    /// The sun's part of the light on open level ground: red, green, blue, in linear light.
    pub sun_share: [f64; 3],
    /// Mean natural logarithm of the ground's linear light in the shade and in the sun; `None` where the ground shows no shadows.
    #[serde(default)]
    pub ground_ln_light: Option<[f64; 2]>,
    pub source: SunSource,
}

/// The sun's part of the light on level ground, from clear-sky irradiance in daylight.
const CLEAR_SKY_SHARE: f64 = 0.7;
/// A lower sun throws shadows longer than the ground plane can be trusted.
const MIN_SUN_SINE: f64 = 0.17;
/// Diffuse reflectance of the ground below an object.
const GROUND_ALBEDO: f64 = 0.2;

impl Daylight {
    /// The light of a clear day with the sun in a direction of any length but 0; `None` where it is too low to be used.
    pub fn clear_sky(direction_local: DVec3, source: SunSource) -> Option<Self> {
        let sun_direction_local = direction_local.try_normalize()?;
        (sun_direction_local.z >= MIN_SUN_SINE).then_some(Self {
            sun_direction_local,
            sun_share: [CLEAR_SKY_SHARE; 3],
            ground_ln_light: None,
            source,
        })
    }

    /// Irradiance of a surface with the given unit normal (local frame) to which the part `sun` of the sun gets through, relative to
    /// open level ground: Lambert's cosine for the sun, half-spheres of even sky above and of lit ground below.
    pub(super) fn irradiance(&self, normal: DVec3, sun: f64) -> [f64; 3] {
        let direction = self.sun_direction_local;
        let facing = normal.dot(direction).max(0.0) / direction.z;
        let above = 0.5 + 0.5 * normal.z;
        self.sun_share.map(|share| {
            let ground = share * sun + 1.0 - share;
            share * sun * facing + (1.0 - share) * above + GROUND_ALBEDO * ground * (1.0 - above)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noon() -> Daylight {
        Daylight::clear_sky(DVec3::new(0.0, 2.0, 2.0), SunSource::Log).expect("high enough")
    }

    #[test]
    fn open_level_ground_gets_all_of_the_light_and_shade_the_rest() {
        let day = noon();
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(day.irradiance(DVec3::Z, 1.0)[0], 1.0));
        assert!(near(
            day.irradiance(DVec3::Z, 0.0)[0],
            1.0 - CLEAR_SKY_SHARE
        ));
        let (lit, unlit) = (
            day.irradiance(DVec3::Y, 1.0),
            day.irradiance(-DVec3::Y, 1.0),
        );
        assert!(lit[0] > 3.0 * unlit[0]);
        // What faces away from the sun loses only what the ground throws back.
        let shaded = day.irradiance(-DVec3::Y, 0.0)[0];
        assert!(shaded < unlit[0] && shaded > 0.6 * unlit[0]);
    }

    #[test]
    fn a_low_sun_or_none_gives_no_daylight() {
        let low = DVec3::new(1.0, 0.0, 0.1);
        assert!(Daylight::clear_sky(low, SunSource::Log).is_none());
        assert!(Daylight::clear_sky(-DVec3::Z, SunSource::Log).is_none());
        assert!(Daylight::clear_sky(DVec3::ZERO, SunSource::Log).is_none());
    }
}
