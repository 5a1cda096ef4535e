"""Tracked heads as their cameras see them, beside what their pictures cover."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw

from samira_warp.data import Frame, TrackedSequence
from samira_warp.data.pixels import load_mask
from samira_warp.head import FrameParameters, Rig
from samira_warp.support.constants import NEAR_PLANE
from samira_warp.support.errors import UserError

SAMPLES = 12
"""Frames that are looked at."""

_AT_ONCE = 32
"""Heads that are posed together."""

_GRID = 128
"""Pixels of the longer side of silhouettes: enough to tell a head from what it is not."""


class View(NamedTuple):
    """One tracked head before its camera.

    Attributes:
        frame: The frame.
        points: (V, 3) float64 vertices in camera space, metres, OpenCV axes.
        pixels: (V, 2) float64 where they are in the picture; meaningless for points behind the camera.
        rotation: (3, 3) float64 from the head to camera space.
    """

    frame: Frame
    points: np.ndarray
    pixels: np.ndarray
    rotation: np.ndarray

    @property
    def up(self) -> np.ndarray:
        """(3,) float64 the head's +y in camera space."""
        return self.rotation[:, 1]


def sampled_views(sequence: TrackedSequence, indices: Sequence[int]) -> list[View]:
    """Views of at most `SAMPLES` frames, evenly spaced among those with ``indices``."""
    if not indices:
        return []
    chosen = np.unique(np.linspace(0, len(indices) - 1, min(SAMPLES, len(indices))).round().astype(int))
    return list(views_of(sequence, [indices[place] for place in chosen]))


@torch.no_grad()
def views_of(sequence: TrackedSequence, indices: Sequence[int]) -> Iterator[View]:
    """Views of the frames with ``indices``, one by one."""
    rig = Rig.build(sequence.template)
    for begin in range(0, len(indices), _AT_ONCE):
        frames = [sequence.frames[index] for index in indices[begin : begin + _AT_ONCE]]
        parameters = FrameParameters.stack([frame.parameters for frame in frames])
        heads = rig.pose(parameters, sequence.shape, sequence.static_offset)
        yield from map(_view, frames, heads.vertices.double().numpy(), heads.head_transform.double().numpy())


def project(points: np.ndarray, frame: Frame) -> np.ndarray:
    """(..., 2) pixels of (..., 3) points in camera space."""
    camera = frame.camera
    with np.errstate(divide="ignore", invalid="ignore"):
        return points[..., :2] / points[..., 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def silhouette(pixels: np.ndarray, faces: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """(height, width) bool: what triangles with corners at (V, 2) pixels cover."""
    covered = Image.new("1", (width, height))
    draw = ImageDraw.Draw(covered)
    for corners in pixels[faces].reshape(-1, 6).tolist():
        draw.polygon(corners, fill=1)
    return np.asarray(covered)


def faces_before(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F', 3) faces that lie before the camera altogether, of (V, 3) points in its space."""
    return faces[(points[:, 2] > NEAR_PLANE)[faces].all(axis=1)]


def coverage(view: View) -> np.ndarray | None:
    """(h, w) float32 coverage of the picture, at most `_GRID` pixels a side.

    None where it has none or cannot be decoded.
    """
    camera = view.frame.camera
    scale = min(_GRID / max(camera.width, camera.height), 1.0)
    size = {"width": max(round(camera.width * scale), 1), "height": max(round(camera.height * scale), 1)}
    try:
        mask = load_mask(view.frame, **size)
    except UserError:  # broken pictures are told when all are decoded
        return None
    return None if mask is None else mask.numpy()


def _view(frame: Frame, vertices: np.ndarray, head_transform: np.ndarray) -> View:
    pose = frame.camera.world_to_camera.double().numpy()
    points = vertices @ pose[:3, :3].T + pose[:3, 3]
    return View(frame, points, project(points, frame), pose[:3, :3] @ head_transform[:3, :3])
