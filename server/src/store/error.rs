//! What can go wrong with the data directory.

use std::path::PathBuf;

use crate::domain::blob::Digest;
use crate::error::{ErrorKind, Kinded};

pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("another server uses the data directory; stop it or choose another one: {}", path.display())]
    InUse { path: PathBuf },
    #[error(transparent)]
    Migration(#[from] backlot_migrations::Error),
    #[error(
        "the disk is full: {free_bytes} bytes are free and {needed_bytes} are needed; free space and try again"
    )]
    DiskFull { free_bytes: u64, needed_bytes: u64 },
    /// A precondition of a transaction does not hold; nothing was written.
    #[error("record {key} changed meanwhile")]
    Conflict { key: String },
    #[error("{what} does not exist")]
    NotFound { what: String },
    #[error("{what} exists with other content")]
    Exists { what: String },
    #[error("{what}")]
    Invalid { what: String },
    #[error("{what}: {size_bytes} bytes are over the limit of {limit_bytes}")]
    TooLarge {
        what: String,
        size_bytes: u64,
        limit_bytes: u64,
    },
    #[error("blob {digest} is being written by another call; try again")]
    BlobBusy { digest: Digest },
    #[error("the next chunk of blob {digest} must start at byte {committed_bytes}, not {offset}")]
    WrongOffset {
        digest: Digest,
        offset: u64,
        committed_bytes: u64,
    },
    #[error("{what} is corrupt")]
    Corrupt { what: String },
    /// An earlier write failed half-way; reads go on, writes wait for a restart.
    #[error("the store refuses writes after a failure ({cause}); restart the server")]
    Poisoned { cause: String },
    #[error("{verb} {}: {source}", path.display())]
    Io {
        verb: &'static str,
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("metadata index: {what}")]
    Index { what: String },
}

impl Error {
    pub(crate) fn corrupt(what: impl Into<String>) -> Self {
        Self::Corrupt { what: what.into() }
    }
}

impl Kinded for Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Invalid { .. } | Self::TooLarge { .. } | Self::WrongOffset { .. } => {
                ErrorKind::Invalid
            }
            Self::NotFound { .. } => ErrorKind::NotFound,
            Self::Exists { .. } => ErrorKind::Conflict,
            Self::InUse { .. } | Self::Migration(_) => ErrorKind::NotReady,
            Self::Conflict { .. } | Self::Poisoned { .. } | Self::BlobBusy { .. } => {
                ErrorKind::Unavailable
            }
            Self::DiskFull { .. } => ErrorKind::Overloaded,
            Self::Io { source, .. } if is_disk_full(source) => ErrorKind::Overloaded,
            Self::Corrupt { .. } => ErrorKind::Corrupt,
            Self::Io { .. } | Self::Index { .. } => ErrorKind::Internal,
        }
    }
}

/// The machine says that no more can be written.
pub(crate) fn is_disk_full(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded
    )
}

/// Adds what was being done, and where, to an IO error.
pub(crate) trait IoContext<T> {
    fn at(self, verb: &'static str, path: impl Into<PathBuf>) -> Result<T>;
}

impl<T> IoContext<T> for std::io::Result<T> {
    fn at(self, verb: &'static str, path: impl Into<PathBuf>) -> Result<T> {
        self.map_err(|source| Error::Io {
            verb,
            path: path.into(),
            source,
        })
    }
}
