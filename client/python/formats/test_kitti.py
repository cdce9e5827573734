"""KITTI object labels and calibrations read by the KITTI database of nuscenes-devkit, tracking labels by KITTI's own description."""

import collections

import numpy as np
import pytest
from nuscenes.utils.kitti import KittiDB
from pyquaternion import Quaternion
from sets import SETS, copied, corners, farthest, truths

# Two decimals a pixel and four a metre; road slopes are lost, KITTI's boxes being upright in the camera's frame.
PIXELS, METRES, CORNERS = 0.006, 0.0006, 0.25


def read(folder):
    """Boxes by stem, in the ego frame (KITTI's Velodyne frame)."""
    root = folder / "kitti"
    (root / "training").mkdir(parents=True)
    for link, target in (("image_2", "images"), ("label_2", "labels"), ("calib", "calib")):
        (root / "training" / link).symlink_to(folder / target)
    database = KittiDB(str(root), splits=("training",))
    turn_back = Quaternion(axis=(0, 0, 1), angle=-np.pi / 2)
    found = {}
    for token in database.tokens:
        boxes = database.get_boxes(token)
        for box in boxes:
            box.rotate(turn_back)
        path = KittiDB.get_filepath(token, "label_2", root=str(root))
        lines = [KittiDB.parse_label_line(line) for line in open(path)]
        projection = KittiDB.get_transforms(token, root=str(root))["p_left"]
        found[token.split("_")[-1]] = (boxes, lines, projection)
    return found


def faults(folder):
    """Where the reader sees something else than the truth; objects come in the same order."""
    read_back, found = read(folder), []
    for truth in truths(folder):
        boxes, lines, projection = read_back[truth.stem]
        ignored = [line for line in lines if line["name"] == "DontCare"]
        lines = [line for line in lines if line["name"] != "DontCare"]
        shown = list(truth.shown.values())
        placed = [own for own in shown if own.name != "Misc"]
        if len(lines) != len(shown) or len(boxes) != len(placed):
            found.append(f"{truth.stem}: {len(lines)} objects of {len(shown)}")
            continue
        if ignored and truth.ignore is None:
            found.append(f"{truth.stem}: ignores what is known")
        for line, own in zip(lines, shown):
            found += line_faults(truth, line, own, projection)
        for box, own in zip(boxes, placed):
            if farthest(box.corners().T, corners(own.ego, own.size)) > CORNERS:
                found.append(f"{truth.stem}: cuboid of {own.id}")
    return found


def line_faults(truth, line, own, projection):
    where, found = f"{truth.stem}: {own.id}", []
    if line["name"] != own.name:
        found.append(f"{where} is {line['name']}")
    box = np.array(own.record["box_visible"]) - 0.5
    width, height = truth.record["camera"]["width"], truth.record["camera"]["height"]
    box = np.clip(box, 0, [width - 1, height - 1] * 2)
    if np.abs(box - line["bbox_camera"]).max() > PIXELS:
        found.append(f"{where}: 2D box {line['bbox_camera']}")
    bottom = (own.camera @ [0, 0, -own.size[2] / 2, 1])[:3]
    if np.abs(bottom - line["xyz_camera"]).max() > METRES:
        found.append(f"{where}: position")
    if np.abs(own.size[[1, 0, 2]] - line["wlh"]).max() > METRES:
        found.append(f"{where}: size")
    forward = own.camera[:3, 0]
    if abs(np.angle(np.exp(1j * (np.arctan2(-forward[2], forward[0]) - line["yaw_camera"])))) > METRES:
        found.append(f"{where}: heading")
    # The calibration carries the bottom centre to where our camera sees it, pixels counted from the first one's centre.
    u, v, depth = projection @ [*line["xyz_camera"], 1]
    camera = truth.record["camera"]
    expected = np.array(camera["focal_px"]) * bottom[:2] / bottom[2] + camera["principal_px"] - 0.5
    if np.abs(np.array([u, v]) / depth - expected).max() > 0.1:
        found.append(f"{where}: calibration")
    return found


@pytest.mark.parametrize("name", ["images", "removed"])
def test_a_kitti_reader_sees_the_objects(name, tmp_path):
    assert faults(copied(name, tmp_path / "set")) == []


def _shift(words):
    words[11] = f"{float(words[11]) + 0.5:.4f}"


def _turn(words):
    words[14] = f"{float(words[14]) + 0.3:.4f}"


def _swap_sizes(words):
    words[8], words[10] = words[10], words[8]


@pytest.mark.parametrize("breakage", [_shift, _turn, _swap_sizes])
def test_broken_labels_are_refused(breakage, tmp_path):
    folder = copied("images", tmp_path / "set")
    label = next(p for p in sorted((folder / "labels").glob("*.txt")) if p.read_text().strip())
    first, *rest = label.read_text().splitlines()
    words = first.split(" ")
    breakage(words)
    label.write_text("\n".join([" ".join(words), *rest]) + "\n")
    assert faults(folder) != []


def test_tracking_labels_hold_the_clip():
    by_sample = collections.defaultdict(list)
    for truth in truths(SETS / "clips"):
        by_sample[truth.record["index"]].append(truth)
    for index, clip in by_sample.items():
        rows = [
            line.split(" ") for line in (SETS / "clips" / f"labels_tracking/{index:06}.txt").read_text().splitlines()
        ]
        assert all(len(row) == 17 and row[3] in "012" and row[4] in "0123" for row in rows)
        read_back = {(int(row[0]), int(row[1])): row for row in rows}
        assert len(read_back) == len(rows)
        shown = {(truth.record["frame_id"], own.id): own for truth in clip for own in truth.shown.values()}
        assert set(shown) == set(read_back)
        for key, own in shown.items():
            row = read_back[key]
            bottom = (own.camera @ [0, 0, -own.size[2] / 2, 1])[:3]
            np.testing.assert_allclose([float(v) for v in row[13:16]], bottom, atol=METRES)
            assert row[2] == own.name
