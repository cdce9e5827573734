//! Resource identifiers. An id is checked when it is made, so that no other code looks at its characters again.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Longest id in bytes.
pub const MAX_ID_BYTES: usize = 63;

/// A text is not a resource name of the expected collection.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{text}\" is not a name of the form {collection}/ID, where ID is 1 to 63 of a-z, 0-9, - and _ and starts with a letter or digit"
)]
pub struct NameError {
    pub collection: &'static str,
    pub text: String,
}

impl NameError {
    pub fn kind(&self) -> crate::error::ErrorKind {
        crate::error::ErrorKind::Invalid
    }
}

macro_rules! resource_id {
    ($(#[$doc:meta])* $name:ident, $collection:literal) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(String);

        impl $name {
            pub const COLLECTION: &'static str = $collection;

            /// From a bare id.
            pub fn new(id: &str) -> Result<Self, NameError> {
                if is_id(id) {
                    Ok(Self(id.to_owned()))
                } else {
                    Err(name_error($collection, id))
                }
            }

            /// The bare id.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        /// Parses a resource name, `collection/id`.
        impl FromStr for $name {
            type Err = NameError;

            fn from_str(name: &str) -> Result<Self, NameError> {
                name.strip_prefix(concat!($collection, "/"))
                    .filter(|id| is_id(id))
                    .map(|id| Self(id.to_owned()))
                    .ok_or_else(|| name_error($collection, name))
            }
        }

        /// The resource name, `collection/id`.
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($collection, "/{}"), self.0)
            }
        }

        impl TryFrom<String> for $name {
            type Error = NameError;

            fn try_from(id: String) -> Result<Self, NameError> {
                Self::new(&id)
            }
        }

        impl From<$name> for String {
            fn from(id: $name) -> String {
                id.0
            }
        }
    };
}

resource_id!(
    /// `driveLogs/{id}`, chosen by the client.
    DriveLogId,
    "driveLogs"
);
resource_id!(
    /// `assets/{id}`, derived from the log, the track and the job.
    AssetId,
    "assets"
);
resource_id!(
    /// `jobs/{id}`, sorts by creation.
    JobId,
    "jobs"
);

/// Makes an id of free text: other characters become dashes, and the result is cut to `max_bytes`.
pub fn slug(text: &str, max_bytes: usize) -> String {
    let mut out = String::with_capacity(text.len().min(max_bytes));
    for c in text.chars() {
        let c = c.to_ascii_lowercase();
        let c = if is_id_char(c) { c } else { '-' };
        if out.len() < max_bytes && (c.is_ascii_alphanumeric() || !out.is_empty()) {
            out.push(c);
        }
    }
    out
}

fn is_id(id: &str) -> bool {
    id.len() <= MAX_ID_BYTES
        && id.starts_with(|c: char| c.is_ascii_lowercase() || c.is_ascii_digit())
        && id.chars().all(is_id_char)
}

fn is_id_char(c: char) -> bool {
    c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_'
}

fn name_error(collection: &'static str, text: &str) -> NameError {
    // A hostile name may be megabytes long; the reply quotes its beginning.
    let text: String = text.chars().take(80).collect();
    NameError { collection, text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_round_trip_and_bad_names_are_refused() {
        let id: DriveLogId = "driveLogs/street_1".parse().unwrap();
        assert_eq!(id.to_string(), "driveLogs/street_1");
        let long = format!("driveLogs/{}", "a".repeat(64));
        for bad in [
            "",
            "driveLogs/",
            "street",
            "assets/street",
            "driveLogs/../x",
            "driveLogs/a/b",
            "driveLogs/A",
            "driveLogs/a\0",
            "driveLogs/%2e",
            "driveLogs/_a",
            "driveLogs/-a",
            "driveLogs/é",
            &long,
        ] {
            assert!(bad.parse::<DriveLogId>().is_err(), "{bad:?} was accepted");
        }
    }

    #[test]
    fn records_with_bad_ids_do_not_decode() {
        assert!(serde_json::from_str::<AssetId>("\"good-1\"").is_ok());
        assert!(serde_json::from_str::<AssetId>("\"../bad\"").is_err());
    }

    proptest! {
        #[test]
        fn an_accepted_id_never_leaves_its_folder(text in ".{0,80}") {
            if let Ok(id) = AssetId::new(&text) {
                prop_assert!(!id.as_str().contains(['/', '\\', '.', '\0']));
            }
        }

        #[test]
        fn a_slug_is_empty_or_an_id(text in ".{0,80}") {
            let slug = slug(&text, MAX_ID_BYTES);
            prop_assert!(slug.is_empty() || AssetId::new(&slug).is_ok(), "{slug:?}");
        }
    }
}
