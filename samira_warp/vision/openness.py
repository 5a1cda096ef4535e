"""How far eyes and mouth are open, by what the networks see of lids and lips.

Which network is to be believed was measured on two rendered heads whose blinks are known, 600 pictures: the
iris network's lids are apart by at most 0.17 of the eye's width where an eye is closed and by at least 0.22
where it is open, the face mesh's by 0.2 to 0.4 either way. It has no closed eyes.

Of lips there is the face mesh alone. It puts the inner lips of closed mouths apart by up to 0.15 of the
mouth's width where they are pursed, and those of mouths that show their teeth by as little as 0.04: in
between, it does not know.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from samira_warp.vision.faces import FaceTrack

CLOSED_EYE = 0.19
"""Of the eye's width: lids that are less apart are closed, midway between the closed and the open eyes that
were measured."""

CLOSED_SHARE = 0.65
"""Of a person's own open eyes, as `OPEN_EYES` says; narrow ones are not closed all the time."""

OPEN_EYES = 90.0
"""Percentile over the film of a person's open eyes."""

CLOSED_MOUTH = 0.03
"""Of the mouth's width: inner lips that are less apart meet. In the three clips this is right of all pictures
that were looked at but of two with a slit of teeth."""

OPEN_MOUTH = 0.15
"""Of the mouth's width: inner lips that are further apart are open, pursed ones reach this at most."""

MIDDLE = slice(1, 6)
"""Of the seven points on a lid: next to the corners lids stay closed."""

INNER_LIPS = ((82, 87), (13, 14), (312, 317))
"""Points of the mesh on the upper and the lower lip's inner edge, opposite each other."""

MOUTH_CORNERS = (78, 308)


class Openness(NamedTuple):
    """Of every picture; NaN where no face is seen.

    Attributes:
        eyes: (N, 2) float32 of the subject's left and right eye, in its widths: about 0.3 open, 0.1 closed.
        closed: (N, 2) bool whether that eye is closed.
        mouth: (N,) float32 gap between the inner lips in widths of the mouth; between `CLOSED_MOUTH` and
            `OPEN_MOUTH` it is not to be relied on.
    """

    eyes: np.ndarray
    closed: np.ndarray
    mouth: np.ndarray


def own_openness(lids: np.ndarray) -> np.ndarray:
    """(2,) float64 how far a person's open eyes are open, of (N, 2, 16, 2) lids; NaN where none are seen."""
    eyes = eye_openness(lids)
    return np.nanpercentile(eyes, OPEN_EYES, axis=0) if np.isfinite(eyes).any() else np.full(2, np.nan)


def read_openness(track: FaceTrack, *, own: np.ndarray | None = None) -> Openness:
    """How far eyes and mouth are open in a film.

    Args:
        track: The face in it.
        own: (2,) of `own_openness`, of more pictures than these; None for these alone.
    """
    eyes = eye_openness(track.lids)
    mouth = mouth_openness(track.landmarks)
    own = own_openness(track.lids) if own is None else own
    with np.errstate(invalid="ignore"):
        closed = eyes < np.minimum(CLOSED_EYE, CLOSED_SHARE * own)
    return Openness(eyes.astype(np.float32), closed, mouth.astype(np.float32))


def eye_openness(lids: np.ndarray) -> np.ndarray:
    """Mean gap between the lids in widths of the eye.

    Args:
        lids: (..., 16, 2) of `FaceTrack`.
    """
    lower, upper = lids[..., 1:8, :], lids[..., 9:16, :]
    gap = np.linalg.norm(upper - lower, axis=-1)[..., MIDDLE].mean(axis=-1)
    return gap / np.linalg.norm(lids[..., 8, :] - lids[..., 0, :], axis=-1)


def mouth_openness(landmarks: np.ndarray) -> np.ndarray:
    """Mean gap between the inner lips in widths of the mouth.

    Args:
        landmarks: (..., 468, 3) pixels. Distances are taken in space: of a mouth that is seen from the side
            the width shrinks, the gap does not.
    """
    upper, lower = np.array(INNER_LIPS).T
    gap = np.linalg.norm(landmarks[..., upper, :] - landmarks[..., lower, :], axis=-1).mean(axis=-1)
    left, right = MOUTH_CORNERS
    return gap / np.linalg.norm(landmarks[..., left, :] - landmarks[..., right, :], axis=-1)
