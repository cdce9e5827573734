"""Parquet components read by pyarrow into the component classes of the Waymo Open Dataset."""

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import waymo_schema as schema
from PIL import Image
from sets import NAMES, SETS, copied, truths

# x forward, y left, z up in a camera's frame with x right, y down, z forward.
CAMERA_FROM_FORWARD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
TYPES = {"Pedestrian": 2, "Cyclist": 4, "Misc": 0}


def component(folder, name, cls):
    """Every row of a component, by segment and time, checked against Waymo's column names."""
    rows = []
    for path in sorted((folder / "waymo" / name).glob("*.parquet")):
        table = pq.read_table(path)
        defined = {field.name: field.type for field in schema.fields(cls)}
        assert set(table.column_names) == set(defined), path.name
        wrong = [c for c in defined if not schema.fits(table.schema.field(c).type, defined[c])]
        assert not wrong, f"{path.name} has other types for {wrong}"
        rows += [schema.build(cls, row) for row in table.to_pylist()]
    return rows


def key(row):
    return row.key.segment_context_name.rsplit("_", 1)[1], row.key.frame_timestamp_micros


def faults(folder):
    """Where the components say something else than the truth."""
    frames = {(str(t.record["index"]), t.record["timestamp_ns"] // 1000): t for t in truths(folder)}
    images = component(folder, "camera_image", schema.CameraImageComponent)
    found = [] if {key(row) for row in images} == set(frames) else ["other frames"]
    for row in images:
        pixels = np.array(Image.open(io.BytesIO(row.image)))
        if not np.array_equal(pixels, np.array(Image.open(folder / frames[key(row)].image))):
            found.append(f"{key(row)}: image")
    poses = component(folder, "vehicle_pose", schema.VehiclePoseComponent)
    if len(poses) != len(frames):
        found.append(f"{len(poses)} vehicle poses")
    for row in poses:
        if np.abs(np.reshape(row.world_from_vehicle.transform, (4, 4)) - frames[key(row)].ego).max() > 1e-9:
            found.append(f"{key(row)}: vehicle pose")
    found += calibration_faults(folder, frames)
    found += cuboid_faults(folder, frames)
    for row in component(folder, "camera_to_lidar_box_association", schema.CameraToLiDARBoxAssociationComponent):
        if row.key.camera_object_id != row.key.laser_object_id:
            found.append(f"{key(row)}: association")
    return found + rectangle_faults(folder, frames)


def calibration_faults(folder, frames):
    found = []
    rows = {row.key.segment_context_name.rsplit("_", 1)[1]: row for row in
            component(folder, "camera_calibration", schema.CameraCalibrationComponent)}  # fmt: skip
    for (index, _), truth in frames.items():
        row, camera = rows[index], truth.record["camera"]
        vehicle_from_camera = np.reshape(row.extrinsic.transform, (4, 4))
        if np.abs(truth.ego @ vehicle_from_camera - truth.camera @ CAMERA_FROM_FORWARD).max() > 1e-6:
            found.append(f"{index}: extrinsic")
        intrinsic = row.intrinsic
        numbers = [intrinsic.f_u, intrinsic.f_v, intrinsic.c_u, intrinsic.c_v, row.width, row.height]
        if numbers != [*camera["focal_px"], *camera["principal_px"], camera["width"], camera["height"]]:
            found.append(f"{index}: intrinsic")
    return found


def cuboid_faults(folder, frames):
    found, counts = [], dict.fromkeys(frames, 0)
    synced = {(*key(row), row.key.laser_object_id): row.camera_synced_box for row in
              component(folder, "lidar_camera_synced_box", schema.LiDARCameraSyncedBoxComponent)}  # fmt: skip
    for row in component(folder, "lidar_box", schema.LiDARBoxComponent):
        truth = frames[key(row)]
        own = truth.shown[int(row.key.laser_object_id)]
        counts[key(row)] += 1
        heading = np.arctan2(own.ego[1, 0], own.ego[0, 0])
        expected = [*own.ego[:3, 3], *own.size, heading]
        for box in (row.box, synced[(*key(row), row.key.laser_object_id)]):
            if np.abs(schema.numbers(box) - expected).max() > 1e-6:
                found.append(f"{key(row)}: cuboid of {own.id}")
        if row.type != TYPES.get(own.name, 1):
            found.append(f"{key(row)}: type of {own.id}")
        if row.num_lidar_points_in_box != own.record["lidar_points"]:
            found.append(f"{key(row)}: points of {own.id}")
        if own.velocity is not None:
            speed = np.array([row.speed.x, row.speed.y, row.speed.z])
            if np.abs(truth.ego[:3, :3] @ speed - own.velocity).max() > 1e-6:
                found.append(f"{key(row)}: speed of {own.id}")
    return found + [f"{k}: {n} boxes" for k, n in counts.items() if n != len(frames[k].shown)]


def rectangle_faults(folder, frames):
    found = []
    for name, cls, field in (
        ("camera_box", schema.CameraBoxComponent, "box_visible"),
        ("projected_lidar_box", schema.ProjectedLiDARBoxComponent, "box_amodal"),
    ):
        rows = component(folder, name, cls)
        if len(rows) != sum(s.record[field] is not None for t in frames.values() for s in t.shown.values()):
            found.append(f"{name}: {len(rows)} rows")
        for row in rows:
            number = row.key.camera_object_id if name == "camera_box" else row.key.laser_object_id
            own = frames[key(row)].shown[int(number)]
            centre, half = (
                np.array([row.box.center.x, row.box.center.y]),
                np.array([row.box.size.x, row.box.size.y]) / 2,
            )
            if np.abs([*(centre - half), *(centre + half)] - np.array(own.record[field])).max() > 1e-6:
                found.append(f"{key(row)}: {name} of {own.id}")
    return found


@pytest.mark.parametrize("name", NAMES)
def test_waymos_classes_hold_the_objects(name):
    assert faults(SETS / name) == []


def _rewrite(folder, name, change):
    path = sorted((folder / "waymo" / name).glob("*.parquet"))[0]
    table = pq.read_table(path)
    pq.write_table(change(table), path)


def _shifted(column, by):
    def change(table):
        values = [v + by for v in table[column].to_pylist()]
        at = table.column_names.index(column)
        field = table.schema.field(column)
        return table.set_column(at, field, pa.array(values, field.type))

    return change


@pytest.mark.parametrize(
    "name, change",
    [
        ("lidar_box", _shifted("[LiDARBoxComponent].box.center.x", 0.1)),
        ("lidar_box", _shifted("[LiDARBoxComponent].box.heading", 0.1)),
        ("camera_box", _shifted("[CameraBoxComponent].box.center.x", 1.0)),
        ("camera_calibration", _shifted("[CameraCalibrationComponent].intrinsic.c_u", 0.5)),
        ("vehicle_pose", lambda table: table.slice(1)),
        ("lidar_box", lambda table: table.slice(1)),
    ],
)
def test_broken_components_are_refused(name, change, tmp_path):
    folder = copied("clips", tmp_path / "set")
    _rewrite(folder, name, change)
    assert faults(folder) != []
