"""Rigid transforms and 7-number boxes.

Cameras are OpenCV (x right, y down, z forward); ego, world and cuboid frames are x forward, y left, z up.
A matrix named `target_from_source` maps homogeneous source coordinates to target coordinates.
"""

from __future__ import annotations

import math

import numpy as np

from backlot.errors import ContractError
from backlot.v1 import common_pb2


def matrix(transform: common_pb2.RigidTransform) -> np.ndarray:
    """The 4 x 4 float64 matrix target_from_source of a rigid transform in metres; ContractError if its quaternion is no rotation."""
    q = np.array([transform.rotation.w, transform.rotation.x, transform.rotation.y, transform.rotation.z])
    norm = np.linalg.norm(q)
    if not abs(norm - 1) < 1e-2:
        raise ContractError(f"a rotation's quaternion has norm {norm}")
    w, x, y, z = q / norm
    t = transform.translation_m
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t.x],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t.y],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def inverse(target_from_source: np.ndarray) -> np.ndarray:
    """source_from_target of a 4 x 4 rigid matrix."""
    out = np.eye(4)
    out[:3, :3] = target_from_source[:3, :3].T
    out[:3, 3] = -out[:3, :3] @ target_from_source[:3, 3]
    return out


def box_in_world(world_from_cuboid: np.ndarray, size_m: np.ndarray) -> np.ndarray:
    """(x, y, z, length, width, height, yaw) in the world frame: centre in metres, yaw in radians from x towards y."""
    forward = world_from_cuboid[:3, 0]
    return np.array([*world_from_cuboid[:3, 3], *size_m, math.atan2(forward[1], forward[0])])


def box_in_camera(camera_from_cuboid: np.ndarray, size_m: np.ndarray) -> np.ndarray:
    """(x, y, z, length, width, height, rotation_y) in the camera frame.

    The position is the CENTRE in metres (KITTI's location is the bottom centre: add height / 2 along the cuboid's
    down axis). rotation_y is KITTI's: radians about the camera's y axis, 0 if the object faces the camera's x axis
    and -pi/2 if it drives away along z. Pitch and roll are lost; the matrices keep them.
    """
    forward = camera_from_cuboid[:3, 0]
    return np.array([*camera_from_cuboid[:3, 3], *size_m, math.atan2(-forward[2], forward[0])])
