"""Against a real server that holds a trained background: set BACKLOT_SERVER (address) and BACKLOT_BACKGROUND (asset name)."""

import dataclasses
import itertools
import os
import types

import numpy as np
import pytest
from cutting_proxy import CuttingProxy

from backlot import Client, Clip, InvalidArgumentError, NotFoundError, Recipe, RemoveActor, ShardedSamples
from backlot.transport import parse_target

SERVER, BACKGROUND = os.environ.get("BACKLOT_SERVER"), os.environ.get("BACKLOT_BACKGROUND")
SEED, COUNT = 7, 4

pytestmark = pytest.mark.skipif(
    not (SERVER and BACKGROUND),
    reason="BACKLOT_SERVER and BACKLOT_BACKGROUND are not set: no real server to test against",
)


@pytest.fixture(scope="module")
def client():
    with Client(SERVER) as client:
        yield client


@pytest.fixture(scope="module")
def recipe(client):
    return Recipe(background=BACKGROUND, longer_side_px=160).pinned(client.create_snapshot().name)


@pytest.fixture(scope="module")
def samples(client, recipe):
    return list(client.stream_samples(recipe, seed=SEED, count=COUNT))


def same_pixels(a, b):
    return all(
        np.array_equal(getattr(x, name), getattr(y, name))
        for x, y in zip(a.frames, b.frames, strict=True)
        for name in ("image", "depth_z_m", "instance", "ignore_mask")
    )


def test_the_background_its_log_and_its_job_are_listed(client):
    (background,) = (a for a in client.list_assets(kind="BACKGROUND") if a.name == BACKGROUND)
    assert client.get_asset(BACKGROUND) == background
    assert background.source_log in [log.name for log in client.list_drive_logs()]
    (job,) = (j for j in client.list_jobs(drive_log=background.source_log) if j.name == background.job)
    assert job.state == "SUCCEEDED" and BACKGROUND in job.assets


def test_a_snapshot_is_stable_and_names_the_background(client):
    first, second = client.create_snapshot(), client.create_snapshot()
    assert first.name == second.name and BACKGROUND in first.assets
    assert first.name in [snapshot.name for snapshot in client.list_snapshots()]


def test_labels_describe_the_pixels(samples):
    assert [sample.index for sample in samples] == list(range(COUNT))
    assert any(box.origin == "INSERTED" for sample in samples for box in sample.boxes_3d)
    for sample in samples:
        frame = sample.frame
        assert max(frame.image.shape) == 160 and frame.image.std() > 5
        ids = {box.instance_id for box in sample.boxes_3d}
        assert set(np.unique(frame.instance)) - {0} <= ids, "a visible object has no label"
        for box in frame.boxes_2d:
            check_visible_box(frame, box)


def check_visible_box(frame, box):
    rows, columns = np.nonzero(frame.instance == box.instance_id)
    if box.visible is None or len(rows) == 0:
        # Static originals are rendered as background: they have no instance pixels to compare with.
        return
    assert box.visible.tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert box.visible_pixels == len(rows)
    assert np.array_equal(box.mask(*frame.instance.shape), frame.instance == box.instance_id)
    np.testing.assert_allclose(frame.world_from_ego @ box.ego_from_cuboid, box.world_from_cuboid, atol=1e-6)
    depth = frame.depth_z_m[rows, columns]
    length = np.linalg.norm(box.in_camera[3:6])
    assert abs(np.median(depth[depth > 0]) - box.in_camera[2]) < length, "its pixels are not where its box is"


def test_boxes_are_projections_of_the_cuboids(samples):
    checked = 0
    for sample in samples:
        frame = sample.frame
        world = {box.instance_id: box for box in sample.boxes_3d}
        for box in frame.boxes_2d:
            cuboid = world[box.instance_id]
            np.testing.assert_allclose(
                frame.world_from_camera @ box.camera_from_cuboid, cuboid.world_from_cuboid, atol=1e-6
            )
            expected = projected_box(frame, box.camera_from_cuboid, cuboid.size_m)
            if expected is not None and box.amodal is not None:
                np.testing.assert_allclose(box.amodal, expected, atol=0.1)
                checked += 1
    assert checked > 0


