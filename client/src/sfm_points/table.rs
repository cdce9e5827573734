//! Points from a table: x, y and z first in each line, by commas. One heading is skipped.

use std::path::Path;

use glam::DVec3;

use super::{point, require_room};
use crate::read_log::{Error, Result};

pub(super) fn read(path: &Path, text: &str) -> Result<Vec<DVec3>> {
    let mut points = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        let is_heading = number == 1 && line.starts_with(|c: char| c.is_alphabetic() || c == '"');
        if line.is_empty() || line.starts_with('#') || is_heading {
            continue;
        }
        let mut fields = line.split(',');
        let numbers = [fields.next(), fields.next(), fields.next()];
        points.push(point(numbers).map_err(|what| Error::at_line(path, number, what))?);
        require_room(path, points.len())?;
    }
    Ok(points)
}
