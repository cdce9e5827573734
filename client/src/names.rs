//! Resource names from what people type: a bare id or a full name.

use crate::error::{Error, Result};

pub fn drive_log(text: &str) -> Result<String> {
    full("driveLogs", text)
}

pub fn job(text: &str) -> Result<String> {
    full("jobs", text)
}

pub fn asset(text: &str) -> Result<String> {
    full("assets", text)
}

/// The last part of a resource name.
pub fn id(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(_, id)| id)
}

fn full(collection: &str, text: &str) -> Result<String> {
    let id = text
        .strip_prefix(collection)
        .and_then(|rest| rest.strip_prefix('/'))
        .unwrap_or(text);
    let allowed = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-' || c == b'_';
    let valid = (1..=63).contains(&id.len())
        && id.bytes().all(allowed)
        && id.as_bytes()[0].is_ascii_alphanumeric();
    if valid {
        Ok(format!("{collection}/{id}"))
    } else {
        Err(Error::Invalid {
            what: format!(
                "{text:?} is not a name in {collection}: 1 to 63 of a-z, 0-9, - and _, starting with a letter or digit"
            ),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_and_full_names_are_the_same() {
        assert_eq!(drive_log("drive-52").unwrap(), "driveLogs/drive-52");
        assert_eq!(
            drive_log("driveLogs/drive-52").unwrap(),
            "driveLogs/drive-52"
        );
        assert_eq!(id("assets/abc"), "abc");
    }

    #[test]
    fn other_texts_are_rejected() {
        for text in ["", "Drive", "a b", "-a", "assets/a", &"x".repeat(64)] {
            assert!(drive_log(text).is_err(), "{text}");
        }
    }
}
