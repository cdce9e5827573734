"""Samples as an iterator: read ahead by a bounded amount, and resumed at the next index when the connection breaks."""

from __future__ import annotations

import queue
import random
import threading
import weakref
from collections.abc import Iterable

import grpc

from backlot.errors import (
    BacklotError,
    CancelledError,
    ContractError,
    DeadlineExceededError,
    ForkError,
    ResourceExhaustedError,
    from_rpc,
    is_retryable,
)
from backlot.fork import GATE
from backlot.recipe import Recipe
from backlot.sample import Sample, decode
from backlot.transport import Transport
from backlot.v1 import samples_pb2, samples_pb2_grpc

# Longest that closing a stream waits for its thread, which may be decoding a sample.
_STOP_TIMEOUT_S = 2.0


class SampleStream:
    """Iterates over samples of a recipe; made by `Client.stream_samples`.

    A thread reads and decodes ahead. It asks for no more samples than there is room for, at most `prefetch`, so that a reader that
    pauses holds no call open: a server renders for a limited number of calls at once. A sample depends only on its index, so
    a broken call is repeated from the first index that has not arrived.
    """

    def __init__(
        self, transport: Transport, recipe: Recipe, seed: int, ranges: Iterable[tuple[int, int]], prefetch: int
    ):
        if prefetch < 1:
            raise ValueError(f"prefetch must be at least 1, not {prefetch}")
        self._timeout_s = transport.connection.sample_timeout_s
        self._reader = _Reader(transport, recipe, seed, ranges, prefetch)
        self._close = weakref.finalize(self, self._reader.stop)

    def __iter__(self) -> SampleStream:
        return self

    def __next__(self) -> Sample:
        if self._reader.stopped.is_set():
            raise StopIteration
        self._reader.ensure_running()
        try:
            item = self._reader.arrived.get(timeout=self._timeout_s)
        except queue.Empty:
            self.close()
            raise DeadlineExceededError(f"no sample arrived within {self._timeout_s} s") from self._reader.last_error
        if isinstance(item, Sample):
            self._reader.slots.release()
            return item
        self.close()
        raise item

    def close(self) -> None:
        """Cancels the call, which stops the server's work on it. Iterating further ends at once."""
        self._close()

    def __enter__(self) -> SampleStream:
        return self

    def __exit__(self, *exception) -> None:
        self.close()


