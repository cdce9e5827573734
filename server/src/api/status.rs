//! The one place that makes a gRPC status: a table from error kind to code, with `google.rpc` details.

use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::error::{ErrorKind, Kinded};
use crate::ingest::Violations;

/// Domain of `google.rpc.ErrorInfo`.
const DOMAIN: &str = "backlot.v1";

/// Wait that overloaded and unavailable replies suggest.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// The reply to an error.
pub(crate) fn to_status(error: &(impl Kinded + ?Sized)) -> Status {
    let kind = error.kind();
    match kind {
        ErrorKind::Internal => {
            tracing::error!(error = %error, "internal error");
            // Details of a bug are for the log, not for clients.
            status(kind, "internal error; the server's log has the cause")
        }
        ErrorKind::Corrupt => {
            tracing::error!(error = %error, "corrupt data");
            status(kind, error.to_string())
        }
        _ => status(kind, error.to_string()),
    }
}

/// The reply to a message whose fields are wrong, one violation each.
pub(crate) fn violations_status(violations: &Violations) -> Status {
    let mut details = details(ErrorKind::Invalid);
    for violation in violations.reported() {
        details.add_bad_request_violation(&violation.field, &violation.description);
    }
    Status::with_error_details(Code::InvalidArgument, violations.to_string(), details)
}

/// The reply to one wrong field.
pub(crate) fn invalid_field(field: &str, description: impl std::fmt::Display) -> Status {
    let mut violations = Violations::default();
    violations.push(field, description.to_string());
    violations_status(&violations)
}

/// A status of `kind` with a message of the API layer itself.
pub(crate) fn status(kind: ErrorKind, message: impl Into<String>) -> Status {
    Status::with_error_details(code(kind), message, details(kind))
}

fn code(kind: ErrorKind) -> Code {
    match kind {
        ErrorKind::Invalid => Code::InvalidArgument,
        ErrorKind::NotFound => Code::NotFound,
        ErrorKind::Conflict => Code::AlreadyExists,
        ErrorKind::NotReady => Code::FailedPrecondition,
        ErrorKind::LeaseLost => Code::Aborted,
        ErrorKind::Overloaded => Code::ResourceExhausted,
        ErrorKind::Unavailable => Code::Unavailable,
        ErrorKind::Cancelled => Code::Cancelled,
        ErrorKind::Corrupt => Code::DataLoss,
        ErrorKind::Internal => Code::Internal,
    }
}

fn details(kind: ErrorKind) -> ErrorDetails {
    let reason = match kind {
        ErrorKind::Invalid => "INVALID",
        ErrorKind::NotFound => "NOT_FOUND",
        ErrorKind::Conflict => "CONFLICT",
        ErrorKind::NotReady => "NOT_READY",
        ErrorKind::LeaseLost => "LEASE_LOST",
        ErrorKind::Overloaded => "OVERLOADED",
        ErrorKind::Unavailable => "UNAVAILABLE",
        ErrorKind::Cancelled => "CANCELLED",
        ErrorKind::Corrupt => "CORRUPT",
        ErrorKind::Internal => "INTERNAL",
    };
    let mut details =
        ErrorDetails::with_error_info(reason, DOMAIN, std::collections::HashMap::new());
    if matches!(kind, ErrorKind::Overloaded | ErrorKind::Unavailable) {
        details.set_retry_info(Some(RETRY_AFTER));
    }
    details
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Error;

    #[test]
    fn details_say_which_field_and_when_to_retry() {
        let status = invalid_field("hold_out_every", "is 1");
        assert_eq!(status.code(), Code::InvalidArgument);
        let details = status.get_error_details();
        let bad = &details.bad_request().unwrap().field_violations[0];
        assert_eq!((&*bad.field, &*bad.description), ("hold_out_every", "is 1"));
        assert!(details.retry_info().is_none());

        let full = Error::DiskFull {
            free_bytes: 1,
            needed_bytes: 2,
        };
        let status = to_status(&full);
        assert_eq!(status.code(), Code::ResourceExhausted);
        assert!(status.message().contains("disk is full"));
        assert!(status.get_error_details().retry_info().is_some());
    }

    #[test]
    fn an_internal_error_does_not_show_its_details() {
        let error = Error::Index {
            what: "secret path".into(),
        };
        let status = to_status(&error);
        assert_eq!(status.code(), Code::Internal);
        assert!(!status.message().contains("secret"));
    }
}
