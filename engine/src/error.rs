//! Engine errors and the small set of kinds shared by every crate of the service.

/// What an error means to the caller; the API layer maps each kind to one gRPC status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    Invalid,
    NotFound,
    Conflict,
    NotReady,
    LeaseLost,
    Overloaded,
    Unavailable,
    Cancelled,
    Corrupt,
    Internal,
}

pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong in the engine because of its input or the machine.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input is unusable; `what` names the frame and field and says what to do.
    #[error("{what}")]
    Invalid { what: String },
    /// Training produced a value that is not finite.
    #[error("training diverged at step {step}: {quantity} is not finite")]
    Diverged { step: u64, quantity: &'static str },
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// Stored bytes do not decode.
    #[error("corrupt asset: {what}")]
    Corrupt { what: String },
    /// More memory is needed than allowed.
    #[error("{what} needs {needed_bytes} bytes, {available_bytes} are available")]
    OutOfMemory {
        what: &'static str,
        needed_bytes: u64,
        available_bytes: u64,
    },
    /// No device, or the device was lost.
    #[error("device: {what}")]
    Device { what: String },
}

impl Error {
    pub fn invalid(what: impl Into<String>) -> Self {
        Self::Invalid { what: what.into() }
    }

    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Invalid { .. } => ErrorKind::Invalid,
            Self::Diverged { .. } => ErrorKind::Internal,
            Self::Cancelled => ErrorKind::Cancelled,
            Self::Corrupt { .. } => ErrorKind::Corrupt,
            Self::OutOfMemory { .. } => ErrorKind::Overloaded,
            Self::Device { .. } => ErrorKind::Unavailable,
        }
    }
}
