//! What can be wrong with a log on disk.

use std::path::{Path, PathBuf};

use backlot_engine::ErrorKind;

pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Every message starts with the path it is about.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("{}: not found{}{hint}", path.display(), if hint.is_empty() { "" } else { "; " })]
    Missing { path: PathBuf, hint: String },
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{}: {what}", path.display())]
    Malformed { path: PathBuf, what: String },
    /// The path may be right, but the request does not say which of its logs is meant, or names none of them.
    #[error("{}: {what}", path.display())]
    Choice { path: PathBuf, what: String },
    #[error("{}:{line}: {what}", path.display())]
    MalformedLine {
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        what: String,
    },
}

impl Error {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Missing { .. } => ErrorKind::NotFound,
            Self::Io { .. } => ErrorKind::Unavailable,
            Self::Malformed { .. } | Self::MalformedLine { .. } | Self::Choice { .. } => {
                ErrorKind::Invalid
            }
        }
    }

    pub(crate) fn io(path: &Path, source: std::io::Error, hint: &str) -> Self {
        let path = path.to_owned();
        if source.kind() == std::io::ErrorKind::NotFound {
            let hint = hint.to_owned();
            Self::Missing { path, hint }
        } else {
            Self::Io { path, source }
        }
    }

    pub(crate) fn malformed(path: &Path, what: impl Into<String>) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            what: what.into(),
        }
    }

    pub(crate) fn choice(path: &Path, what: impl Into<String>) -> Self {
        Self::Choice {
            path: path.to_owned(),
            what: what.into(),
        }
    }

    pub(crate) fn at_line(path: &Path, line: usize, what: impl Into<String>) -> Self {
        Self::MalformedLine {
            path: path.to_owned(),
            line,
            what: what.into(),
        }
    }
}
