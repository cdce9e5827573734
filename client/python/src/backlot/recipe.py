"""What to make: the recipe of a sequence of samples."""

from __future__ import annotations

import dataclasses
import hashlib
import json

from backlot.actors import ActorEdit, Clip, GivenObject
from backlot.v1 import common_pb2, samples_pb2


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Determines, with a seed, an endless sequence of samples that is addressed by index.

    Attributes:
        background: `assets/{id}` of a background.
        library_snapshot: `librarySnapshots/{digest}` to draw objects from; empty means the library when the stream is opened.
        preset: "DEFAULT", "PAPER" (the paper's jitter; poses beyond the observed views are flagged), "PAPER_NO_RT" (no jitter),
            "BALANCED_HEADING", "FAR", "DENSE", or a corner case: "OCCLUDED", "STRANGE_HEADING", "ON_SLOPE", "CUT_IN", "DENSE_QUEUE".
        min_objects, max_objects: objects inserted a sample; None means the preset's, 0 and 0 insert nothing.
        objects: assets to draw from; empty means every library object.
        classes: classes to draw from, e.g. ("CAR", "VAN"); empty means all.
        jitter_x_m, jitter_y_m: maxima in metres, forward and left in the recorded ego frame; None means the preset's.
        jitter_heading_rad: maximum in radians about the ground's normal; None means the preset's.
        replace_probability: 0..1, that an original object that can be replaced is.
        drop_originals: leaves recorded movers out; what was never seen under them is in `Frame.ignore_mask`.
        insert_shadows: casts shadows of inserted and replacing objects.
        keep_tones: leaves objects of other logs in their own light instead of matching them to the frame.
        keep_light: leaves inserted objects in the sunlight they were recorded in instead of that of their place.
        sun_direction_world: (x, y, z) towards the sun; None means the log's own, or as estimated from the background's shadows.
        longer_side_px: output size; 0 means as recorded.
        coverage_slack_rad: radians beyond the observed views; None means the server's default.
        camera_id: camera to render; empty means the background's first.
        omit_depth, omit_instance: leaves the image out of the reply.
        frame_indices: recorded frames whose ego pose may be used, of clips as their first; empty means all.
        edits: what becomes of original movers; one that cannot go where it is sent stays and is counted as "given_refused".
        given_objects: objects at given places, besides those that are drawn; one that cannot stand there is left out and counted likewise.
        clip: several frames a sample; None means one.
        heading_histogram: shares of equal bins of camera-relative heading from -pi to pi; empty leaves it to the preset. 0 drives
            straight away from the camera, pi / 2 shows the object's left side.
        distance_histogram: shares of equal bins from min_distance_m to max_distance_m; empty is even.
        min_distance_m, max_distance_m: from the camera to the objects' centres; None means the preset's.
        class_shares: (class, weight) pairs, e.g. (("CAR", 3.0), ("PEDESTRIAN", 1.0)); empty draws as there are assets.
        source_logs: `driveLogs/{id}` whose objects may be drawn; empty means all.
        other_logs_only: draws no object of the background's own log.
        min_clear_fraction, max_clear_fraction: least fraction of clear sight lines to an object; largest that the environment leaves.
        min_slope: least slope of the ground under an object, metres per metre.
        min_height_px: least height of an object's projection.
    """

    background: str
    library_snapshot: str = ""
    preset: str = "DEFAULT"
    min_objects: int | None = None
    max_objects: int | None = None
    objects: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()
    jitter_x_m: float | None = None
    jitter_y_m: float | None = None
    jitter_heading_rad: float | None = None
    replace_probability: float = 0.0
    drop_originals: bool = False
    insert_shadows: bool = True
    keep_tones: bool = False
    keep_light: bool = False
    sun_direction_world: tuple[float, float, float] | None = None
    longer_side_px: int = 0
    coverage_slack_rad: float | None = None
    camera_id: str = ""
    omit_depth: bool = False
    omit_instance: bool = False
    frame_indices: tuple[int, ...] = ()
    edits: tuple[ActorEdit, ...] = ()
    given_objects: tuple[GivenObject, ...] = ()
    clip: Clip | None = None
    heading_histogram: tuple[float, ...] = ()
    distance_histogram: tuple[float, ...] = ()
    min_distance_m: float | None = None
    max_distance_m: float | None = None
    class_shares: tuple[tuple[str, float], ...] = ()
    source_logs: tuple[str, ...] = ()
    other_logs_only: bool = False
    min_clear_fraction: float | None = None
    max_clear_fraction: float | None = None
    min_slope: float | None = None
    min_height_px: float | None = None

    def pinned(self, library_snapshot: str) -> Recipe:
        """The same recipe over a fixed snapshot, so that a growing library does not change its samples."""
        return dataclasses.replace(self, library_snapshot=library_snapshot)

    def to_proto(self) -> samples_pb2.Recipe:
        """The wire form; ValueError names an unknown preset or class."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        fields["edits"] = [edit.to_proto() for edit in self.edits]
        fields["given_objects"] = [given.to_proto() for given in self.given_objects]
        fields["clip"] = None if self.clip is None else self.clip.to_proto()
        fields["preset"] = samples_pb2.PlacementPreset.Value(f"PLACEMENT_PRESET_{self.preset}")
        fields["classes"] = [_class(name) for name in self.classes]
        fields["class_shares"] = [
            samples_pb2.ClassShare(object_class=_class(name), weight=weight) for name, weight in self.class_shares
        ]
        for name in ("heading_histogram", "distance_histogram"):
            weights = fields.pop(name)
            if weights:
                fields[name] = samples_pb2.Histogram(weights=weights)
        if self.sun_direction_world is not None:
            x, y, z = self.sun_direction_world
            fields["sun_direction_world"] = common_pb2.Vector3(x=x, y=y, z=z)
        return samples_pb2.Recipe(**fields)

    def fingerprint(self) -> str:
        """32 hexadecimal digits that change with any field."""
        canonical = json.dumps(dataclasses.asdict(self), sort_keys=True)
        return hashlib.blake2b(canonical.encode(), digest_size=16).hexdigest()


def _class(name: str) -> int:
    return common_pb2.ObjectClass.Value(f"OBJECT_CLASS_{name}")
