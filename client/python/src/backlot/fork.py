"""Makes gRPC survive fork(), which PyTorch's DataLoader does for every worker.

gRPC can be forked only while no thread is inside it, and only with its own fork handlers on (grpc/grpc #32992). So calls go
through `GATE`: before a fork it cancels them, waits until their threads are outside and holds new ones back; streams then go on
from their next index, in the parent, and a child opens a channel of its own.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time

# gRPC reads this once, when it is first imported. Without it a child of a process that has used gRPC hangs.
_CHOSEN_IN_TIME = "grpc" not in sys.modules
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "1")

import grpc  # noqa: E402

from backlot.errors import ForkError  # noqa: E402

# Longest that a fork is held up by a thread inside gRPC; cancelled calls return within milliseconds.
_PARK_TIMEOUT_S = 5.0


class ForkGate:
    """Keeps threads outside gRPC while the process forks."""

    def __init__(self):
        self._condition = threading.Condition()
        self._calls: set[grpc.Call] = set()
        self._inside = 0
        self._paused = False
        self._registered = False
        # Forks seen by this process, as the parent: a call cancelled across a change was cancelled by the fork.
        self.forks = 0
        # Forks between the first process and this one: a channel of another generation is not ours.
        self.generation = 0
        self.unusable = False

    @contextlib.contextmanager
    def inside(self):
        """Held by a thread while it is inside gRPC."""
        with self._condition:
            self._condition.wait_for(lambda: not self._paused)
            self._inside += 1
        try:
            yield
        finally:
            with self._condition:
                self._inside -= 1
                self._condition.notify_all()

    def start(self, call):
        """Starts a call with `call()`, which must not block, and remembers it for the next fork."""
        if self.unusable:
            raise ForkError(
                "gRPC was used in the parent process before the fork, without fork support: import backlot before grpc "
                "with GRPC_ENABLE_FORK_SUPPORT unset or 1, or use multiprocessing_context='forkserver' or 'spawn'"
            )
        with self.inside():
            started = call()
            with self._condition:
                self._calls.add(started)
        return started

    def finish(self, call) -> None:
        with self._condition:
            self._calls.discard(call)

    def watch_forks(self) -> None:
        """Installs the fork handlers. Called after the first channel is open, so that ours run before gRPC's."""
        with self._condition:
            if self._registered or not hasattr(os, "register_at_fork"):
                return
            self._registered = True
        os.register_at_fork(before=self._before, after_in_parent=self._after, after_in_child=self._after_in_child)

    def _before(self) -> None:
        with self._condition:
            self._paused = True
            self.forks += 1
        deadline = time.monotonic() + _PARK_TIMEOUT_S
        while True:
            # Again and again: a thread that was inside when we paused may have started another call.
            self._cancel_calls()
            with self._condition:
                if self._condition.wait_for(lambda: self._inside == 0, 0.05) or time.monotonic() > deadline:
                    break
        self._cancel_calls()

    def _cancel_calls(self) -> None:
        with self._condition:
            calls = list(self._calls)
        for call in calls:
            call.cancel()

    def _after(self) -> None:
        with self._condition:
            self._paused = False
            self._condition.notify_all()

    def _after_in_child(self) -> None:
        # Other threads are gone, whatever they held: nothing inherited is waited for.
        self._condition = threading.Condition()
        self._calls = set()
        self._inside = 0
        self._paused = False
        self.generation += 1
        self.unusable = not _fork_support()


def _fork_support() -> bool:
    try:
        from grpc._cython.cygrpc import is_fork_support_enabled
    except ImportError:
        return _CHOSEN_IN_TIME
    return is_fork_support_enabled()


GATE = ForkGate()