def projected_box(frame, camera_from_cuboid, size_m):
    """Bounds of the projected corners clipped to the image; None if a corner is not well in front of the camera."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    corners = camera_from_cuboid @ np.column_stack([signs * size_m, np.ones(8)]).T
    if corners[2].min() < 1.0:
        return None
    u, v = (frame.intrinsics @ (corners[:3] / corners[2]))[:2]
    height, width = frame.instance.shape
    return np.clip([u.min(), v.min(), u.max(), v.max()], 0, [width, height, width, height])


def test_objects_of_a_clip_drive_at_their_velocity(client, recipe):
    clip = dataclasses.replace(recipe, clip=Clip(4, stride=2, min_speed_mps=2, max_speed_mps=4), longer_side_px=96)
    sample = client.get_sample(clip, seed=SEED, index=0)
    assert len(sample.frames) == 4
    moved = 0
    for before, after in itertools.pairwise(sample.frames):
        seconds = (after.timestamp_ns - before.timestamp_ns) * 1e-9
        assert seconds > 0
        later = {box.instance_id: box for box in after.boxes_2d}
        for box in before.boxes_2d:
            if box.instance_id in later and box.velocity_mps is not None:
                way = later[box.instance_id].world_from_cuboid[:3, 3] - box.world_from_cuboid[:3, 3]
                np.testing.assert_allclose(way, box.velocity_mps * seconds, atol=0.3)
                moved += np.linalg.norm(way) > 0.2
    assert moved > 0, "nothing moves"


def test_an_actor_is_removed_or_the_request_names_it(client, recipe, samples):
    originals = ("REPLAYED", "RECORDED")
    movers = [(s.index, box.track_id) for s in samples for box in s.boxes_3d if box.origin in originals]
    assert movers, "the street has movers"
    index, mover = movers[0]
    without = dataclasses.replace(recipe, edits=(RemoveActor(mover),))
    sample = client.get_sample(without, seed=SEED, index=index)
    assert mover not in [box.track_id for box in sample.boxes_3d]
    with pytest.raises(InvalidArgumentError, match="no track"):
        client.get_sample(dataclasses.replace(recipe, edits=(RemoveActor("nobody"),)), seed=SEED, index=index)


def test_samples_are_random_access_and_depend_on_the_seed(client, recipe, samples):
    assert same_pixels(client.get_sample(recipe, seed=SEED, index=2), samples[2])
    assert not same_pixels(client.get_sample(recipe, seed=SEED + 1, index=2), samples[2])


def test_a_cut_connection_does_not_change_the_samples(recipe, samples):
    address, _ = parse_target(SERVER, None)
    proxy = CuttingProxy(address, cuts=3, after_bytes=50_000)
    with Client(proxy.target) as client:
        through = list(client.stream_samples(recipe, seed=SEED, count=COUNT))
    proxy.close()
    assert proxy.made > 1, "the proxy cut nothing"
    assert [s.index for s in through] == list(range(COUNT))
    assert all(map(same_pixels, through, samples))


def test_workers_share_the_samples(client, recipe, samples):
    data = ShardedSamples(client, recipe, seed=SEED, count=COUNT, rank=0, world_size=1)
    got = {}
    for worker_id in range(3):
        for sample in data.iterate(types.SimpleNamespace(id=worker_id, num_workers=3)):
            assert sample.index not in got
            got[sample.index] = sample
    assert sorted(got) == list(range(COUNT))
    assert all(same_pixels(got[index], samples[index]) for index in got)


def test_a_closed_stream_leaves_the_server_free(client, recipe, samples):
    for _ in range(3):
        with client.stream_samples(recipe, seed=SEED, count=1000) as stream:
            next(stream)
    assert same_pixels(client.get_sample(recipe, seed=SEED, index=0), samples[0])


def test_wrong_requests_are_named(client, recipe):
    with pytest.raises(NotFoundError) as unknown:
        client.get_asset("assets/none-of-that-name")
    assert unknown.value.reason
    with pytest.raises((NotFoundError, InvalidArgumentError)):
        client.get_sample(
            Recipe(background="assets/none-of-that-name").pinned(recipe.library_snapshot), seed=1, index=0
        )
    with pytest.raises(InvalidArgumentError) as wrong:
        client.get_sample(
            Recipe(background=BACKGROUND, library_snapshot=recipe.library_snapshot, replace_probability=2.0),
            seed=1,
            index=0,
        )
    assert "replace_probability" in str(wrong.value)
