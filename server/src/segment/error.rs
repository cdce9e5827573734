//! Why an image could not be segmented.

use crate::error::{ErrorKind, Kinded};

#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    /// The file is not of the layout that the configuration says.
    #[error("the model's outputs are {found}, where {layout} has {expected}")]
    Outputs {
        layout: &'static str,
        found: String,
        expected: &'static str,
    },
    #[error("the model put out {what} that is not a number")]
    NotFinite { what: &'static str },
    /// What the runtime says.
    #[error("the model cannot be run: {0}")]
    Runtime(String),
}

impl Kinded for SegmentError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Outputs { .. } | Self::NotFinite { .. } => ErrorKind::Invalid,
            Self::Runtime(_) => ErrorKind::Internal,
        }
    }
}
