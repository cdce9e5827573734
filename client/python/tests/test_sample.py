"""Decoding: units, frames, types, and answers that must be refused."""

import dataclasses
import io
import math

import numpy as np
import peer
import pytest
from PIL import Image

from backlot import Clip, ContractError, FollowActor, GivenObject, Recipe, RemoveActor, ShiftActor, Waypoint
from backlot.sample import decode


def test_a_sample_has_typed_arrays_in_the_stated_units():
    sample = decode(peer.make_sample(5, seed=9))
    frame = sample.frame
    assert frame.image.dtype == np.uint8 and np.array_equal(frame.image, peer.image_of(5, 9))
    assert frame.depth_z_m.dtype == np.float32
    assert frame.depth_z_m[0, 0] == 0 and frame.depth_z_m[9, 11] == 9.5 and frame.depth_z_m[19, 31] == 40
    assert frame.instance.dtype == np.uint16 and (frame.instance == 300).sum() == 60
    assert frame.ignore_mask.dtype == bool and frame.ignore_mask.sum() == 3 * peer.HEIGHT
    assert frame.intrinsics.tolist() == [[30, 0, 16], [0, 31, 10], [0, 0, 1]]
    assert sample.boxes_3d[0].object_class == "CAR" and sample.boxes_3d[0].origin == "INSERTED"
    assert sample.rejections == {"collision": 2}
    assert sample.provenance.library_snapshot == peer.SNAPSHOT
    assert frame.image.flags.writeable


def test_boxes_in_world_and_camera_agree_with_the_geometry():
    sample = decode(peer.make_sample(0, seed=0))
    box, seen = sample.boxes_3d[0], sample.frame.boxes_2d[0]
    np.testing.assert_allclose(box.in_world, [11, 2, 3, 4, 2, 1.5, 0], atol=1e-12)
    # It drives away along camera z: KITTI's rotation_y is -pi/2.
    np.testing.assert_allclose(seen.in_camera, [0, 0, 10, 4, 2, 1.5, -math.pi / 2], atol=1e-12)
    # The camera pose leads from one to the other.
    np.testing.assert_allclose(
        sample.frame.world_from_camera @ seen.camera_from_cuboid, box.world_from_cuboid, atol=1e-12
    )
    assert seen.amodal.tolist() == [9.5, 8, 20, 14] and seen.visible is None


def test_a_view_has_its_pose_in_every_frame_its_mask_and_its_velocity():
    frame = decode(peer.make_sample(0, seed=0)).frame
    seen = frame.boxes_2d[0]
    np.testing.assert_allclose(frame.world_from_ego @ seen.ego_from_cuboid, seen.world_from_cuboid, atol=1e-12)
    assert seen.velocity_mps.tolist() == [5, 0, 0]
    mask = seen.mask(*frame.instance.shape)
    assert np.array_equal(mask, frame.instance == 300)
    assert not np.array_equal(seen.mask(*frame.instance.shape[::-1]).T, mask), "rows are not columns"


def test_what_an_older_server_does_not_say_is_derived_or_absent():
    proto = peer.make_sample(0, seed=0)
    for field in ("world_from_cuboid", "ego_from_cuboid", "velocity_mps", "mask_runs"):
        proto.frames[0].boxes_2d[0].ClearField(field)
    seen = decode(proto).frame.boxes_2d[0]
    assert seen.velocity_mps is None and not seen.mask(peer.HEIGHT, peer.WIDTH).any()
    assert seen.ego_from_cuboid[:3, 3].tolist() == [10, 0, 0]


def test_a_clip_has_frames_in_order_and_no_only_one():
    proto = peer.make_sample(0, seed=0)
    proto.frames.append(proto.frames[0])
    proto.frames[1].timestamp_ns = 100_000_000
    proto.frames[1].boxes_2d[0].world_from_cuboid.translation_m.x = 11.5
    sample = decode(proto)
    assert [f.timestamp_ns for f in sample.frames] == [0, 100_000_000]
    positions = [f.boxes_2d[0].world_from_cuboid[0, 3] for f in sample.frames]
    assert positions == [11, 11.5] and sample.boxes_3d[0].world_from_cuboid[0, 3] == 11
    with pytest.raises(ValueError):
        sample.frame  # noqa: B018


