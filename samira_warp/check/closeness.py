"""How close a tracked mesh is to its pictures: to the landmarks in them, and to their mattes.

A grade is measured on what the tracker itself may have fitted. It tells a fit that failed; it cannot tell a
good one from one that follows wrong landmarks.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from samira_warp.check.grades import Grade, word_of, worst_of
from samira_warp.check.motion import HeadMotion
from samira_warp.check.views import View, coverage, faces_before, silhouette
from samira_warp.data.landmarks import DetectedLandmarks

LANDMARKS_GOOD, LANDMARKS_FAIR = 0.006, 0.012
"""Median distances between landmarks of the mesh and of the picture, in the head's height. The detector sees
a head with 192 pixels, of which one is about half a per cent of its height: one of them is its own error, two
are seen as a mouth beside the mouth."""

INSIDE_GOOD, INSIDE_FAIR = 0.98, 0.95
"""Shares of the head's silhouette that lie in the matte. A head that fills a picture of 512 and lies four
pixels to a side of its own matte has 0.98, and 0.95 with ten; edges of mattes that are made differ by two."""

_SLANT = 0.04
"""Share of a picture's height through which the lower edge of a matte that was cut off may run."""

_FINE = 4
"""Samples of a silhouette along a pixel's side."""


def grade_landmarks(
    motion: HeadMotion, detected: DetectedLandmarks | None, ids: np.ndarray | None
) -> Grade | None:
    """How far the mesh's landmarks are from those that a detector found; None where there is nothing to tell.

    Args:
        motion: The head in its frames.
        detected: What was found in the pictures.
        ids: (L,) which landmarks the head's are.
    """
    if detected is None or ids is None:
        return None
    frames, shares = {}, []
    for name, points, height in zip(motion.names, motion.landmarks, motion.heights, strict=True):
        found = detected.of(name)
        if found is None:
            continue
        distances = np.linalg.norm(points - found[ids], axis=1)
        if np.isfinite(distances).any():
            frames[name] = float(np.nanmedian(distances))
            shares.append(frames[name] / height)
    if not frames:
        return None
    pixels, share = float(np.median(list(frames.values()))), float(np.median(shares))
    text = (
        f"the mesh lies {pixels:.1f} pixels beside the detected landmarks in the median, "
        f"{_percent(share)} of the head's height; {worst_of(frames)}"
    )
    overall = {"median_pixels": pixels, "median_share_of_height": share, "frames": len(frames)}
    return Grade("landmarks", word_of(share, good=LANDMARKS_GOOD, fair=LANDMARKS_FAIR), text, overall, frames)


def grade_overlap(views: Iterable[View], faces: np.ndarray, v_template: np.ndarray) -> Grade | None:
    """How much of the head lies in its matte, above the neck; None where there is no matte.

    Args:
        views: Some frames.
        faces: (F, 3) vertex ids.
        v_template: (V, 3) the head at rest, which tells where the neck ends.
    """
    inside: dict[str, float] = {}
    overlaps = []
    lowest = v_template[:, 1] <= np.quantile(v_template[:, 1], 0.03)
    for view in views:
        matte = coverage(view)
        if matte is None:
            continue
        height, width = matte.shape
        camera = view.frame.camera
        pixels = view.pixels * [width / camera.width, height / camera.height]
        head = _covered(pixels, faces_before(view.points, faces), width=width, height=height)
        # Below where the mesh ends the matte may go on, and below where a matte is cut off, the mesh.
        covered = matte > 0.5
        cut = np.flatnonzero(covered.any(axis=1)).max(initial=-1) - _SLANT * height
        neck = int(np.clip(min(np.median(pixels[lowest, 1]), cut), 0, height))
        head, covered = head[:neck], covered[:neck]
        shared, size = np.count_nonzero(head & covered), np.count_nonzero(head)
        if size:
            inside[view.frame.name] = float(shared / size)
            overlaps.append(shared / np.count_nonzero(head | covered))
    if not inside:
        return None
    share, overlap = float(np.median(list(inside.values()))), float(np.median(overlaps))
    name = min(inside, key=inside.__getitem__)
    text = (
        f"{_percent(share)} of the head's silhouette lies in the matte in the median, least in {name}: "
        f"{_percent(inside[name])}; above the neck the two share {_percent(overlap)} of what either covers, "
        "hair being in the matte alone"
    )
    overall = {"median_inside": share, "median_overlap": overlap, "frames": len(inside)}
    return Grade("overlap", word_of(-share, good=-INSIDE_GOOD, fair=-INSIDE_FAIR), text, overall, inside)


def _covered(pixels: np.ndarray, faces: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """(height, width) bool: pixels of which triangles cover more than half.

    `silhouette` takes in all that an outline touches, half a pixel too much: on a finer grid that is less.
    """
    fine = silhouette(_FINE * pixels, faces, width=_FINE * width, height=_FINE * height)
    return fine.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3)) > 0.5


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
