//! The bridge from async handlers to blocking work.

use tonic::Status;

use super::status::{status, to_status};
use crate::error::{ErrorKind, Kinded};

/// Runs `work` on a blocking thread. It runs to its end even if the caller goes away, so a dropped call cuts no commit.
pub(crate) async fn blocking<T, E>(
    work: impl FnOnce() -> Result<T, E> + Send + 'static,
) -> Result<T, Status>
where
    T: Send + 'static,
    E: Kinded + Send + 'static,
{
    blocking_status(move || work().map_err(|e| to_status(&e))).await
}

/// As [`blocking`], for work that makes its own status.
pub(crate) async fn blocking_status<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let span = tracing::Span::current();
    tokio::task::spawn_blocking(move || span.in_scope(work))
        .await
        .unwrap_or_else(|_| Err(status(ErrorKind::Internal, "the call's work panicked")))
}