def test_the_camera_pose_of_a_box_is_derived_where_the_server_leaves_it_out():
    proto = peer.make_sample(0, seed=0)
    given = decode(proto).frame.boxes_2d[0].in_camera
    proto.frames[0].boxes_2d[0].ClearField("camera_from_cuboid")
    np.testing.assert_allclose(decode(proto).frame.boxes_2d[0].in_camera, given, atol=1e-12)


def test_omitted_images_are_none_and_no_ignore_image_ignores_nothing():
    proto = peer.make_sample(0, seed=0)
    for field in ("depth_png", "instance_png", "ignore_png"):
        proto.frames[0].ClearField(field)
    frame = decode(proto).frame
    assert frame.depth_z_m is None and frame.instance is None and not frame.ignore_mask.any()


def _smaller_image(proto):
    proto.frames[0].view.width += 1


def _cut_image(proto):
    proto.frames[0].image_png = proto.frames[0].image_png[:-40]


def _no_image(proto):
    proto.frames[0].ClearField("image_png")


def _grey_image(proto):
    out = io.BytesIO()
    Image.new("L", (peer.WIDTH, peer.HEIGHT)).save(out, "PNG")
    proto.frames[0].image_png = out.getvalue()


def _deep_instance(proto):
    proto.frames[0].instance_png = proto.frames[0].ignore_png


def _unknown_instance(proto):
    proto.frames[0].boxes_2d[0].instance_id = 7


def _short_mask(proto):
    proto.frames[0].boxes_2d[0].mask_runs[0] -= 1


def _no_rotation(proto):
    proto.boxes_3d[0].cuboid.world_from_cuboid.rotation.w = float("nan")


@pytest.mark.parametrize(
    "breakage",
    [_smaller_image, _cut_image, _no_image, _grey_image, _deep_instance, _unknown_instance, _short_mask, _no_rotation],
)
def test_a_sample_that_contradicts_itself_is_refused(breakage):
    proto = peer.make_sample(0, seed=0)
    breakage(proto)
    with pytest.raises(ContractError):
        decode(proto)


def test_a_recipe_carries_actors_and_clips():
    path = (Waypoint(0.0, 10.0, 2.0, 0.1), Waypoint(1.0, 18.0, 2.0, 0.1))
    recipe = Recipe(
        background="assets/a",
        edits=(RemoveActor("1"), ShiftActor("2", y_m=1.5), FollowActor("3", path)),
        given_objects=(GivenObject("assets/car", path[:1]),),
        clip=Clip(8, stride=2, max_speed_mps=9.0),
    )
    proto = recipe.to_proto()
    assert [edit.WhichOneof("edit") for edit in proto.edits] == ["remove", "shift", "follow"]
    assert proto.edits[1].shift.y_m == 1.5 and proto.edits[2].follow.waypoints[1].position_m.x == 18
    assert proto.given_objects[0].trajectory.waypoints[0].heading_rad == 0.1
    assert (proto.clip.frame_count, proto.clip.stride, proto.clip.max_speed_mps) == (8, 2, 9.0)
    assert not Recipe(background="assets/a").to_proto().HasField("clip")
    other = dataclasses.replace(recipe, edits=(RemoveActor("2"), *recipe.edits[1:]))
    assert recipe.fingerprint() != other.fingerprint()


def test_a_recipe_keeps_absent_and_zero_apart_and_refuses_unknown_names():
    absent = Recipe(background="assets/a").to_proto()
    zero = Recipe(background="assets/a", jitter_x_m=0.0, preset="PAPER", classes=("CAR", "VAN")).to_proto()
    assert not absent.HasField("jitter_x_m") and zero.HasField("jitter_x_m")
    assert (zero.preset, list(zero.classes)) == (2, [1, 2])
    with pytest.raises(ValueError, match="UNHEARD"):
        Recipe(background="assets/a", preset="UNHEARD").to_proto()
    with pytest.raises(ValueError, match="BIKE"):
        Recipe(background="assets/a", classes=("BIKE",)).to_proto()
