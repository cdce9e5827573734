//! Decoding LiDAR sweeps.

use glam::Vec3;

use crate::domain::drive_log::PointFormat;

/// One return in the LiDAR frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SweepPoint {
    /// Metres.
    pub position_m: Vec3,
    /// Nanoseconds after the sweep's timestamp; 0 where the format carries no time.
    pub delay_ns: i64,
}

/// The finite points of a sweep. Points that are not finite or lie in the origin are dropped: scanners write them for
/// directions without a return.
pub(crate) fn decode_points(
    bytes: &[u8],
    format: PointFormat,
) -> impl Iterator<Item = SweepPoint> + '_ {
    bytes
        .chunks_exact(format.point_bytes())
        .filter_map(move |point| {
            let value = |i: usize| {
                let at = 4 * i;
                f32::from_le_bytes([point[at], point[at + 1], point[at + 2], point[at + 3]])
            };
            let position_m = Vec3::new(value(0), value(1), value(2));
            let delay_s = match format {
                PointFormat::XyziF32 => 0.0,
                PointFormat::XyzitF32 => f64::from(value(4)),
            };
            let usable = position_m.is_finite() && delay_s.is_finite() && position_m != Vec3::ZERO;
            usable.then_some(SweepPoint {
                position_m,
                delay_ns: (delay_s * 1e9).round() as i64,
            })
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_both_formats_and_drops_what_is_no_return() {
        let mut bytes = Vec::new();
        for point in [
            [1.0f32, 2.0, 3.0, 0.5, 0.01],
            [f32::NAN, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
        ] {
            bytes.extend(point.iter().flat_map(|v| v.to_le_bytes()));
        }
        let timed: Vec<_> = decode_points(&bytes, PointFormat::XyzitF32).collect();
        assert_eq!(timed.len(), 1);
        assert_eq!(timed[0].position_m, Vec3::new(1.0, 2.0, 3.0));
        assert_eq!(timed[0].delay_ns, 10_000_000);
        let untimed = decode_points(&bytes[..16], PointFormat::XyziF32).next();
        assert_eq!(untimed.unwrap().delay_ns, 0);
    }
}
