"""Tables read by nuscenes-devkit."""

import json

import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import BoxVisibility, view_points
from sets import NAMES, SETS, copied, corners, farthest, truths

VERSION = "v1.0-backlot"
CATEGORIES = {"Car": "vehicle.car", "Van": "vehicle.car", "Truck": "vehicle.truck", "Bus": "vehicle.bus.rigid",
              "Tram": "vehicle.tram", "Pedestrian": "human.pedestrian.adult", "Cyclist": "vehicle.bicycle",
              "Misc": "movable_object.other"}  # fmt: skip


def by_image(folder):
    return {truth.image: truth for truth in truths(folder)}


def frames_of(nusc):
    """(key frame, camera record) of every key frame, scene by scene, following `next`."""
    for scene in nusc.scene:
        token, count = scene["first_sample_token"], 0
        while token:
            sample = nusc.get("sample", token)
            (camera,) = sample["data"].values()
            yield sample, nusc.get("sample_data", camera)
            last, token, count = token, sample["next"], count + 1
        assert last == scene["last_sample_token"] and count == scene["nbr_samples"]


def faults(folder):
    """Where the devkit sees something else than the truth."""
    nusc = NuScenes(VERSION, str(folder), verbose=False)
    known, found, seen = by_image(folder), [], set()
    for sample, camera in frames_of(nusc):
        truth = known[camera["filename"]]
        seen.add(camera["filename"])
        path, boxes, intrinsics = nusc.get_sample_data(camera["token"], box_vis_level=BoxVisibility.NONE)
        if not path.endswith(truth.image) or len(boxes) != len(truth.shown):
            found.append(f"{truth.image}: {len(boxes)} boxes of {len(truth.shown)}")
        for box in boxes:
            annotation = nusc.get("sample_annotation", box.token)
            # Which object it is, only the corners say.
            own = min(truth.shown.values(), key=lambda s: farthest(box.corners().T, corners(s.camera, s.size)))
            found += box_faults(nusc, truth, sample, box, annotation, own, intrinsics)
    if seen != set(known):
        found.append("other images")
    return found


def box_faults(nusc, truth, sample, box, annotation, own, intrinsics):
    where, found = f"{truth.image}: {own.id}", []
    if farthest(box.corners().T, corners(own.camera, own.size)) > 1e-4:
        found.append(f"{where}: cuboid in the camera")
    if np.abs(np.array(annotation["size"]) - own.size[[1, 0, 2]]).max() > 1e-9:
        found.append(f"{where}: size")
    # The devkit's x axis is forward as well.
    if np.abs(box.orientation.rotation_matrix[:, 0] - own.camera[:3, 0]).max() > 1e-6:
        found.append(f"{where}: heading")
    if box.name != CATEGORIES[own.name]:
        found.append(f"{where} is {box.name}")
    if annotation["num_lidar_pts"] != own.record["lidar_points"] or annotation["sample_token"] != sample["token"]:
        found.append(f"{where}: points")
    levels = {"1": (0, 0.4), "2": (0.4, 0.6), "3": (0.6, 0.8), "4": (0.8, 1.01)}
    low, high = levels[annotation["visibility_token"]]
    if not low <= own.record["visible_fraction"] < high:
        found.append(f"{where}: visibility")
    points = corners(own.camera, own.size).T
    if points[2].min() > 1 and own.record["truncation"] == 0:
        u, v = view_points(box.corners(), intrinsics, normalize=True)[:2] + 0.5
        amodal = own.record["box_amodal"]
        if np.abs(np.array([u.min(), v.min(), u.max(), v.max()]) - amodal).max() > 0.1:
            found.append(f"{where}: intrinsics")
    if annotation["prev"] and annotation["next"] and own.velocity is not None:
        if np.abs(nusc.box_velocity(annotation["token"]) - own.velocity).max() > 0.5:
            found.append(f"{where}: velocity")
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_devkit_sees_the_objects(name):
    assert faults(SETS / name) == []


def test_instances_run_through_clips():
    nusc = NuScenes(VERSION, str(SETS / "clips"), verbose=False)
    longest = 0
    for instance in nusc.instance:
        token, times = instance["first_annotation_token"], []
        while token:
            annotation = nusc.get("sample_annotation", token)
            assert annotation["instance_token"] == instance["token"]
            times.append(nusc.get("sample", annotation["sample_token"])["timestamp"])
            last, token = token, annotation["next"]
        assert last == instance["last_annotation_token"] and len(times) == instance["nbr_annotations"]
        assert times == sorted(set(times))
        longest = max(longest, len(times))
    assert longest == 5


def _shift(rows):
    rows[0]["translation"][0] += 0.2


def _swap_sizes(rows):
    row = next(r for r in rows if r["size"][0] != r["size"][1])
    row["size"][0], row["size"][1] = row["size"][1], row["size"][0]


def _turn_round(rows):
    w, x, y, z = rows[0]["rotation"]
    rows[0]["rotation"] = [-z, y, -x, w]


def _lose(rows):
    del rows[0]


@pytest.mark.parametrize("breakage", [_shift, _swap_sizes, _turn_round, _lose])
def test_broken_tables_are_refused(breakage, tmp_path):
    folder = copied("images", tmp_path / "set")
    table = folder / VERSION / "sample_annotation.json"
    rows = json.loads(table.read_text())
    breakage(rows)
    table.write_text(json.dumps(rows))
    try:
        found = faults(folder)
    except KeyError:
        assert breakage is _lose
        return
    assert found != []
