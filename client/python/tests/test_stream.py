"""Streams: order, resuming at the exact index, bounded reading ahead, refusals, closing."""

import threading
import time

import grpc
import numpy as np
import pytest
from conftest import FAST
from cutting_proxy import CuttingProxy
from peer import Fault, image_of, retry_info

from backlot import (
    Client,
    ContractError,
    DeadlineExceededError,
    InvalidArgumentError,
    Recipe,
    ResourceExhaustedError,
    UnavailableError,
)


def indices(stream):
    return [sample.index for sample in stream]


def test_samples_arrive_in_order(client, recipe):
    samples = list(client.stream_samples(recipe, seed=3, start=10, count=5))
    assert [s.index for s in samples] == [10, 11, 12, 13, 14]
    assert all(np.array_equal(s.frame.image, image_of(s.index, 3)) for s in samples)


def test_a_broken_stream_goes_on_at_the_next_index(client, peer, recipe):
    peer.samples.faults = [Fault(3), Fault(0), Fault(2, code=None), Fault(5)]
    stream = client.stream_samples(recipe, seed=3, start=100, count=20, prefetch=20)
    assert indices(stream) == list(range(100, 120))
    # Nothing is asked for twice.
    assert peer.samples.calls == [(100, 20), (103, 17), (103, 17), (105, 15), (110, 10)]


def test_a_cut_connection_goes_on_at_the_next_index(peer, recipe):
    proxy = CuttingProxy(peer.target, cuts=3, after_bytes=20_000)
    with Client(proxy.target, retry=FAST) as client:
        samples = list(client.stream_samples(recipe, seed=3, count=40))
    proxy.close()
    assert [s.index for s in samples] == list(range(40))
    assert all(np.array_equal(s.frame.image, image_of(s.index, 3)) for s in samples)
    assert proxy.made >= 4 and len(peer.samples.calls) >= 4


def test_failures_without_progress_end_the_stream(client, peer, recipe):
    peer.samples.faults = [Fault(2)] + [Fault(0)] * FAST.max_attempts
    stream = client.stream_samples(recipe, seed=3, count=20)
    assert [next(stream).index, next(stream).index] == [0, 1]
    with pytest.raises(UnavailableError):
        next(stream)
    assert indices(stream) == []


def test_failures_with_progress_do_not_add_up(client, peer, recipe):
    peer.samples.faults = [Fault(1) for _ in range(3 * FAST.max_attempts)]
    assert indices(client.stream_samples(recipe, seed=3, count=20)) == list(range(20))


def test_load_that_is_shed_is_asked_for_again_and_other_exhaustion_is_not(client, peer, recipe):
    peer.samples.faults = [Fault(1, grpc.StatusCode.RESOURCE_EXHAUSTED, [retry_info(0.02)])]
    assert indices(client.stream_samples(recipe, seed=3, count=3)) == [0, 1, 2]
    peer.samples.faults = [Fault(1, grpc.StatusCode.RESOURCE_EXHAUSTED)]
    with pytest.raises(ResourceExhaustedError):
        indices(client.stream_samples(recipe, seed=3, count=3))


def test_a_wrong_request_is_not_repeated(client, peer, recipe):
    peer.samples.faults = [Fault(0, grpc.StatusCode.INVALID_ARGUMENT)]
    with pytest.raises(InvalidArgumentError):
        next(client.stream_samples(recipe, seed=3, count=3))
    assert len(peer.samples.calls) == 1


def test_samples_out_of_order_or_of_another_snapshot_are_refused(client, peer, recipe):
    peer.samples.shift = 1
    with pytest.raises(ContractError, match="sample 1 in place of 0"):
        next(client.stream_samples(recipe, seed=3, count=3))
    peer.samples.shift = 0
    peer.samples.snapshot = "librarySnapshots/other"
    with pytest.raises(ContractError, match="drew from"):
        next(client.stream_samples(recipe, seed=3, count=3))


def test_a_recipe_without_a_snapshot_is_pinned(client, peer):
    assert indices(client.stream_samples(Recipe(background="assets/street"), seed=3, count=2)) == [0, 1]


def settle(peer):
    """Waits until the peer sends nothing more."""
    before = -1
    while peer.samples.sent != before or peer.samples.running:
        before = peer.samples.sent
        time.sleep(0.2)


@pytest.mark.parametrize("prefetch", [1, 2, 7])
def test_reading_ahead_is_bounded(client, peer, recipe, prefetch):
    stream = client.stream_samples(recipe, seed=3, count=50, prefetch=prefetch)
    next(stream)
    settle(peer)
    assert 1 <= peer.samples.sent <= 1 + prefetch
    assert indices(stream) == list(range(1, 50))
    assert peer.samples.sent == 50


def test_readers_that_pause_leave_the_server_to_others(client, peer, recipe):
    peer.samples.max_running = 1
    paused = [client.stream_samples(recipe, seed=3, count=100_000) for _ in range(3)]
    for stream in paused:
        next(stream)
    assert indices(client.stream_samples(recipe, seed=3, count=30)) == list(range(30))
    assert [next(stream).index for stream in paused] == [1, 1, 1]


def test_a_busy_server_is_waited_for_until_the_deadline(peer, recipe):
    peer.samples.max_running = 0
    with Client(peer.target, retry=FAST, sample_timeout_s=0.6) as client:
        with pytest.raises(DeadlineExceededError) as caught:
            next(client.stream_samples(recipe, seed=3, count=3))
        assert isinstance(caught.value.__cause__, ResourceExhaustedError)
        peer.samples.max_running = 1
        assert indices(client.stream_samples(recipe, seed=3, count=3)) == [0, 1, 2]


def test_a_silent_server_ends_in_a_deadline(peer, recipe):
    peer.samples.faults = [Fault(1, hang=True)]
    with Client(peer.target, sample_timeout_s=0.3) as client:
        stream = client.stream_samples(recipe, seed=3, count=3)
        next(stream)
        with pytest.raises(DeadlineExceededError):
            next(stream)


@pytest.mark.parametrize("how", ["close", "drop"])
def test_closing_or_dropping_a_stream_ends_its_thread(client, recipe, how):
    stream = client.stream_samples(recipe, seed=3, count=100_000)
    next(stream)
    assert any(t.name == "backlot-samples" for t in threading.enumerate())
    if how == "close":
        stream.close()
        assert indices(stream) == []
    else:
        del stream
    assert not any(t.name == "backlot-samples" for t in threading.enumerate())


def test_bad_arguments_are_refused_before_anything_is_sent(client, peer, recipe):
    for arguments in ({"count": -1}, {"start": -1, "count": 1}, {"count": 1, "prefetch": 0}):
        with pytest.raises(ValueError):
            client.stream_samples(recipe, seed=0, **arguments)
    with pytest.raises(ValueError):
        client.stream_samples(recipe, seed=-1, count=1)
    assert peer.samples.calls == []
