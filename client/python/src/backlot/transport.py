"""The connection: one gRPC channel a process, opened when first used, with retries for calls that are safe to repeat."""

from __future__ import annotations

import dataclasses
import random
import time

import grpc

from backlot.errors import BacklotError, CancelledError, from_rpc, is_retryable
from backlot.fork import GATE


@dataclasses.dataclass(frozen=True)
class Tls:
    """PEM bytes. Without `root_certificates` the system's are used; key and chain are for client authentication."""

    root_certificates: bytes | None = None
    private_key: bytes | None = None
    certificate_chain: bytes | None = None
    # Name to expect in the server's certificate if it is not the target's host.
    server_name: str | None = None


@dataclasses.dataclass(frozen=True)
class Retry:
    """How often to ask again without any progress, and how long to wait in between."""

    max_attempts: int = 10
    initial_s: float = 0.1
    multiplier: float = 2.0
    max_s: float = 5.0

    def delay_s(self, failures: int, draw: float, server_s: float | None = None) -> float:
        """Seconds to wait after the n-th failure in a row (from 1): exponential, spread by `draw` in 0..1 over its upper
        half so that many ranks do not come back at once, and never less than what the server asked for."""
        full = min(self.max_s, self.initial_s * self.multiplier ** (failures - 1))
        return max(full * (0.5 + 0.5 * draw), server_s or 0.0)


@dataclasses.dataclass(frozen=True)
class Connection:
    """How to reach a server; see `Client`."""

    target: str
    tls: Tls | None
    timeout_s: float
    sample_timeout_s: float
    retry: Retry
    max_message_bytes: int
    metadata: tuple[tuple[str, str], ...]


class Transport:
    """A channel that is opened lazily in each process and never crosses a fork."""

    def __init__(self, connection: Connection):
        self.connection = connection
        self._channel: grpc.Channel | None = None
        self._generation = GATE.generation

    def start(self, stub_class: type, method: str, request, timeout_s: float | None, streaming: bool):
        """Starts a call and returns it; end it with `GATE.finish`."""

        def call():
            bound = getattr(stub_class(self._open()), method)
            invoke = bound if streaming else bound.future
            return invoke(request, timeout=timeout_s, metadata=self.connection.metadata)

        return GATE.start(call)

    def unary(self, stub_class: type, method: str, request):
        """Makes a call that may be repeated safely, within the connection's timeout, retries included."""
        retry = self.connection.retry
        deadline = time.monotonic() + self.connection.timeout_s
        failures = 0
        while True:
            forks = GATE.forks
            try:
                return self._unary_once(stub_class, method, request, max(deadline - time.monotonic(), 0.001))
            except BacklotError as error:
                if isinstance(error, CancelledError) and GATE.forks != forks:
                    continue
                failures += 1
                delay = retry.delay_s(failures, random.random(), error.retry_after_s)
                if not is_retryable(error) or failures >= retry.max_attempts or time.monotonic() + delay > deadline:
                    raise
                time.sleep(delay)

    def _unary_once(self, stub_class: type, method: str, request, timeout_s: float):
        call = self.start(stub_class, method, request, timeout_s, streaming=False)
        try:
            with GATE.inside():
                return call.result()
        except grpc.RpcError as error:
            raise from_rpc(error) from None
        except grpc.FutureCancelledError:
            raise CancelledError("the call was cancelled", code=grpc.StatusCode.CANCELLED) from None
        finally:
            GATE.finish(call)

    def close(self) -> None:
        """Closes the channel; the next call opens another."""
        channel, self._channel = self._channel, None
        if channel is not None and self._generation == GATE.generation:
            with GATE.inside():
                channel.close()

    def _open(self) -> grpc.Channel:
        if self._channel is None or self._generation != GATE.generation:
            self._channel = _channel(self.connection)
            self._generation = GATE.generation
            GATE.watch_forks()
        return self._channel


def parse_target(target: str, tls: Tls | bool | None) -> tuple[str, Tls | None]:
    """ "host:port" and the certificates of a target, which may be a URL: https:// stands for TLS, http:// for none."""
    certificates = Tls() if tls is True else (tls or None)
    scheme, separator, rest = target.partition("://")
    if not separator:
        return target, certificates
    if scheme not in ("http", "https"):
        raise ValueError(f"the target's scheme is http or https, not {scheme}")
    if scheme == "http" and certificates is not None:
        raise ValueError(f"{target} is in the clear and cannot have certificates")
    return rest.rstrip("/"), certificates or (Tls() if scheme == "https" else None)


def _channel(connection: Connection) -> grpc.Channel:
    options = [
        ("grpc.max_receive_message_length", connection.max_message_bytes),
        ("grpc.max_send_message_length", connection.max_message_bytes),
        # gRPC's own reconnection backs off to two minutes; ours decides when to ask again.
        ("grpc.initial_reconnect_backoff_ms", 100),
        ("grpc.min_reconnect_backoff_ms", 1_000),
        ("grpc.max_reconnect_backoff_ms", 2_000),
        # A peer that vanished without closing its socket is noticed within 40 s, while a call is open.
        ("grpc.keepalive_time_ms", 30_000),
        ("grpc.keepalive_timeout_ms", 10_000),
        # Two clients in one process are two connections, so that closing one does not concern the other.
        ("grpc.use_local_subchannel_pool", 1),
    ]
    tls = connection.tls
    if tls is None:
        return grpc.insecure_channel(connection.target, options)
    if tls.server_name is not None:
        options.append(("grpc.ssl_target_name_override", tls.server_name))
    credentials = grpc.ssl_channel_credentials(tls.root_certificates, tls.private_key, tls.certificate_chain)
    return grpc.secure_channel(connection.target, credentials, options)
