//! What can go wrong between the host and a device.

/// A device's refusal or failure; becomes [`crate::Error`] at the backend's boundary.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The machine does not have the adapter that was asked for.
    #[error("{reason}")]
    NoAdapter { reason: String },
    /// The adapter is there and opening it failed.
    #[error("open {adapter}: {reason}")]
    Open { adapter: String, reason: String },
    /// The device is gone; everything on it is lost, and a new device must be opened.
    #[error("device lost: {reason}")]
    Lost { reason: String },
    /// One buffer is larger than the adapter can bind.
    #[error("{what} needs {needed_bytes} bytes in one buffer, the adapter binds {available_bytes}")]
    TooLarge {
        what: &'static str,
        needed_bytes: u64,
        available_bytes: u64,
    },
    /// What is in use leaves too little of the memory that assets may take.
    #[error("an asset needs {needed_bytes} bytes on the device, {available_bytes} are available")]
    NoRoom {
        needed_bytes: u64,
        available_bytes: u64,
    },
    /// The device has no memory left. How much it has in all no driver tells; what this program holds of it is known.
    #[error(
        "out of device memory: {stage} needs {needed_bytes} bytes besides the {held_bytes} that are in use"
    )]
    OutOfMemory {
        stage: &'static str,
        /// 0 where it is not a buffer that does not fit.
        needed_bytes: u64,
        held_bytes: u64,
    },
    /// The caller no longer wants it.
    #[error("cancelled")]
    Cancelled,
    /// The driver refused a call that is legal for all we know.
    #[error("{stage}: {reason}")]
    Rejected { stage: &'static str, reason: String },
}

impl From<Error> for crate::Error {
    fn from(error: Error) -> Self {
        match error {
            Error::TooLarge {
                what,
                needed_bytes,
                available_bytes,
            } => Self::OutOfMemory {
                what,
                needed_bytes,
                available_bytes,
            },
            Error::NoRoom {
                needed_bytes,
                available_bytes,
            } => Self::OutOfMemory {
                what: "an asset on the device",
                needed_bytes,
                available_bytes,
            },
            Error::Cancelled => Self::Cancelled,
            other => Self::Device {
                what: other.to_string(),
            },
        }
    }
}
