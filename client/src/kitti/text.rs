//! Text files of numbers.

use std::path::Path;

use glam::{DMat3, DQuat};

use crate::read_log::{Error, Result};

/// Reads a whole text file; `hint` says what to do if it is missing.
pub(super) fn read(path: &Path, hint: &str) -> Result<String> {
    std::fs::read_to_string(path).map_err(|source| Error::io(path, source, hint))
}

/// Parses one finite number; `line` counts from 1 and `field` names it in the error.
pub(super) fn number(path: &Path, line: usize, field: &str, text: &str) -> Result<f64> {
    let value: f64 = text
        .parse()
        .map_err(|_| Error::at_line(path, line, format!("{field} is {text:?}, not a number")))?;
    if value.is_finite() {
        Ok(value)
    } else {
        let what = format!("{field} is {text}; it must be finite");
        Err(Error::at_line(path, line, what))
    }
}

/// Parses exactly `N` finite numbers separated by white space.
pub(super) fn numbers<const N: usize>(
    path: &Path,
    line: usize,
    field: &str,
    text: &str,
) -> Result<[f64; N]> {
    let words: Vec<&str> = text.split_whitespace().collect();
    if words.len() != N {
        let what = format!("{field} has {} numbers, {N} are needed", words.len());
        return Err(Error::at_line(path, line, what));
    }
    let mut values = [0.0; N];
    for (i, (value, word)) in values.iter_mut().zip(&words).enumerate() {
        *value = number(path, line, &format!("{field}[{i}]"), word)?;
    }
    Ok(values)
}

/// A rotation given row by row.
pub(super) fn rotation(path: &Path, line: usize, field: &str, rows: &[f64; 9]) -> Result<DQuat> {
    let matrix = DMat3::from_cols_array(rows).transpose();
    let error = matrix * matrix.transpose() - DMat3::IDENTITY;
    let off = error
        .to_cols_array()
        .iter()
        .fold(0.0, |a: f64, b| a.max(b.abs()));
    // Calibration files carry seven digits; hand-made pose files fewer.
    if off > 1e-3 || matrix.determinant() < 0.0 {
        let what = format!("{field} is not a rotation: it is {off:.2e} away from orthonormal");
        return Err(Error::at_line(path, line, what));
    }
    Ok(DQuat::from_mat3(&matrix).normalize())
}
