"""What the server holds: assets, library snapshots, driving logs and jobs, as plain values.

Enum values are their names without the prefix, e.g. "BACKGROUND" for ASSET_KIND_BACKGROUND; a value that this
package does not know yet is its number, e.g. "17".
"""

from __future__ import annotations

import dataclasses
import datetime

from google.protobuf import timestamp_pb2

from backlot.v1 import assets_pb2, common_pb2, drive_logs_pb2, jobs_pb2


@dataclasses.dataclass(frozen=True)
class Quality:
    """Measured on held-out views; NaN where there was nothing to measure."""

    psnr_held_out: float
    ssim_held_out: float
    depth_mae_m: float
    train_views: int
    held_out_views: int
    warnings: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Asset:
    """A trained background or object. `size_m` is (length, width, height) of an object's cuboid."""

    name: str
    kind: str
    usage: str
    usage_reason: str
    object_class: str
    size_m: tuple[float, float, float]
    source_log: str
    source_track_id: str
    job: str
    payload_digest: str
    payload_bytes: int
    quality: Quality
    synthetic: bool
    create_time: datetime.datetime


@dataclasses.dataclass(frozen=True)
class LibrarySnapshot:
    """The library frozen under a digest."""

    name: str
    assets: tuple[str, ...]
    create_time: datetime.datetime


@dataclasses.dataclass(frozen=True)
class DriveLog:
    """Summary of an uploaded driving log; `travel_m` is the length of the ego path in metres."""

    name: str
    dataset: str
    synthetic: bool
    camera_count: int
    frame_count: int
    sweep_count: int
    track_count: int
    travel_m: float
    create_time: datetime.datetime


@dataclasses.dataclass(frozen=True)
class Job:
    """A training job. `fraction` is 0..1; `error` is empty unless `state` is "FAILED"."""

    name: str
    kind: str
    drive_log: str
    budget: str
    seed: int
    state: str
    fraction: float
    stage: str
    attempt: int
    error_reason: str
    error: str
    assets: tuple[str, ...]
    warnings: tuple[str, ...]
    create_time: datetime.datetime


def enum_name(enum, prefix: str, value: int) -> str:
    """The name of an enum's value without its prefix; the number if this package is older than the value."""
    try:
        return enum.Name(value).removeprefix(prefix)
    except ValueError:
        return str(value)


def object_class(value: int) -> str:
    """E.g. "CAR"."""
    return enum_name(common_pb2.ObjectClass, "OBJECT_CLASS_", value)


def asset_usage(value: int) -> str:
    """E.g. "LIBRARY"."""
    return enum_name(assets_pb2.AssetUsage, "ASSET_USAGE_", value)


def asset(proto: assets_pb2.Asset) -> Asset:
    quality = proto.quality
    return Asset(
        name=proto.name,
        kind=enum_name(assets_pb2.AssetKind, "ASSET_KIND_", proto.kind),
        usage=asset_usage(proto.usage),
        usage_reason=proto.usage_reason,
        object_class=object_class(proto.object_class),
        size_m=(proto.size_m.x, proto.size_m.y, proto.size_m.z),
        source_log=proto.source_log,
        source_track_id=proto.source_track_id,
        job=proto.job,
        payload_digest=proto.payload.digest,
        payload_bytes=proto.payload.size_bytes,
        quality=Quality(
            psnr_held_out=quality.psnr_held_out,
            ssim_held_out=quality.ssim_held_out,
            depth_mae_m=quality.depth_mae_m,
            train_views=quality.train_views,
            held_out_views=quality.held_out_views,
            warnings=tuple(quality.warnings),
        ),
        synthetic=proto.synthetic,
        create_time=_time(proto.create_time),
    )


def library_snapshot(proto: assets_pb2.LibrarySnapshot) -> LibrarySnapshot:
    return LibrarySnapshot(proto.name, tuple(proto.assets), _time(proto.create_time))


def drive_log(proto: drive_logs_pb2.DriveLogSummary) -> DriveLog:
    return DriveLog(
        name=proto.name,
        dataset=proto.dataset,
        synthetic=proto.synthetic,
        camera_count=proto.camera_count,
        frame_count=proto.frame_count,
        sweep_count=proto.sweep_count,
        track_count=proto.track_count,
        travel_m=proto.travel_m,
        create_time=_time(proto.create_time),
    )


def job(proto: jobs_pb2.Job) -> Job:
    return Job(
        name=proto.name,
        kind=enum_name(jobs_pb2.JobKind, "JOB_KIND_", proto.kind),
        drive_log=proto.drive_log,
        budget=enum_name(jobs_pb2.Budget, "BUDGET_", proto.budget),
        seed=proto.seed,
        state=enum_name(jobs_pb2.JobState, "JOB_STATE_", proto.state),
        fraction=proto.progress.fraction,
        stage=proto.progress.stage,
        attempt=proto.attempt,
        error_reason=proto.error.reason,
        error=proto.error.message,
        assets=tuple(proto.assets),
        warnings=tuple(proto.warnings),
        create_time=_time(proto.create_time),
    )


def _time(timestamp: timestamp_pb2.Timestamp) -> datetime.datetime:
    return timestamp.ToDatetime(tzinfo=datetime.timezone.utc)
