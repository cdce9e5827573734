"""The sets under test: what was written in each format, and the truth from label_json and the instance images."""

import json
import os
import pathlib
import shutil

import numpy as np
from PIL import Image

SETS = pathlib.Path(os.environ["BACKLOT_SETS"])
NAMES = ("images", "removed", "clips")


class Shown:
    """An object in a frame."""

    def __init__(self, record, instance):
        self.record = record
        self.id = record["instance_id"]
        self.name = record["class"]
        self.size = np.array(record["size_m"])
        self.camera = pose(record["camera_from_cuboid"])
        self.ego = pose(record["ego_from_cuboid"])
        self.world = pose(record["world_from_cuboid"])
        self.velocity = None if record["velocity_mps"] is None else np.array(record["velocity_mps"])
        self.mask = instance == self.id


class Truth:
    """A frame and its objects."""

    def __init__(self, folder, entry):
        self.image = entry["files"]["image"]
        self.record = json.loads((folder / entry["files"]["label_json"]).read_text())
        self.stem = pathlib.Path(entry["files"]["label_json"]).stem
        self.instance = np.array(Image.open(folder / entry["files"]["instance"]))
        ignore = entry["files"].get("ignore")
        self.ignore = None if ignore is None else np.array(Image.open(folder / ignore)) > 127
        self.camera = pose(self.record["camera"]["world_from_camera"])
        self.ego = pose(self.record["world_from_ego"])
        self.shown = {record["instance_id"]: Shown(record, self.instance) for record in self.record["objects"]}


def truths(folder):
    """Every frame of a set, in the order of its index."""
    index = json.loads((folder / "index.json").read_text())
    found = [Truth(folder, entry) for entry in index["samples"]]
    assert found and any(truth.shown for truth in found), f"{folder} shows nothing"
    return found


def pose(record):
    """The 4 x 4 matrix of a pose record."""
    w, x, y, z = record["rotation_wxyz"]
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = record["translation_m"]
    return out


def corners(target_from_cuboid, size):
    """The eight corners of a cuboid in the target frame, 8 x 3, in no particular order."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return (signs * size) @ target_from_cuboid[:3, :3].T + target_from_cuboid[:3, 3]


def farthest(a, b):
    """How far the corners a lie at most from the nearest of b, metres."""
    return max(np.linalg.norm(b - corner, axis=1).min() for corner in a)


def copied(name, folder):
    """A copy of a set, to be broken."""
    shutil.copytree(SETS / name, folder)
    return folder
