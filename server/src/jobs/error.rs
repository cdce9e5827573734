//! What can go wrong with a job besides the job itself.

use crate::domain::job::Rejected;
use crate::error::{ErrorKind, Kinded};
use crate::store;

pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(transparent)]
    Store(#[from] store::Error),
    #[error("{job}: {rejected}")]
    Rejected { job: String, rejected: Rejected },
    #[error("{limit} jobs are queued already; wait for some to end")]
    QueueFull { limit: usize },
    #[error("{what}")]
    Invalid { what: String },
}

impl Kinded for Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Store(e) => e.kind(),
            Self::Rejected { rejected, .. } => rejected.kind(),
            Self::QueueFull { .. } => ErrorKind::Overloaded,
            Self::Invalid { .. } => ErrorKind::Invalid,
        }
    }
}
