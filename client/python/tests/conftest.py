import subprocess

import pytest
from peer import SNAPSHOT, Peer

from backlot import Client, Recipe, Retry

FAST = Retry(max_attempts=4, initial_s=0.01, max_s=0.05)


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.stop()


@pytest.fixture
def client(peer):
    with Client(peer.target, retry=FAST, timeout_s=10, sample_timeout_s=10) as client:
        yield client


@pytest.fixture
def recipe():
    return Recipe(background="assets/street", library_snapshot=SNAPSHOT)


@pytest.fixture(scope="session")
def certificate(tmp_path_factory):
    """Paths of a key and a self-signed certificate for localhost."""
    folder = tmp_path_factory.mktemp("tls")
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=localhost"
    command += " -addext subjectAltName=DNS:localhost -keyout key.pem -out cert.pem"
    try:
        subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("openssl is not installed")
    return folder / "key.pem", folder / "cert.pem"
