"""The component classes of the Waymo Open Dataset's own package, without the rest of it, which needs TensorFlow."""

import importlib.util
import pathlib
import sys
import types

import numpy as np
import pyarrow as pa

_root = pathlib.Path(next(iter(importlib.util.find_spec("waymo_open_dataset").submodule_search_locations)))
# The package's __init__ imports everything; its modules by themselves need pyarrow alone.
_package = types.ModuleType("waymo_open_dataset.v2")
_package.__path__ = [str(_root / "v2")]
sys.modules["waymo_open_dataset.v2"] = _package

from waymo_open_dataset.v2.perception.box import (  # noqa: E402
    CameraBoxComponent,
    CameraToLiDARBoxAssociationComponent,
    LiDARBoxComponent,
    LiDARCameraSyncedBoxComponent,
    ProjectedLiDARBoxComponent,
)
from waymo_open_dataset.v2.perception.camera_image import CameraImageComponent  # noqa: E402
from waymo_open_dataset.v2.perception.context import CameraCalibrationComponent  # noqa: E402
from waymo_open_dataset.v2.perception.pose import VehiclePoseComponent  # noqa: E402

__all__ = [
    "CameraBoxComponent",
    "CameraCalibrationComponent",
    "CameraImageComponent",
    "CameraToLiDARBoxAssociationComponent",
    "LiDARBoxComponent",
    "LiDARCameraSyncedBoxComponent",
    "ProjectedLiDARBoxComponent",
    "VehiclePoseComponent",
    "build",
    "fields",
    "fits",
    "numbers",
]


def fields(cls):
    """The columns of a component, as Waymo defines them."""
    return list(cls.schema())


def fits(written: pa.DataType, defined: pa.DataType) -> bool:
    """Whether a column's type is the defined one; a list may be of any length."""
    if pa.types.is_fixed_size_list(defined):
        return pa.types.is_list(written) and written.value_type == defined.value_type
    return written == defined


def build(cls, row):
    """A component of a row, made by Waymo's code; it fails if a column lacks."""
    return cls.from_dict({field.name: row[field.name] for field in fields(cls)})


def numbers(box):
    """Centre, size and heading of an upright box."""
    return box.numpy(np.float64)
