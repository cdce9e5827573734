"""Errors of the client: one class a gRPC status, with the server's machine-readable details."""

from __future__ import annotations

import grpc
from google.rpc import error_details_pb2, status_pb2


class BacklotError(Exception):
    """Base of every error this package raises about the server or the connection.

    Attributes:
        message: the server's sentence.
        code: the gRPC status, or None if the error was found on this side.
        reason: UPPER_SNAKE_CASE reason of `google.rpc.ErrorInfo`, or "".
        metadata: `google.rpc.ErrorInfo.metadata`.
        field_violations: (field path, description) pairs of `google.rpc.BadRequest`.
        retry_after_s: seconds of `google.rpc.RetryInfo`, or None.
    """

    def __init__(
        self,
        message: str,
        *,
        code: grpc.StatusCode | None = None,
        reason: str = "",
        metadata: dict[str, str] | None = None,
        field_violations: tuple[tuple[str, str], ...] = (),
        retry_after_s: float | None = None,
    ):
        super().__init__(message)
        self.message = message
        self.code = code
        self.reason = reason
        self.metadata = metadata or {}
        self.field_violations = field_violations
        self.retry_after_s = retry_after_s

    def __str__(self) -> str:
        status = f"{self.code.name}: " if self.code else ""
        fields = "".join(f"; {field}: {text}" for field, text in self.field_violations)
        return f"{status}{self.message}{f' [{self.reason}]' if self.reason else ''}{fields}"


class InvalidArgumentError(BacklotError):
    """The request is wrong whatever the server's state (INVALID_ARGUMENT, OUT_OF_RANGE)."""


class NotFoundError(BacklotError):
    """A named asset, log, snapshot or job does not exist."""


class AlreadyExistsError(BacklotError):
    """The name is taken by something else."""


class FailedPreconditionError(BacklotError):
    """The server's state does not allow the call (FAILED_PRECONDITION, ABORTED)."""


class PermissionDeniedError(BacklotError):
    """The server does not accept these credentials (PERMISSION_DENIED, UNAUTHENTICATED)."""


class ResourceExhaustedError(BacklotError):
    """A limit was reached: message size, streams or disk."""


class UnavailableError(BacklotError):
    """The server could not be reached, and every retry failed."""


class DeadlineExceededError(BacklotError):
    """No answer within the time the caller gave."""


class CancelledError(BacklotError):
    """The call was cancelled."""


class DataLossError(BacklotError):
    """The server holds damaged data."""


class UnimplementedError(BacklotError):
    """The server is too old for this call."""


class InternalError(BacklotError):
    """The server failed (INTERNAL, UNKNOWN)."""


class ContractError(BacklotError):
    """The server's answer contradicts the protocol, e.g. samples out of order."""


class ForkError(BacklotError):
    """The connection cannot be used after this fork; the message says what to do."""


_CLASSES: dict[grpc.StatusCode, type[BacklotError]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgumentError,
    grpc.StatusCode.OUT_OF_RANGE: InvalidArgumentError,
    grpc.StatusCode.NOT_FOUND: NotFoundError,
    grpc.StatusCode.ALREADY_EXISTS: AlreadyExistsError,
    grpc.StatusCode.FAILED_PRECONDITION: FailedPreconditionError,
    grpc.StatusCode.ABORTED: FailedPreconditionError,
    grpc.StatusCode.PERMISSION_DENIED: PermissionDeniedError,
    grpc.StatusCode.UNAUTHENTICATED: PermissionDeniedError,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhaustedError,
    grpc.StatusCode.UNAVAILABLE: UnavailableError,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceededError,
    grpc.StatusCode.CANCELLED: CancelledError,
    grpc.StatusCode.DATA_LOSS: DataLossError,
    grpc.StatusCode.UNIMPLEMENTED: UnimplementedError,
}


def from_rpc(error: grpc.RpcError) -> BacklotError:
    """The error class of a failed call, with the details of its `google.rpc.Status` if it carries one."""
    code = error.code()
    details: dict = {}
    for key, value in error.trailing_metadata() or ():
        if key == "grpc-status-details-bin":
            details = _rich_details(value)
    return _CLASSES.get(code, InternalError)(error.details() or code.name, code=code, **details)


def is_retryable(error: BacklotError) -> bool:
    """True if asking again may help: the server is away, or it shed load and said when to come back."""
    if isinstance(error, ResourceExhaustedError):
        return error.retry_after_s is not None
    return isinstance(error, UnavailableError)


def _rich_details(encoded: bytes) -> dict:
    found: dict = {}
    for detail in status_pb2.Status.FromString(encoded).details:
        info = error_details_pb2.ErrorInfo()
        request = error_details_pb2.BadRequest()
        retry = error_details_pb2.RetryInfo()
        if detail.Unpack(info):
            found["reason"] = info.reason
            found["metadata"] = dict(info.metadata)
        elif detail.Unpack(request):
            found["field_violations"] = tuple((v.field, v.description) for v in request.field_violations)
        elif detail.Unpack(retry):
            found["retry_after_s"] = retry.retry_delay.ToTimedelta().total_seconds()
    return found
