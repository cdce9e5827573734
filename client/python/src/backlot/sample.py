"""A training sample: images and boxes as numpy arrays, decoded and checked."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
from PIL import Image

from backlot import geometry
from backlot.errors import ContractError
from backlot.resources import asset_usage, enum_name, object_class
from backlot.v1 import common_pb2, samples_pb2


@dataclasses.dataclass(frozen=True)
class Box3D:
    """One object of a sample, in the log's world frame (z up, metres), where the first frame that holds it shows it.

    Attributes:
        instance_id: 1.. within the sample; the value in `Frame.instance`.
        origin: "INSERTED", "REPLACED", "MOVED" (an original mover elsewhere), "REPLAYED" or "RECORDED" (one where it was) or "STATIC" (part
            of the background).
        object_class: e.g. "CAR".
        world_from_cuboid: 4 x 4 float64; the cuboid's origin is its centre.
        size_m: float64 (length, width, height).
        asset: the asset rendered; empty for STATIC and RECORDED.
        track_id: the log's track of an original, or the one whose place was taken; empty for INSERTED.
        source_log, source_track_id: what the asset was trained from.
        beyond_coverage: the pose lies outside the asset's observed views.
    """

    instance_id: int
    origin: str
    object_class: str
    world_from_cuboid: np.ndarray
    size_m: np.ndarray
    asset: str
    track_id: str
    source_log: str
    source_track_id: str
    beyond_coverage: bool

    @property
    def in_world(self) -> np.ndarray:
        """float64 (x, y, z, length, width, height, yaw): centre in metres, yaw in radians from x towards y."""
        return geometry.box_in_world(self.world_from_cuboid, self.size_m)


@dataclasses.dataclass(frozen=True)
class Box2D:
    """One object as one frame sees it. Boxes are float64 (x_min, y_min, x_max, y_max) in continuous pixels.

    Attributes:
        instance_id: of `Sample.boxes_3d`.
        amodal: projection of the whole cuboid clipped to the image; None if wholly outside.
        visible: bounds of the visible pixels; None without one.
        visible_pixels: their count.
        visible_fraction: 0..1 of the pixels that it would have alone.
        truncation: 0..1 of the amodal box that lies outside the image.
        occluder_instance_id: what hides most of it; 0 if nothing or the background.
        camera_from_cuboid: 4 x 4 float64.
        in_camera: float64 (x, y, z, length, width, height, rotation_y), see `geometry.box_in_camera`.
        lidar_points: simulated returns of a 64-beam scanner at the ego origin.
        ego_from_cuboid, world_from_cuboid: 4 x 4 float64, at this frame.
        velocity_mps: float64 (x, y, z) in the world frame; None where the log does not tell.
        mask_runs: uint32 lengths of alternating runs outside and inside the mask, column by column, as in COCO; see `mask`.
    """

    instance_id: int
    amodal: np.ndarray | None
    visible: np.ndarray | None
    visible_pixels: int
    visible_fraction: float
    truncation: float
    occluder_instance_id: int
    camera_from_cuboid: np.ndarray
    in_camera: np.ndarray
    lidar_points: int
    ego_from_cuboid: np.ndarray
    world_from_cuboid: np.ndarray
    velocity_mps: np.ndarray | None
    mask_runs: np.ndarray

    def mask(self, height: int, width: int) -> np.ndarray:
        """H x W bool, True where the image shows this object; ValueError for a frame of another size."""
        if len(self.mask_runs) == 0:
            return np.zeros((height, width), bool)
        inside = np.arange(len(self.mask_runs)) % 2 == 1
        return np.repeat(inside, self.mask_runs).reshape(width, height).T


@dataclasses.dataclass(frozen=True)
class Frame:
    """One camera at one instant.

    Attributes:
        camera_id: as in the log.
        timestamp_ns: of the log's clock.
        frame_index: recorded frame whose pose was used.
        image: H x W x 3 uint8, sRGB.
        depth_z_m: H x W float32 camera-z depth in metres, 0 where there is no surface; None if omitted.
        instance: H x W uint16, 0 for background, otherwise `Box3D.instance_id`; None if omitted.
        ignore_mask: H x W bool, True where pixels carry nothing to train on.
        boxes_2d: one for each object of which this frame shows a pixel.
        intrinsics: 3 x 3 float64 in pixels; the centre of the top left pixel is (0.5, 0.5).
        world_from_camera, world_from_ego: 4 x 4 float64.
    """

    camera_id: str
    timestamp_ns: int
    frame_index: int
    image: np.ndarray
    depth_z_m: np.ndarray | None
    instance: np.ndarray | None
    ignore_mask: np.ndarray
    boxes_2d: tuple[Box2D, ...]
    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    world_from_ego: np.ndarray


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Where a sample comes from. `render_class` names build, backend and instruction set: pixels are equal within one.

    `sun_direction_world` is None without a sun; `sun_source` says where it comes from: "RECIPE", "LOG" or "ESTIMATED".
    """

    library_snapshot: str
    background: str
    seed: int
    render_class: str
    insert_shadows: bool
    synthetic: bool
    objects: tuple[str, ...]
    weakest_usage: str
    sun_direction_world: np.ndarray | None = None
    sun_source: str = "UNSPECIFIED"


