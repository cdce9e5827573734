//! What can go wrong between this client and a server.

use backlot_engine::ErrorKind;
use tonic::{Code, Status};
use tonic_types::StatusExt;

pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("server address {url:?}: {what}; expected e.g. http://127.0.0.1:50051")]
    Address { url: String, what: String },
    #[error("cannot reach the server at {url}: {what}")]
    Connect { url: String, what: String },
    /// The server answered a call with a status that is not OK.
    #[error("{doing}: {}", describe(status))]
    Status { doing: String, status: Box<Status> },
    #[error("{}: {source}", path.display())]
    Io {
        path: std::path::PathBuf,
        source: std::io::Error,
    },
    /// The server sent something that breaks the contract, or the bytes were damaged on the way.
    #[error("{doing}: {what}")]
    Protocol { doing: String, what: String },
    /// A name given by the caller is not one.
    #[error("{what}")]
    Invalid { what: String },
}

impl Error {
    /// The error of a call that answered with a status that is not OK; `doing` says what was asked.
    pub fn from_status(doing: &str, status: Status) -> Self {
        Self::status(doing)(status)
    }

    pub(crate) fn status(doing: impl Into<String>) -> impl FnOnce(Status) -> Self {
        let doing = doing.into();
        move |status| Self::Status {
            doing,
            status: Box::new(status),
        }
    }

    pub(crate) fn io(path: &std::path::Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Address { .. } | Self::Invalid { .. } => ErrorKind::Invalid,
            Self::Connect { .. } | Self::Io { .. } => ErrorKind::Unavailable,
            Self::Protocol { .. } => ErrorKind::Corrupt,
            Self::Status { status, .. } => match status.code() {
                Code::InvalidArgument | Code::OutOfRange => ErrorKind::Invalid,
                Code::NotFound => ErrorKind::NotFound,
                Code::AlreadyExists | Code::Aborted => ErrorKind::Conflict,
                Code::FailedPrecondition => ErrorKind::NotReady,
                Code::ResourceExhausted => ErrorKind::Overloaded,
                Code::Unavailable | Code::DeadlineExceeded => ErrorKind::Unavailable,
                Code::Cancelled => ErrorKind::Cancelled,
                Code::DataLoss => ErrorKind::Corrupt,
                _ => ErrorKind::Internal,
            },
        }
    }

    /// True for causes that pass: the server is restarting, overloaded, or the connection broke.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Connect { .. } => true,
            Self::Status { status, .. } => is_transient(status),
            _ => false,
        }
    }
}

/// A broken connection is reported as UNKNOWN or CANCELLED where it broke inside a streaming call.
pub(crate) fn is_transient(status: &Status) -> bool {
    match status.code() {
        Code::Unavailable => true,
        Code::Unknown | Code::Cancelled | Code::Internal => {
            std::error::Error::source(status).is_some()
        }
        _ => false,
    }
}

/// One line: the code's name, the message, the violated fields and the machine-readable reason.
fn describe(status: &Status) -> String {
    let mut line = format!("{} ({})", status.message(), code_name(status.code()));
    let details = status.get_error_details();
    if let Some(bad_request) = details.bad_request() {
        for violation in &bad_request.field_violations {
            line += &format!("; {}: {}", violation.field, violation.description);
        }
    }
    let reason = details.error_info().map(|info| info.reason.as_str());
    if let Some(reason) = reason.filter(|reason| *reason != code_name(status.code())) {
        line += &format!(" [{reason}]");
    }
    line
}

/// The code as gRPC writes it, e.g. `INVALID_ARGUMENT`.
fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

#[cfg(test)]
mod tests {
    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn field_violations_reach_the_message() {
        let details = ErrorDetails::with_bad_request_violation("frames[3].image", "is truncated");
        let status =
            Status::with_error_details(Code::InvalidArgument, "drive log is not valid", details);
        let error = Error::status("creating driveLogs/a")(status).to_string();
        for text in [
            "driveLogs/a",
            "INVALID_ARGUMENT",
            "frames[3].image",
            "is truncated",
        ] {
            assert!(error.contains(text), "{error}");
        }
    }

    #[test]
    fn only_passing_causes_are_transient() {
        assert!(is_transient(&Status::unavailable("restarting")));
        for status in [
            Status::invalid_argument("x"),
            Status::cancelled("by the caller"),
            Status::data_loss("digest"),
        ] {
            assert!(!is_transient(&status), "{status:?}");
        }
    }
}
