"""A browser's camera, and the camera that renders what it shows."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from scipy.spatial.transform import Rotation

from samira_warp.geometry.camera import Camera

Triple = tuple[float, float, float]
"""Coordinates, metres, or an axis."""


class Look(NamedTuple):
    """Where a browser looks from.

    Attributes:
        position: Metres, world space.
        wxyz: Unit quaternion from the camera's axes (OpenCV: x right, y down, z forward) to the world's.
        fov: Degrees that the picture's height spans.
    """

    position: Triple
    wxyz: tuple[float, float, float, float]
    fov: float

    @classmethod
    def of(cls, camera: Camera) -> Look:
        """The look of a camera, its principal point moved to the middle."""
        motion = camera.world_to_camera.double().cpu().numpy()
        x, y, z, w = Rotation.from_matrix(motion[:3, :3].T).as_quat()
        fov = math.degrees(2.0 * math.atan(0.5 * camera.height / camera.fy))
        px, py, pz = (-motion[:3, :3].T @ motion[:3, 3]).tolist()
        return cls((px, py, pz), (float(w), float(x), float(y), float(z)), fov)

    def camera(self, width: int, height: int) -> Camera:
        """The pinhole camera of square pixels that sees the picture's height as the browser does."""
        w, x, y, z = self.wxyz
        # float64 as long as a distance multiplies the rounding
        rotation = Rotation.from_quat([x, y, z, w]).as_matrix().T
        world_to_camera = torch.eye(4, dtype=torch.float64)
        world_to_camera[:3, :3] = torch.from_numpy(rotation.copy())
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ torch.tensor(self.position, dtype=torch.float64)
        focal = 0.5 * height / math.tan(math.radians(0.5 * self.fov))
        return Camera(
            world_to_camera.float(), focal, focal, 0.5 * width, 0.5 * height, width=width, height=height
        )