@dataclasses.dataclass(frozen=True)
class Sample:
    """Sample `index` of a recipe and seed. `rejections` counts placements that were refused, by reason."""

    index: int
    frames: tuple[Frame, ...]
    boxes_3d: tuple[Box3D, ...]
    provenance: Provenance
    rejections: dict[str, int]

    @property
    def frame(self) -> Frame:
        """The only frame; ValueError if the sample is a clip."""
        (only,) = self.frames
        return only


def decode(proto: samples_pb2.Sample) -> Sample:
    """Decodes a sample; ContractError if its images or boxes contradict each other."""
    boxes = tuple(_box_3d(box) for box in proto.boxes_3d)
    by_id = {box.instance_id: box for box in boxes}
    provenance = proto.provenance
    return Sample(
        index=proto.index,
        frames=tuple(_frame(frame, by_id) for frame in proto.frames),
        boxes_3d=boxes,
        provenance=Provenance(
            library_snapshot=provenance.library_snapshot,
            background=provenance.background,
            seed=provenance.seed,
            render_class=provenance.render_class,
            insert_shadows=provenance.insert_shadows,
            synthetic=provenance.synthetic,
            objects=tuple(provenance.objects),
            weakest_usage=asset_usage(provenance.weakest_usage),
            sun_direction_world=_sun_direction(provenance),
            sun_source=enum_name(samples_pb2.SunSource, "SUN_SOURCE_", provenance.sun_source),
        ),
        rejections=dict(proto.rejections),
    )


def _sun_direction(provenance: samples_pb2.SampleProvenance) -> np.ndarray | None:
    if not provenance.HasField("sun_direction_world"):
        return None
    sun = provenance.sun_direction_world
    return np.array([sun.x, sun.y, sun.z])


def _box_3d(proto: samples_pb2.SampleBox) -> Box3D:
    size = proto.cuboid.size_m
    return Box3D(
        instance_id=proto.instance_id,
        origin=enum_name(samples_pb2.BoxOrigin, "BOX_ORIGIN_", proto.origin),
        object_class=object_class(proto.object_class),
        world_from_cuboid=geometry.matrix(proto.cuboid.world_from_cuboid),
        size_m=np.array([size.x, size.y, size.z]),
        asset=proto.asset,
        track_id=proto.track_id,
        source_log=proto.source_log,
        source_track_id=proto.source_track_id,
        beyond_coverage=proto.beyond_coverage,
    )