class _Reader:
    """The side of a stream that runs in its thread."""

    def __init__(
        self, transport: Transport, recipe: Recipe, seed: int, ranges: Iterable[tuple[int, int]], prefetch: int
    ):
        self._transport = transport
        self._request = samples_pb2.StreamSamplesRequest(recipe=recipe.to_proto(), seed=seed)
        self._ranges = ranges
        self._call: grpc.Call | None = None
        self._failures = 0
        # Asked for again when half of the room is free: calls are neither idle nor of single samples.
        self._least_room = (prefetch + 1) // 2
        # Slots taken for samples that have not arrived.
        self._room = 0
        self._thread: threading.Thread | None = None
        self._generation = GATE.generation
        # Samples, then one exception: StopIteration at the end.
        self.arrived: queue.SimpleQueue[Sample | BaseException] = queue.SimpleQueue()
        # Free places for samples that were read and not yet taken.
        self.slots = threading.Semaphore(prefetch)
        self.stopped = threading.Event()
        # Why the last attempt failed, if it did.
        self.last_error: BacklotError | None = None

    def ensure_running(self) -> None:
        if self._thread is None:
            self._generation = GATE.generation
            self._thread = threading.Thread(target=self._run, name="backlot-samples", daemon=True)
            self._thread.start()
        elif self._generation != GATE.generation:
            raise ForkError("this stream was begun before the fork; open one in each process")

    def stop(self) -> None:
        """Ends the thread and its call. In a fork's child there is neither."""
        inherited = self._generation != GATE.generation
        if self._thread is not None and inherited:
            return
        self.stopped.set()
        self.slots.release()
        call = self._call
        if call is not None:
            call.cancel()
        if self._thread is not None and threading.current_thread() is not self._thread:
            self._thread.join(_STOP_TIMEOUT_S)

    def _run(self) -> None:
        end: BaseException = StopIteration()
        try:
            for start, count in self._ranges:
                self._read_range(start, start + count)
        except _Stopped:
            pass
        except BaseException as error:
            end = error
        self.arrived.put(end)

    def _read_range(self, start: int, end: int) -> None:
        next_index = start
        while next_index < end:
            self._wait_for_room(end - next_index)
            forks = GATE.forks
            try:
                for sample in self._attempt(next_index, min(end - next_index, self._room)):
                    next_index += 1
                    self._room -= 1
                    self._failures = 0
                    self.last_error = None
                    self.arrived.put(sample)
            except BacklotError as error:
                self._wait_or_raise(error, forked=GATE.forks != forks)

    def _wait_for_room(self, wanted: int) -> None:
        """Takes slots for up to `wanted` samples, waiting for the least number of them."""
        while self._room < min(wanted, self._least_room):
            self.slots.acquire()
            self._check_stopped()
            self._room += 1
        while self._room < wanted and self.slots.acquire(blocking=False):
            self._room += 1

    def _attempt(self, start: int, count: int):
        """One call for samples [start, start + count)."""
        request = samples_pb2.StreamSamplesRequest(
            recipe=self._request.recipe, seed=self._request.seed, start_index=start, count=count
        )
        timeout_s = self._transport.connection.sample_timeout_s * count
        self._check_stopped()
        call = self._transport.start(
            samples_pb2_grpc.SampleServiceStub, "StreamSamples", request, timeout_s, streaming=True
        )
        self._call = call
        try:
            for index in range(start, start + count):
                self._check_stopped()
                yield self._receive(call, index)
            self._receive_end(call, start + count)
        finally:
            self._call = None
            call.cancel()
            GATE.finish(call)

    def _receive(self, call: grpc.Call, index: int) -> Sample:
        try:
            with GATE.inside():
                response = next(call, None)
        except grpc.RpcError as error:
            raise from_rpc(error) from None
        if response is None:
            raise _Ended(f"the server ended the stream before sample {index}")
        if response.sample.index != index:
            raise ContractError(f"the server sent sample {response.sample.index} in place of {index}")
        self._check_snapshot(response.sample)
        return decode(response.sample)

    def _receive_end(self, call: grpc.Call, end: int) -> None:
        """Lets the server end the call by itself: a peer may count resets against the connection."""
        try:
            with GATE.inside():
                response = next(call, None)
        except grpc.RpcError:
            return
        if response is not None:
            raise ContractError(f"the server sent sample {response.sample.index} past the end at {end}")

    def _check_snapshot(self, sample: samples_pb2.Sample) -> None:
        wanted, got = self._request.recipe.library_snapshot, sample.provenance.library_snapshot
        if got != wanted:
            raise ContractError(f"the server drew from {got or 'no snapshot'} in place of {wanted}")

    def _wait_or_raise(self, error: BacklotError, forked: bool) -> None:
        self._check_stopped()
        if forked and isinstance(error, CancelledError):
            return
        self.last_error = error
        retry = self._transport.connection.retry
        self._failures += 1
        if not (isinstance(error, _Ended) or is_retryable(error)):
            raise error
        # A server that sheds load is well, and has other readers to serve: the consumer's deadline ends this, not a count.
        if self._failures >= retry.max_attempts and not isinstance(error, ResourceExhaustedError):
            raise error
        self.stopped.wait(retry.delay_s(self._failures, random.random(), error.retry_after_s))
        self._check_stopped()

    def _check_stopped(self) -> None:
        if self.stopped.is_set():
            raise _Stopped


class _Ended(ContractError):
    """The stream ended early without an error, as when a server shuts down: worth asking again."""


class _Stopped(Exception):
    """The consumer closed the stream."""
