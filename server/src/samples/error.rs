//! What can go wrong while samples are made.

use crate::error::{ErrorKind, Kinded};
use crate::store;

pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(transparent)]
    Store(#[from] store::Error),
    #[error(transparent)]
    Engine(#[from] backlot_engine::Error),
    /// A name that the snapshot does not have.
    #[error("{what}")]
    NotFound { what: String },
    #[error("{what}")]
    Invalid { what: String },
    #[error("encoding an image: {0}")]
    Encode(#[from] image::ImageError),
}

impl Kinded for Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Store(e) => e.kind(),
            Self::Engine(e) => e.kind(),
            Self::NotFound { .. } => ErrorKind::NotFound,
            Self::Invalid { .. } => ErrorKind::Invalid,
            Self::Encode(_) => ErrorKind::Internal,
        }
    }
}
