//! Folders that hold several logs.

use std::path::Path;

use super::{Error, Result};

/// The log that is meant: the one named, else the only one. `kind` is what the data set calls its logs, e.g. "scene".
///
/// # Errors
/// Lists what there is where the name is not among it or missing.
pub(crate) fn choose(
    path: &Path,
    kind: &str,
    names: &[String],
    wanted: Option<&str>,
) -> Result<String> {
    let what = match (wanted, names) {
        (Some(wanted), names) if names.iter().any(|name| name == wanted) => {
            return Ok(wanted.to_owned());
        }
        (None, [only]) => return Ok(only.clone()),
        (_, []) => format!("holds no {kind}"),
        (Some(wanted), names) => format!("has no {kind} {wanted:?}, but {}", listed(names)),
        (None, names) => {
            let count = names.len();
            format!(
                "holds {count} {kind}s ({}): choose one with --scene",
                listed(names)
            )
        }
    };
    Err(Error::Choice {
        path: path.to_owned(),
        what,
    })
}

/// At most ten names.
fn listed(names: &[String]) -> String {
    const MOST: usize = 10;
    match names.len().saturating_sub(MOST) {
        0 => names.join(", "),
        more => format!("{} and {more} more", names[..MOST].join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(count: usize, wanted: Option<&str>) -> Result<String, String> {
        let names: Vec<String> = (0..count).map(|i| i.to_string()).collect();
        choose(Path::new("set"), "scene", &names, wanted).map_err(|e| e.to_string())
    }

    #[test]
    fn the_named_or_the_only_log_is_chosen() {
        assert_eq!(chosen(1, None), Ok("0".to_owned()));
        assert_eq!(chosen(3, Some("2")), Ok("2".to_owned()));
    }

    #[test]
    fn errors_list_what_there_is() {
        for (count, wanted, expected) in [
            (0, None, "set: holds no scene"),
            (2, Some("7"), "set: has no scene \"7\", but 0, 1"),
            (
                2,
                None,
                "set: holds 2 scenes (0, 1): choose one with --scene",
            ),
            (12, None, "8, 9 and 2 more"),
        ] {
            let error = chosen(count, wanted).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
