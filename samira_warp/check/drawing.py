"""The tracked mesh drawn over its pictures, so that a person sees whether tracking and camera agree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from samira_warp.check.motion import fitted_landmarks
from samira_warp.check.views import View, coverage, faces_before
from samira_warp.data import TrackedSequence
from samira_warp.data.landmarks import DetectedLandmarks
from samira_warp.data.pixels import read_picture
from samira_warp.io.images import resize_box
from samira_warp.stage.dots import draw_dots
from samira_warp.stage.fitting import centred
from samira_warp.stage.sheet import contact_sheet
from samira_warp.support.errors import UserError

CELL = 360
"""Pixels of the longer side of a picture on the sheet."""

_FINE = 3
"""Lines are drawn on a grid so many times as fine, and averaged."""

_EDGE = (0, 255, 140, 150)
_FACE = np.array([0.0, 200.0, 255.0])
_FACE_ALPHA = 24
_MASK_EDGE = np.array([1.0, 0.0, 0.6])
_DETECTED = (255, 210, 0)
_FITTED = (30, 60, 255)

_DOT = 1.0
"""Pixels from the middle of a landmark's dot to its edge."""


class Marks(NamedTuple):
    """Landmarks of one frame, in pixels of its picture.

    Attributes:
        detected: (L, 2) where a detector saw them; NaN for those that it did not.
        fitted: (L, 2) where they are on the mesh.
    """

    detected: np.ndarray
    fitted: np.ndarray


def marks_of(sequence: TrackedSequence, views: list[View], detected: DetectedLandmarks) -> dict[str, Marks]:
    """Landmarks of some frames by their names, of those frames and heads that have them."""
    marks = {}
    for view in views:
        found = detected.of(view.frame.name)
        if found is not None and sequence.template.landmarks is not None:
            ids = sequence.template.landmarks.ids
            marks[view.frame.name] = Marks(found[ids], fitted_landmarks(view, sequence))
    return marks


def mesh_sheet(
    views: list[View], faces: np.ndarray, *, parts: dict[str, str], marks: dict[str, Marks]
) -> np.ndarray:
    """A contact sheet of pictures with the mesh over them in green and the border of the mask in magenta.

    Landmarks are yellow where they were detected, and blue on the mesh.

    Args:
        views: At least one.
        faces: (F, 3) vertex ids.
        parts: Whether a frame trains or tests, by its name.
        marks: Landmarks by the frame's name.

    Returns:
        (rows, columns, 3) float32 display values.
    """
    pictures = [_picture(view, faces, marks.get(view.frame.name)) for view in views]
    height, width = (max(picture.shape[side] for picture in pictures) for side in (0, 1))
    labels = [f"{view.frame.name} {parts.get(view.frame.name, '')}".strip() for view in views]
    return contact_sheet([centred(picture, width=width, height=height) for picture in pictures], labels)


def mesh_overlay(view: View, faces: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """(height, width, 4) float32 premultiplied display values and coverage of a mesh.

    Shaded faces with their edges, near over far.
    """
    camera = view.frame.camera
    faces = faces_before(view.points, faces)
    corners = view.points[faces]
    faces = faces[np.argsort(-corners[..., 2].mean(axis=1))]
    corners = view.points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    fills = np.rint(facing[:, None] * _FACE).astype(int).tolist()
    layer = Image.new("RGBA", (_FINE * width, _FINE * height))
    draw = ImageDraw.Draw(layer)
    pixels = view.pixels * [_FINE * width / camera.width, _FINE * height / camera.height]
    for triangle, fill in zip(pixels[faces].reshape(-1, 6).tolist(), fills, strict=True):
        draw.polygon(triangle, fill=(*fill, _FACE_ALPHA), outline=_EDGE)
    values = np.asarray(layer, np.float32) / 255.0
    values[..., :3] *= values[..., 3:]
    return resize_box(values, width=width, height=height)


def _picture(view: View, faces: np.ndarray, marks: Marks | None) -> np.ndarray:
    """(h, w, 3) a frame with its mesh and landmarks; grey where the picture cannot be decoded."""
    camera = view.frame.camera.with_longer_side(CELL)
    width, height = camera.width, camera.height
    try:
        picture = resize_box(read_picture(view.frame), width=width, height=height)
    except UserError:
        picture = np.full((height, width, 3), 0.5, np.float32)
    overlay = mesh_overlay(view, faces, width=width, height=height)
    picture = picture * (1.0 - overlay[..., 3:]) + overlay[..., :3]
    matte = coverage(view)
    if matte is not None:
        border = _border(resize_box(matte, width=width, height=height) > 0.5)
        picture[border] = _MASK_EDGE
    if marks is not None:
        scale = np.array([width / view.frame.camera.width, height / view.frame.camera.height])
        picture = draw_dots(picture, marks.detected * scale, _DETECTED, radius=_DOT)
        picture = draw_dots(picture, marks.fitted * scale, _FITTED, radius=_DOT)
    return picture


def _border(covered: np.ndarray) -> np.ndarray:
    """(h, w) bool: covered pixels beside uncovered ones."""
    padded = np.pad(covered, 1, mode="edge")
    return covered & ~(padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:])
