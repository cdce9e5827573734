//! Timestamps of a drive.

use std::collections::BTreeMap;
use std::path::Path;

use super::text;
use crate::read_log::{Error, Result};

/// KITTI's Velodyne turns, and triggers the cameras, a little slower than 10 Hz.
const ASSUMED_INTERVAL_NS: i64 = 103_300_000;

/// Times in nanoseconds by frame index.
#[derive(Clone, Debug)]
pub(super) enum Clock {
    /// From a `timestamps.txt`, whose line `i` is frame `i`.
    Read(BTreeMap<u32, i64>),
    /// `frame * 0.1033 s`.
    Assumed,
}

impl Clock {
    /// Reads `<sensor folder>/timestamps.txt` if it is there.
    pub(super) fn read(sensor_folder: &Path) -> Result<Self> {
        let path = sensor_folder.join("timestamps.txt");
        if !path.exists() {
            return Ok(Self::Assumed);
        }
        let content = text::read(&path, "")?;
        let mut times = BTreeMap::new();
        for (i, line) in content.lines().enumerate() {
            // Blank lines stand for frames that the sensor missed.
            if !line.trim().is_empty() {
                let what = || format!("timestamp {line:?} is not YYYY-MM-DD hh:mm:ss.fraction");
                let time =
                    parse(line.trim()).ok_or_else(|| Error::at_line(&path, i + 1, what()))?;
                times.insert(i as u32, time);
            }
        }
        Ok(Self::Read(times))
    }

    pub(super) fn is_assumed(&self) -> bool {
        matches!(self, Self::Assumed)
    }

    /// `None` if the file has no line for the frame.
    pub(super) fn at(&self, frame: u32) -> Option<i64> {
        match self {
            Self::Read(times) => times.get(&frame).copied(),
            Self::Assumed => Some(i64::from(frame) * ASSUMED_INTERVAL_NS),
        }
    }
}

/// Nanoseconds since 1970-01-01 of a UTC time `YYYY-MM-DD hh:mm:ss.fraction`.
fn parse(text: &str) -> Option<i64> {
    let (date, time) = text.split_once(' ')?;
    let mut date = date.splitn(3, '-').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (date.next()??, date.next()??, date.next()??);
    let mut time = time.splitn(3, ':');
    let hour: i64 = time.next()?.parse().ok()?;
    let minute: i64 = time.next()?.parse().ok()?;
    let (second, fraction) = time.next()?.split_once('.').unwrap_or(("", ""));
    let second: i64 = second.parse().ok()?;
    let in_range = (1970..2262).contains(&year)
        && (1..=12).contains(&month)
        && (1..=31).contains(&day)
        && (0..24).contains(&hour)
        && (0..60).contains(&minute)
        && (0..=60).contains(&second);
    let digits_ok =
        (1..=9).contains(&fraction.len()) && fraction.bytes().all(|b| b.is_ascii_digit());
    if !in_range || !digits_ok {
        return None;
    }
    let nanoseconds: i64 = format!("{fraction:0<9}").parse().ok()?;
    let seconds = ((days_since_epoch(year, month, day) * 24 + hour) * 60 + minute) * 60 + second;
    Some(seconds * 1_000_000_000 + nanoseconds)
}

/// Days from 1970-01-01 in the proleptic Gregorian calendar, counting years from March so that leap days come last.
fn days_since_epoch(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month <= 2 {
        (year - 1, month + 9)
    } else {
        (year, month - 3)
    };
    let leap_days = year / 4 - year / 100 + year / 400;
    // Months from March repeat 31, 30, 31, 30, 31 days: 153 days every five months.
    let days_in_year = (153 * month + 2) / 5 + day - 1;
    365 * year + leap_days + days_in_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timestamps_are_utc_nanoseconds() {
        // `date -u -d '2011-09-26 13:02:25' +%s` is 1317042145.
        assert_eq!(
            parse("2011-09-26 13:02:25.964389445"),
            Some(1_317_042_145_964_389_445)
        );
        assert_eq!(parse("1970-01-01 00:00:00.000000001"), Some(1));
        assert_eq!(
            parse("2012-02-29 00:00:00.5"),
            Some(1_330_473_600_500_000_000)
        );
    }

    #[test]
    fn broken_timestamps_are_rejected() {
        for text in [
            "",
            "2011-09-26",
            "2011-13-26 13:02:25.1",
            "2011-09-26 13:02",
            "x y",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
