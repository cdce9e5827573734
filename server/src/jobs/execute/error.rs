//! Why an attempt ends without a result.

use crate::domain::drive_log::ManifestError;
use crate::domain::job::Failure;
use crate::error::{ErrorKind, Kinded};
use crate::ingest::FrameError;
use crate::jobs::worker_port::PortError;

#[derive(Debug, thiserror::Error)]
pub(super) enum Error {
    #[error(transparent)]
    Port(#[from] PortError),
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error(transparent)]
    Frame(FrameError<PortError>),
    #[error(transparent)]
    Engine(#[from] backlot_engine::Error),
    /// The job's control asked to stop while the log was read.
    #[error("cancelled")]
    Cancelled,
}

impl From<FrameError<PortError>> for Error {
    fn from(error: FrameError<PortError>) -> Self {
        match error {
            FrameError::Blob(port) => Self::Port(port),
            other => Self::Frame(other),
        }
    }
}

impl Error {
    pub(super) fn kind(&self) -> ErrorKind {
        match self {
            Self::Port(e) => e.kind(),
            Self::Manifest(e) => e.kind(),
            Self::Frame(e) => e.kind().unwrap_or(ErrorKind::Internal),
            Self::Engine(e) => e.kind(),
            Self::Cancelled => ErrorKind::Cancelled,
        }
    }

    /// As the job's record keeps it. Input that is wrong once is wrong again; the store or the machine may recover, and a run
    /// that diverged may not diverge again, since threads add in another order.
    pub(super) fn into_failure(self) -> Failure {
        let diverged = matches!(self, Self::Engine(backlot_engine::Error::Diverged { .. }));
        let (reason, retryable) = match self.kind() {
            _ if diverged => ("DIVERGED", true),
            ErrorKind::Invalid | ErrorKind::NotReady | ErrorKind::Conflict => ("BAD_INPUT", false),
            ErrorKind::NotFound | ErrorKind::Corrupt => ("CORRUPT", false),
            ErrorKind::Cancelled => ("CANCELLED", false),
            ErrorKind::LeaseLost => ("LEASE_LOST", false),
            ErrorKind::Overloaded => ("OUT_OF_RESOURCES", true),
            ErrorKind::Unavailable => ("UNAVAILABLE", true),
            ErrorKind::Internal => ("INTERNAL", true),
        };
        Failure {
            reason: reason.to_owned(),
            message: self.to_string(),
            retryable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_input_is_not_tried_again_and_a_full_disk_is() {
        let invalid = Error::Engine(backlot_engine::Error::invalid("frame 3: NaN"));
        let failure = invalid.into_failure();
        assert_eq!(failure.reason, "BAD_INPUT");
        assert!(!failure.retryable && failure.message.contains("frame 3"));
        let full = Error::Port(PortError {
            kind: ErrorKind::Unavailable,
            message: "disk".into(),
        });
        assert!(full.into_failure().retryable);
        let lost = Error::Engine(backlot_engine::Error::Device {
            what: "device lost".into(),
        });
        assert!(lost.into_failure().retryable, "another device may do it");
        let diverged = Error::Engine(backlot_engine::Error::Diverged {
            step: 7,
            quantity: "loss",
        });
        assert_eq!(diverged.into_failure().reason, "DIVERGED");
    }
}
