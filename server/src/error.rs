//! Error kinds of the service; `api/status.rs` maps each to one gRPC status.

pub use backlot_engine::ErrorKind;

/// An error that says what it means to the caller.
pub trait Kinded: std::error::Error {
    fn kind(&self) -> ErrorKind;
}

impl Kinded for backlot_engine::Error {
    fn kind(&self) -> ErrorKind {
        backlot_engine::Error::kind(self)
    }
}
