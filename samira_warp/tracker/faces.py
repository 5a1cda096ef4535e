"""What networks saw of a face, as a fit takes it: which of it to believe, and how far."""

from __future__ import annotations

import numpy as np
import torch

from samira_warp.head.landmarks import LANDMARKS, MESH_LANDMARKS
from samira_warp.tracker.observed import Landmarks
from samira_warp.vision.faces import FaceTrack
from samira_warp.vision.openness import CLOSED_MOUTH, OPEN_EYES, OPEN_MOUTH, read_openness

LIDS = (
    ((398, 382), (384, 381), (385, 380), (386, 374), (387, 373), (388, 390), (466, 249)),
    ((173, 155), (157, 154), (158, 153), (159, 145), (160, 144), (161, 163), (246, 7)),
)
"""Points of the upper and the lower lid that meet, from the inner corner on: left eye, right eye."""

LIPS = ((13, 14), (82, 87), (312, 317), (81, 178), (311, 402), (80, 88), (310, 318), (191, 95), (415, 324))
"""Points of the inner lips that meet."""

GAPS = (*LIDS[0], *LIDS[1], *LIPS)
"""All pairs, the upper one first."""

CLOSED_LIDS = 0.14
"""Gap in widths of the eye that the iris network leaves between lids that touch: 0.10 to 0.17, as
`samira_warp.vision.openness` has it."""

_LEFT, _RIGHT = (0, 1, 2, 3, 4), (0, 3, 2, 1, 4)
"""Order of an iris's points by where they are in the picture: the middle, right, above, left, below; networks
count the rim from its outer point."""


def landmarks_of(track: FaceTrack, *, own: np.ndarray | None = None) -> Landmarks:
    """Landmarks of the mesh and the irises, and the gaps of lids and lips.

    Lids are the iris network's and not the mesh's, which stay open over closed eyes; what both networks leave
    open of what is closed is taken off. A closed eye shows no iris.

    Args:
        track: The face in N pictures.
        own: (2,) how far the person's open eyes are open (`own_openness`); None for these pictures'.
    """
    frames = len(track.landmarks)
    points = np.zeros((frames, LANDMARKS, 3), np.float32)
    points[:, :MESH_LANDMARKS] = track.landmarks
    for first, eye, order in ((MESH_LANDMARKS, 1, _RIGHT), (MESH_LANDMARKS + 5, 0, _LEFT)):
        points[:, first : first + 5, :2] = track.irises[:, eye, list(order)]
    openness = read_openness(track, own=own)
    seen = np.asarray(np.isfinite(points).all(axis=-1))
    for first, eye in ((MESH_LANDMARKS, 1), (MESH_LANDMARKS + 5, 0)):
        seen[:, first : first + 5] &= ~openness.closed[:, eye, None]
    gaps = np.concatenate(
        [*_lids(track, openness.eyes, openness.closed, own), _lips(track, openness.mouth)], axis=1
    )
    gaps_seen = np.isfinite(gaps).all(axis=-1)
    return Landmarks(
        *(
            torch.from_numpy(np.ascontiguousarray(np.nan_to_num(values), np.float32))
            for values in (points[..., :2], points[..., 2], seen, gaps, gaps_seen)
        )
    )


def _lids(
    track: FaceTrack, openness: np.ndarray, closed: np.ndarray, person: np.ndarray | None
) -> list[np.ndarray]:
    """(N, 7, 2) of either eye: nothing of closed lids, all of a person's open ones."""
    found = []
    for eye in (0, 1):
        lids = track.lids[:, eye]
        gaps = lids[:, 9:16] - lids[:, 1:8]
        if person is not None:
            own = person[eye]
        else:
            own = np.nanpercentile(openness[:, eye], OPEN_EYES) if track.seen.any() else 1.0
        own = max(float(own), 1.5 * CLOSED_LIDS)
        share = (openness[:, eye] - CLOSED_LIDS) / (own - CLOSED_LIDS) * own / openness[:, eye]
        share = np.where(closed[:, eye], 0.0, share.clip(0.0, None))
        found.append(gaps * share[:, None, None])
    return found


def _lips(track: FaceTrack, openness: np.ndarray) -> np.ndarray:
    """(N, 9, 2): nothing of lips that meet, all of a mouth that is open for certain."""
    upper, lower = np.array(LIPS).T
    gaps = track.landmarks[:, upper, :2] - track.landmarks[:, lower, :2]
    share = (openness - CLOSED_MOUTH) / (OPEN_MOUTH - CLOSED_MOUTH) * OPEN_MOUTH / np.maximum(openness, 1e-6)
    share = np.where(openness < OPEN_MOUTH, share.clip(0.0, None), 1.0)
    return gaps * np.where(np.isnan(openness), np.nan, share)[:, None, None]
