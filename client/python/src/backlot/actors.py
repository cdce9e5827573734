"""Clips, and what a recipe does with single objects: original movers removed, moved or sent elsewhere, and objects at given places."""

from __future__ import annotations

import dataclasses

from backlot.v1 import common_pb2, samples_pb2


@dataclasses.dataclass(frozen=True)
class Clip:
    """Samples of several frames of one camera.

    Attributes:
        frame_count: frames a sample, at most 40.
        stride: recorded frames from one frame of the clip to the next.
        min_speed_mps, max_speed_mps: inserted objects drive along their heading at a speed drawn from this range.
    """

    frame_count: int
    stride: int = 1
    min_speed_mps: float = 0.0
    max_speed_mps: float = 0.0

    def to_proto(self) -> samples_pb2.Clip:
        return samples_pb2.Clip(**dataclasses.asdict(self))


@dataclasses.dataclass(frozen=True)
class Waypoint:
    """Where an object is `time_s` after the sample's first frame, in the log's world frame. It stands on the ground."""

    time_s: float
    x_m: float
    y_m: float
    heading_rad: float


@dataclasses.dataclass(frozen=True)
class RemoveActor:
    """Leaves an original mover out."""

    track_id: str

    def to_proto(self) -> samples_pb2.ActorEdit:
        return samples_pb2.ActorEdit(track_id=self.track_id, remove=samples_pb2.RemoveActor())


@dataclasses.dataclass(frozen=True)
class ShiftActor:
    """Shows an original mover beside its recorded path: `x_m` forward and `y_m` left in its own frame, turned by `heading_rad`."""

    track_id: str
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    def to_proto(self) -> samples_pb2.ActorEdit:
        shift = samples_pb2.ShiftActor(x_m=self.x_m, y_m=self.y_m, heading_rad=self.heading_rad)
        return samples_pb2.ActorEdit(track_id=self.track_id, shift=shift)


@dataclasses.dataclass(frozen=True)
class FollowActor:
    """Shows an original mover on another path."""

    track_id: str
    waypoints: tuple[Waypoint, ...]

    def to_proto(self) -> samples_pb2.ActorEdit:
        return samples_pb2.ActorEdit(track_id=self.track_id, follow=_trajectory(self.waypoints))


@dataclasses.dataclass(frozen=True)
class GivenObject:
    """An asset that stands or drives where `waypoints` say; one waypoint stands still."""

    asset: str
    waypoints: tuple[Waypoint, ...]

    def to_proto(self) -> samples_pb2.GivenObject:
        return samples_pb2.GivenObject(asset=self.asset, trajectory=_trajectory(self.waypoints))


ActorEdit = RemoveActor | ShiftActor | FollowActor


def _trajectory(waypoints: tuple[Waypoint, ...]) -> samples_pb2.Trajectory:
    points = [
        samples_pb2.Waypoint(
            time_s=w.time_s, position_m=common_pb2.Vector3(x=w.x_m, y=w.y_m), heading_rad=w.heading_rad
        )
        for w in waypoints
    ]
    return samples_pb2.Trajectory(waypoints=points)
