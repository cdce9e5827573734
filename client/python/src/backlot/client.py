"""The client: what the server holds, and samples made from it."""

from __future__ import annotations

from collections.abc import Sequence

from backlot import resources
from backlot.recipe import Recipe
from backlot.resources import Asset, DriveLog, Job, LibrarySnapshot
from backlot.sample import Sample
from backlot.stream import SampleStream
from backlot.transport import Connection, Retry, Tls, Transport, parse_target
from backlot.v1 import (
    assets_pb2,
    assets_pb2_grpc,
    drive_logs_pb2,
    drive_logs_pb2_grpc,
    jobs_pb2,
    jobs_pb2_grpc,
)


class Client:
    """A connection to a Backlot server.

    Opens its channel when it is first used, one in each process, so that it may be made before a fork and passed to DataLoader
    workers; it pickles as its settings. Errors are subclasses of `BacklotError`.

    Args:
        target: "host:port", or a URL like "http://host:port" or "https://host:port".
        tls: certificates, or True for the system's roots; None or False connects in the clear.
        timeout_s: longest time for one call other than a stream, retries included.
        sample_timeout_s: longest time to wait for one sample of a stream, retries included.
        retry: when to ask again while the server is unavailable.
        max_message_bytes: limit of one message, so of one sample.
        metadata: sent with every call, e.g. (("authorization", "Bearer ..."),).
    """

    def __init__(
        self,
        target: str,
        *,
        tls: Tls | bool | None = None,
        timeout_s: float = 30.0,
        sample_timeout_s: float = 300.0,
        retry: Retry = Retry(),
        max_message_bytes: int = 64 * 1024 * 1024,
        metadata: Sequence[tuple[str, str]] = (),
    ):
        address, certificates = parse_target(target, tls)
        self._transport = Transport(
            Connection(address, certificates, timeout_s, sample_timeout_s, retry, max_message_bytes, tuple(metadata))
        )

    def list_assets(self, *, kind: str = "UNSPECIFIED", source_log: str = "") -> list[Asset]:
        """Every asset; `kind` is "BACKGROUND" or "OBJECT", `source_log` is `driveLogs/{id}`."""
        request = assets_pb2.ListAssetsRequest(
            kind=assets_pb2.AssetKind.Value(f"ASSET_KIND_{kind}"), source_log=source_log
        )
        return [
            resources.asset(a) for a in self._pages(assets_pb2_grpc.AssetServiceStub, "ListAssets", request, "assets")
        ]

    def get_asset(self, name: str) -> Asset:
        """One asset by its name `assets/{id}`."""
        request = assets_pb2.GetAssetRequest(name=name)
        return resources.asset(self._transport.unary(assets_pb2_grpc.AssetServiceStub, "GetAsset", request).asset)

    def list_drive_logs(self) -> list[DriveLog]:
        """Every driving log."""
        pages = self._pages(
            drive_logs_pb2_grpc.DriveLogServiceStub,
            "ListDriveLogs",
            drive_logs_pb2.ListDriveLogsRequest(),
            "drive_logs",
        )
        return [resources.drive_log(log) for log in pages]

    def list_jobs(self, *, drive_log: str = "") -> list[Job]:
        """Every job, or those of one `driveLogs/{id}`."""
        request = jobs_pb2.ListJobsRequest(drive_log=drive_log)
        return [resources.job(j) for j in self._pages(jobs_pb2_grpc.JobServiceStub, "ListJobs", request, "jobs")]

    def create_snapshot(self) -> LibrarySnapshot:
        """Freezes the library as it is now. The same library gives the same snapshot."""
        response = self._transport.unary(
            assets_pb2_grpc.AssetServiceStub, "CreateLibrarySnapshot", assets_pb2.CreateLibrarySnapshotRequest()
        )
        return resources.library_snapshot(response.library_snapshot)

    def list_snapshots(self) -> list[LibrarySnapshot]:
        """Every library snapshot."""
        request = assets_pb2.ListLibrarySnapshotsRequest()
        pages = self._pages(assets_pb2_grpc.AssetServiceStub, "ListLibrarySnapshots", request, "library_snapshots")
        return [resources.library_snapshot(snapshot) for snapshot in pages]

    def stream_samples(
        self, recipe: Recipe, *, seed: int, start: int = 0, count: int, prefetch: int = 4
    ) -> SampleStream:
        """Samples [start, start + count) in order. At most `prefetch` are read ahead.

        To resume, ask for the index after the last one used: sample i is the same whatever the start. A recipe without a
        snapshot is pinned to the library as it is now.
        """
        if start < 0 or count < 0:
            raise ValueError(f"start and count must not be negative: {start}, {count}")
        if not recipe.library_snapshot:
            recipe = recipe.pinned(self.create_snapshot().name)
        return self.stream_ranges(recipe, seed=seed, ranges=[(start, count)], prefetch=prefetch)

    def stream_ranges(
        self, recipe: Recipe, *, seed: int, ranges: Sequence[tuple[int, int]], prefetch: int = 4
    ) -> SampleStream:
        """As `stream_samples`, over several (start, count) ranges one after the other. The recipe must name its snapshot."""
        if not recipe.library_snapshot:
            raise ValueError("the recipe names no library snapshot: use recipe.pinned(client.create_snapshot().name)")
        return SampleStream(self._transport, recipe, seed, ranges, prefetch)

    def get_sample(self, recipe: Recipe, *, seed: int, index: int) -> Sample:
        """Sample `index` alone."""
        with self.stream_samples(recipe, seed=seed, start=index, count=1, prefetch=1) as stream:
            return next(stream)

    def close(self) -> None:
        """Closes the channel of this process; a later call opens another."""
        self._transport.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def __getstate__(self) -> Connection:
        return self._transport.connection

    def __setstate__(self, connection: Connection) -> None:
        self._transport = Transport(connection)

    def _pages(self, stub_class: type, method: str, request, field: str):
        while True:
            response = self._transport.unary(stub_class, method, request)
            yield from getattr(response, field)
            if not response.next_page_token:
                return
            request.page_token = response.next_page_token
