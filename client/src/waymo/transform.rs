//! Transforms and times as the data set stores them.

use backlot_engine::camera::Rigid;
use glam::{DMat3, DQuat};

use crate::read_log::content::position;

/// Orthonormal to the precision of f32, which early releases have.
const MAX_ROTATION_ERROR: f64 = 1e-4;

/// A rigid transform from a 4x4 matrix, row by row.
pub(super) fn rigid(m: &[f64; 16]) -> Result<Rigid, String> {
    let rotation = DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]])
        .transpose();
    let error = rotation * rotation.transpose() - DMat3::IDENTITY;
    let off = error
        .to_cols_array()
        .iter()
        .fold(0.0_f64, |a, b| a.max(b.abs()));
    let proper = off.is_finite() && off <= MAX_ROTATION_ERROR && rotation.determinant() > 0.0;
    if !proper || m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(format!("is no rigid transform: {m:?}"));
    }
    let translation_m = position([m[3], m[7], m[11]])?;
    Ok(Rigid::new(
        DQuat::from_mat3(&rotation).normalize(),
        translation_m,
    ))
}

/// Nanoseconds from seconds since 1970.
pub(super) fn time_of_seconds(seconds: f64) -> Result<i64, String> {
    if !(0.0..9e9).contains(&seconds) {
        return Err(format!("{seconds} is not a time in seconds since 1970"));
    }
    // Whole seconds apart, so that the product does not round the nanoseconds off.
    let whole = seconds.floor();
    Ok(whole as i64 * 1_000_000_000 + ((seconds - whole) * 1e9).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_keep_the_precision_of_the_file() {
        assert_eq!(time_of_seconds(1.5), Ok(1_500_000_000));
        let at = time_of_seconds(1_550_083_467.346_37).unwrap();
        assert!((at - 1_550_083_467_346_370_000).abs() < 250, "{at}");
        assert!(time_of_seconds(f64::NAN).is_err() && time_of_seconds(-1.0).is_err());
    }

    #[test]
    fn matrices_are_read_row_by_row() {
        let quarter_turn = [
            0.0, -1.0, 0.0, 5.0, 1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0, 0.0, 0.0, 0.0, 1.0,
        ];
        let rigid_transform = rigid(&quarter_turn).unwrap();
        let moved = rigid_transform.point(glam::DVec3::X);
        assert!(
            (moved - glam::DVec3::new(5.0, 7.0, 7.0)).length() < 1e-12,
            "{moved}"
        );
        let mut mirrored = quarter_turn;
        mirrored[10] = -1.0;
        assert!(rigid(&mirrored).is_err() && rigid(&[f64::NAN; 16]).is_err());
    }
}