def _frame(proto: samples_pb2.SampleFrame, boxes: dict[int, Box3D]) -> Frame:
    view = proto.view
    shape = (view.height, view.width)
    depth = _image(proto.depth_png, shape, np.uint16) if proto.depth_png else None
    ignore = _image(proto.ignore_png, shape, np.uint8) > 127 if proto.ignore_png else np.zeros(shape, bool)
    world_from_camera = geometry.matrix(view.world_from_camera)
    world_from_ego = geometry.matrix(proto.world_from_ego)
    return Frame(
        camera_id=proto.camera_id,
        timestamp_ns=proto.timestamp_ns,
        frame_index=proto.frame_index,
        image=_image(proto.image_png, (*shape, 3), np.uint8),
        depth_z_m=None if depth is None else depth * np.float32(proto.depth_unit_m),
        instance=_image(proto.instance_png, shape, np.uint16) if proto.instance_png else None,
        ignore_mask=ignore,
        boxes_2d=tuple(_box_2d(box, boxes, world_from_camera, world_from_ego, shape) for box in proto.boxes_2d),
        intrinsics=np.array(
            [
                [view.focal_x_px, 0, view.principal_x_px],
                [0, view.focal_y_px, view.principal_y_px],
                [0, 0, 1],
            ]
        ),
        world_from_camera=world_from_camera,
        world_from_ego=world_from_ego,
    )


def _box_2d(
    proto: samples_pb2.SampleBox2D,
    boxes: dict[int, Box3D],
    world_from_camera: np.ndarray,
    world_from_ego: np.ndarray,
    shape: tuple[int, int],
) -> Box2D:
    box = boxes.get(proto.instance_id)
    if box is None:
        raise ContractError(f"a 2D box names instance {proto.instance_id}, which has no 3D box")
    world_from_cuboid = box.world_from_cuboid
    if proto.HasField("world_from_cuboid"):
        world_from_cuboid = geometry.matrix(proto.world_from_cuboid)
    camera_from_cuboid = geometry.inverse(world_from_camera) @ world_from_cuboid
    if proto.HasField("camera_from_cuboid"):
        camera_from_cuboid = geometry.matrix(proto.camera_from_cuboid)
    ego_from_cuboid = geometry.inverse(world_from_ego) @ world_from_cuboid
    if proto.HasField("ego_from_cuboid"):
        ego_from_cuboid = geometry.matrix(proto.ego_from_cuboid)
    runs = np.array(proto.mask_runs, np.uint32)
    if len(runs) and runs.sum() != shape[0] * shape[1]:
        raise ContractError(f"the mask of instance {proto.instance_id} has {runs.sum()} pixels, not those of {shape}")
    velocity = proto.velocity_mps
    return Box2D(
        instance_id=proto.instance_id,
        amodal=_corners(proto.amodal) if proto.HasField("amodal") else None,
        visible=_corners(proto.visible) if proto.HasField("visible") else None,
        visible_pixels=proto.visible_pixels,
        visible_fraction=proto.visible_fraction,
        truncation=proto.truncation,
        occluder_instance_id=proto.occluder_instance_id,
        camera_from_cuboid=camera_from_cuboid,
        in_camera=geometry.box_in_camera(camera_from_cuboid, box.size_m),
        lidar_points=proto.lidar_points,
        ego_from_cuboid=ego_from_cuboid,
        world_from_cuboid=world_from_cuboid,
        velocity_mps=np.array([velocity.x, velocity.y, velocity.z]) if proto.HasField("velocity_mps") else None,
        mask_runs=runs,
    )


def _corners(box: common_pb2.Box2D) -> np.ndarray:
    return np.array([box.x_min, box.y_min, box.x_max, box.y_max])


def _image(png: bytes, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            pixels = np.array(image)
    except (OSError, ValueError) as error:
        raise ContractError(f"an image of the sample cannot be decoded: {error}") from error
    # Older Pillow opens 16-bit grey as 32-bit integers.
    if dtype is np.uint16 and pixels.dtype == np.int32:
        pixels = pixels.astype(np.uint16)
    if pixels.shape != shape or pixels.dtype != dtype:
        raise ContractError(f"an image is {pixels.shape} {pixels.dtype}, not {shape} {np.dtype(dtype)}")
    return pixels
