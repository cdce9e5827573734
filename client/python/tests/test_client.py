"""Calls other than streams: pages, retries, errors, TLS."""

import pickle
import time

import grpc
import pytest
from conftest import FAST
from peer import SNAPSHOT, Peer

from backlot import Client, NotFoundError, Retry, Tls, UnavailableError
from backlot.errors import ResourceExhaustedError
from backlot.transport import parse_target


def test_every_page_is_listed(client):
    assets = client.list_assets()
    assert [a.name for a in assets] == [f"assets/{i}" for i in range(5)]
    assert assets[0].kind == "OBJECT" and assets[0].object_class == "VAN"


def test_a_snapshot_is_created(client):
    assert client.create_snapshot().name == SNAPSHOT


def test_an_error_carries_the_servers_details(client):
    with pytest.raises(NotFoundError) as caught:
        client.get_asset("assets/none")
    error = caught.value
    assert error.code is grpc.StatusCode.NOT_FOUND
    assert (error.reason, error.metadata) == ("ASSET_UNKNOWN", {"asset": "assets/none"})
    assert error.field_violations == (("name", "unknown"),)
    assert "ASSET_UNKNOWN" in str(error) and "name: unknown" in str(error)


def test_a_call_is_repeated_while_the_server_is_away(client, peer):
    peer.assets.failures = FAST.max_attempts - 1
    assert len(client.list_assets()) == 5


def test_retries_end(client, peer):
    peer.assets.failures = FAST.max_attempts
    with pytest.raises(UnavailableError, match="away"):
        client.list_assets()


def test_no_server_is_unavailable_within_the_timeout():
    begin = time.monotonic()
    with Client("127.0.0.1:1", timeout_s=0.5) as client, pytest.raises(UnavailableError):
        client.list_assets()
    assert time.monotonic() - begin < 5


def test_metadata_is_sent_and_a_client_pickles_as_its_settings(peer):
    with Client(peer.target, metadata=[("authorization", "Bearer x")]) as client:
        client.list_assets()
        with pickle.loads(pickle.dumps(client)) as copy:
            peer.assets.metadata = {}
            copy.list_assets()
    assert peer.assets.metadata["authorization"] == "Bearer x"


def test_a_target_is_an_address_or_a_url():
    own = Tls(root_certificates=b"pem")
    assert parse_target("host:1", None) == parse_target("http://host:1", False) == ("host:1", None)
    assert parse_target("host:1", True) == parse_target("https://host:1/", None) == ("host:1", Tls())
    assert parse_target("https://host:1", own) == ("host:1", own)
    for target, tls in (("ftp://host", None), ("http://host:1", True)):
        with pytest.raises(ValueError):
            parse_target(target, tls)


def test_a_closed_client_opens_again(client):
    client.list_assets()
    client.close()
    assert len(client.list_assets()) == 5


def test_a_message_over_the_limit_is_refused(peer, recipe):
    peer.samples.padding_bytes = 70_000
    with Client(peer.target, max_message_bytes=60_000) as client, pytest.raises(ResourceExhaustedError):
        client.get_sample(recipe, seed=1, index=0)
    peer.samples.padding_bytes = 9 << 20
    with Client(peer.target) as client:
        assert client.get_sample(recipe, seed=1, index=0).index == 0


def test_waiting_grows_is_spread_and_obeys_the_server():
    retry = Retry(initial_s=0.1, multiplier=2, max_s=1)
    assert [round(retry.delay_s(n, 1.0), 3) for n in (1, 2, 3, 4, 5, 50)] == [0.1, 0.2, 0.4, 0.8, 1, 1]
    assert retry.delay_s(5, 0.0) == 0.5
    assert retry.delay_s(1, 1.0, server_s=3.0) == 3.0


def test_tls_verifies_the_server(certificate):
    key, chain = (path.read_bytes() for path in certificate)
    peer = Peer(grpc.ssl_server_credentials([(key, chain)]))
    with Client(peer.target, tls=Tls(root_certificates=chain, server_name="localhost")) as trusting:
        assert len(trusting.list_assets()) == 5
    with Client(peer.target, tls=True, timeout_s=1) as distrusting, pytest.raises(UnavailableError):
        distrusting.list_assets()
    peer.stop()
