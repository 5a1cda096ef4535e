"""Lenses that bend the picture, as calibrations write them, and pictures made straight again.

A tracked head is seen through a pinhole, so pictures are: a point that a pinhole shows at (x, y), in focal
lengths from the axis, a lens shows at

    x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

as OpenCV has it (Brown 1971).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from samira_warp.geometry.camera import Camera
from samira_warp.support.errors import UserError

LEAST_BEND = 0.1
"""Pixels: a lens that moves no point of the picture by more is none."""

KEYS = ("k1", "k2", "k3", "p1", "p2")
"""What transforms.json calls the coefficients."""

OTHERS = ("k4", "k5", "k6", "s1", "s2", "s3", "s4")
"""Coefficients of other models: which one means what is not agreed on."""

PINHOLES = ("", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
"""Names of models whose lens is this one's, or none."""


class Lens(NamedTuple):
    """Coefficients of the formula above; the unit is the focal length."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def bend(self, points: np.ndarray) -> np.ndarray:
        """Where the lens shows (..., 2) points that a pinhole shows."""
        x, y = points[..., 0], points[..., 1]
        squared = x * x + y * y
        radial = 1.0 + squared * (self.k1 + squared * (self.k2 + squared * self.k3))
        return np.stack(
            [
                x * radial + 2.0 * self.p1 * x * y + self.p2 * (squared + 2.0 * x * x),
                y * radial + self.p1 * (squared + 2.0 * y * y) + 2.0 * self.p2 * x * y,
            ],
            axis=-1,
        )

    def straightened(self, pixels: np.ndarray, camera: Camera) -> np.ndarray:
        """A picture (H, W[, C]) of any size of a camera's, as a pinhole of the same numbers shows it.

        Pixels are interpolated linearly; what the lens did not show repeats the picture's border.
        """
        height, width = pixels.shape[:2]
        camera = camera.resized(width=width, height=height)
        columns, rows = _pixels_of(camera, self.bend(_points_of(camera)))
        layers = [
            map_coordinates(layer, (rows, columns), order=1, mode="nearest")
            for layer in np.atleast_3d(pixels).transpose(2, 0, 1)
        ]
        return np.stack(layers, axis=-1).reshape(pixels.shape).astype(pixels.dtype)

    def reach(self, camera: Camera) -> float:
        """By how many pixels the lens moves a point of a camera's picture, at most."""
        points = _points_of(camera)
        moved = (self.bend(points) - points) * [camera.fx, camera.fy]
        return float(np.linalg.norm(moved, axis=-1).max())

    def folds(self, camera: Camera) -> bool:
        """Whether the lens shows two points of the picture at one place: the formula is at its end there."""
        points = _points_of(camera)
        squared = (points**2).sum(axis=-1)
        slope = 1.0 + squared * (3.0 * self.k1 + squared * (5.0 * self.k2 + squared * 7.0 * self.k3))
        return bool((slope <= 0.0).any())


def lens_of(place: object, values: dict[str, Any], camera: Camera) -> Lens | None:
    """The lens of one frame of a transforms.json, None where it bends nothing.

    Args:
        place: File and frame, for what is said about it.
        values: The frame's keys.
        camera: Its pinhole.

    Raises:
        UserError: A coefficient is no number, or the lens is of another model (a fisheye) or folds.
    """
    model = str(values.get("camera_model", "")).upper()
    fisheye = "FISHEYE" in model or bool(values.get("is_fisheye"))
    given = {key: _number(place, key, values[key]) for key in (*KEYS, *OTHERS) if key in values}
    others = [key for key, value in given.items() if key in OTHERS and value != 0.0]
    if fisheye or others or (model not in PINHOLES and any(given.values())):
        expected = (
            "a pinhole, or a lens of k1, k2, k3, p1 and p2 alone (undistort the pictures before tracking)"
        )
        raise UserError(place, expected=expected, found=f"camera_model {model}" if not others else others[0])
    lens = Lens(**{key: given.get(key, 0.0) for key in KEYS})
    if lens.reach(camera) <= LEAST_BEND:
        return None
    if lens.folds(camera):
        found = f"{', '.join(f'{key} = {value:g}' for key, value in given.items() if value)}, which folds it"
        raise UserError(place, expected="a lens whose formula holds over the picture", found=found)
    return lens


def _number(place: object, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise UserError(place, expected=f"{key} to be a finite number", found=repr(value))
    return float(value)


def _points_of(camera: Camera) -> np.ndarray:
    """(H, W, 2) pixel centres in focal lengths from the axis."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return np.stack(np.meshgrid(x, y), axis=-1)


def _pixels_of(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows, pixel centres being whole numbers."""
    return (
        points[..., 0] * camera.fx + camera.cx - 0.5,
        points[..., 1] * camera.fy + camera.cy - 0.5,
    )
