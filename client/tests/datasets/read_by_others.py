"""Projects labelled boxes with the data sets' own development kits and compares with the corners this project's readers see.

Usage: read_by_others.py DATASETS_FOLDER, as `cargo test --test datasets` wrote it. The corners of one box are ordered by
front/back (+x), left/right (+y), top/bottom (+z): bits 0, 1 and 2 of the index, set for front, left and top.
"""

import json
import sys
from pathlib import Path

import numpy as np

LIMIT_PX = 0.1
# The kits count pixels from the centre of the first one, this project from its corner.
HALF_PIXEL = 0.5
# Both kits list the front face first: left top, right top, right bottom, left bottom as seen from inside the box.
KIT_ORDER = [0b111, 0b101, 0b001, 0b011, 0b110, 0b100, 0b000, 0b010]
# Corners nearer than this are not compared: neither side draws them.
NEAR_M = 0.1


class Corners:
    """What this project's reader saw, by camera, image time, track and box time."""

    def __init__(self, folder: Path):
        rows = json.loads((folder / "corners.json").read_text())
        self.seen = {(r["camera"], r["image_ns"], r["track"], r["box_ns"]): r["corners"] for r in rows}
        self.name = folder.name
        self.compared = 0
        self.worst_px = 0.0
        self.control_px = np.inf

    def compare(self, key, pixels: np.ndarray, depths: np.ndarray) -> None:
        """Compares the kit's eight corners, (8, 2) pixels and (8,) depths."""
        ours = self.seen[key]
        for kit_index, our_index in enumerate(KIT_ORDER):
            if depths[kit_index] <= NEAR_M * 1.01 or ours[our_index] is None:
                continue
            theirs = pixels[kit_index] + HALF_PIXEL
            self.worst_px = max(self.worst_px, float(np.linalg.norm(theirs - ours[our_index])))
            self.compared += 1

    def control(self, key, pixels: np.ndarray, depths: np.ndarray) -> None:
        """The same with left and right exchanged, which must not agree."""
        ours = self.seen[key]
        apart = [
            np.linalg.norm(pixels[k] + HALF_PIXEL - ours[index ^ 0b010])
            for k, index in enumerate(KIT_ORDER)
            if depths[k] > NEAR_M * 1.01 and ours[index ^ 0b010] is not None
        ]
        if apart:
            self.control_px = min(self.control_px, float(np.max(apart)))

    def verdict(self) -> bool:
        good = self.compared >= 100 and self.worst_px <= LIMIT_PX and self.control_px > LIMIT_PX
        print(
            f"{self.name}: {self.compared} corners, at most {self.worst_px:.2g} px apart"
            f" (limit {LIMIT_PX}); mirrored boxes at least {self.control_px:.2g} px: {'passed' if good else 'FAILED'}"
        )
        return good


def nuscenes(folder: Path) -> bool:
    from nuscenes.nuscenes import NuScenes
    from nuscenes.utils.geometry_utils import BoxVisibility, view_points

    kit = NuScenes(version="v1.0-mini", dataroot=str(folder), verbose=False)
    corners = Corners(folder)
    for data in kit.sample_data:
        if data["sensor_modality"] != "camera":
            continue
        _, boxes, intrinsic = kit.get_sample_data(data["token"], box_vis_level=BoxVisibility.NONE)
        for box in boxes:
            annotation = kit.get("sample_annotation", box.token)
            sample = kit.get("sample", data["sample_token"])
            labelled = data["is_key_frame"] or not sample["prev"]
            box_us = sample["timestamp"] if labelled else data["timestamp"]
            if not labelled and data["timestamp"] > sample["timestamp"]:
                box_us = sample["timestamp"]
            key = (data["channel"], data["timestamp"] * 1000, annotation["instance_token"], box_us * 1000)
            points = box.corners()
            pixels = view_points(points, intrinsic, normalize=True)[:2].T
            corners.compare(key, pixels, points[2])
            corners.control(key, pixels, points[2])
    return corners.verdict()


def argoverse(folder: Path) -> bool:
    from av2.datasets.sensor.av2_sensor_dataloader import AV2SensorDataLoader
    from av2.structures.sweep import Sweep

    loader = AV2SensorDataLoader(data_dir=folder, labels_dir=folder)
    log = loader.get_log_ids()[0]
    corners = Corners(folder)
    ids = track_ids(folder / log)
    cameras = sorted(p.name for p in (folder / log / "sensors/cameras").iterdir())
    for sweep_ns in loader.get_ordered_log_lidar_timestamps(log):
        sweep = Sweep.from_feather(loader.get_lidar_fpath(log, sweep_ns))
        assert len(sweep.xyz) > 0 and np.isfinite(sweep.xyz).all()
        cuboids = loader.get_labels_at_lidar_timestamp(log, sweep_ns)
        for camera in cameras:
            for path in loader.get_ordered_log_cam_fpaths(log, camera):
                image_ns = int(path.stem)
                for track, cuboid in zip(ids[sweep_ns], cuboids.cuboids, strict=True):
                    pixels, in_camera, _ = loader.project_ego_to_img_motion_compensated(
                        cuboid.vertices_m, camera, image_ns, sweep_ns, log
                    )
                    key = (camera, image_ns, track, sweep_ns)
                    corners.compare(key, pixels, in_camera[:, 2])
                    corners.control(key, pixels, in_camera[:, 2])
    return corners.verdict()


def track_ids(log: Path) -> dict[int, list[str]]:
    """Track ids of each sweep in the order of the annotations; the kit's cuboids leave them out."""
    from av2.utils.io import read_feather

    table = read_feather(log / "annotations.feather")
    return {int(time): list(rows["track_uuid"]) for time, rows in table.groupby("timestamp_ns", sort=False)}


def main() -> int:
    datasets = Path(sys.argv[1])
    passed = [nuscenes(datasets / "nuscenes"), argoverse(datasets / "argoverse")]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
