//! What surrounds every call: a span, and a status instead of a broken connection when a handler panics.

use std::any::Any;

use tonic::Status;
use tonic::body::Body;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::classify::{GrpcErrorsAsFailures, SharedClassifier};
use tower_http::trace::{DefaultMakeSpan, DefaultOnFailure, DefaultOnResponse, TraceLayer};
use tracing::Level;

use super::status::status;
use crate::error::ErrorKind;

type PanicResponse = fn(Box<dyn Any + Send + 'static>) -> tonic::codegen::http::Response<Body>;

/// Turns a panic into INTERNAL; the panic itself is in the log.
pub(crate) fn catch_panic() -> CatchPanicLayer<PanicResponse> {
    CatchPanicLayer::custom(internal as PanicResponse)
}

/// One span a call, at `info`; failures of the server at `warn`.
pub(crate) fn trace() -> TraceLayer<SharedClassifier<GrpcErrorsAsFailures>> {
    TraceLayer::new_for_grpc()
        .make_span_with(DefaultMakeSpan::new().level(Level::INFO))
        .on_response(DefaultOnResponse::new().level(Level::DEBUG))
        .on_failure(DefaultOnFailure::new().level(Level::WARN))
}

fn internal(_: Box<dyn Any + Send + 'static>) -> tonic::codegen::http::Response<Body> {
    let status: Status = status(ErrorKind::Internal, "the call panicked");
    status.into_http()
}
