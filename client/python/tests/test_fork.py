"""DataLoader workers are forked from processes that may have used gRPC, and even be streaming."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no fork")


@contextlib.contextmanager
def far_peer(*tls):
    """A peer in another process: a gRPC server in this one would not be part of any training job's fork."""
    command = [sys.executable, TESTS / "peer.py", *tls]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield f"127.0.0.1:{process.stdout.readline().strip()}"
        process.stdin.close()
        process.wait(10)


def run_scenario(*arguments):
    # As in a fresh process: importing backlot here has set the variable for children.
    environment = {k: v for k, v in os.environ.items() if k != "GRPC_ENABLE_FORK_SUPPORT"}
    command = [sys.executable, TESTS / "fork_scenario.py", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=90, env=environment)
    assert result.returncode == 0 and result.stdout == "ok\n", result.stdout + result.stderr


@pytest.mark.parametrize("scenario", ["untouched", "used", "streaming", "late", "spawn"])
def test_workers_of_a_process_that_used_grpc(scenario):
    with far_peer() as target:
        run_scenario(scenario, target)


def test_workers_of_a_process_that_used_tls(certificate):
    with far_peer(*certificate) as target:
        run_scenario("streaming", target, certificate[1])
