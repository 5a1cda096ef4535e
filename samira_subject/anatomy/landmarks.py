"""Landmarks of the face, and the smooth field that moves the bare head onto them.

Coordinates as in `samira_subject.anatomy.sections`. Half of the face is listed; the other half mirrors it.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from samira_subject.anatomy.creases import with_creases
from samira_subject.anatomy.sections import locate, lowest_descent, section_surface

LANDMARKS = {
    "glabella": (0.0, 19.0, 24.0),
    "nasion": (0.0, 5.0, 18.0),
    "bridge": (0.0, -11.0, 27.0),
    "supratip": (0.0, -26.0, 37.5),
    "pronasale": (0.0, -34.5, 44.0),
    "columella": (0.0, -42.0, 38.5),
    "subnasale": (0.0, -47.5, 29.5),
    "philtrum": (0.0, -54.0, 29.5),
    "labrale superius": (0.0, -60.0, 31.5),
    "stomion": (0.0, -66.5, 30.0),
    "labrale inferius": (0.0, -75.0, 29.0),
    "mentolabial fold": (0.0, -84.0, 23.0),
    "pogonion": (0.0, -98.0, 26.0),
    "menton": (0.0, -110.0, 17.0),
    "nasion, side": (6.0, 4.0, 14.0),
    "bridge, side": (6.0, -11.0, 20.5),
    "bridge, foot": (12.0, -12.0, 12.0),
    "nose, side": (7.0, -23.0, 28.0),
    "nose, foot": (14.0, -24.0, 17.0),
    "tip, side": (6.0, -34.5, 40.0),
    "tip, below": (6.0, -40.5, 37.5),
    "wing, groove": (10.5, -29.5, 28.5),
    "wing, top": (13.5, -33.0, 28.0),
    "wing": (16.5, -38.5, 28.0),
    "wing, below": (14.5, -43.5, 28.0),
    "wing, foot": (15.0, -47.0, 22.5),
    "nostril sill": (7.5, -47.0, 28.5),
    "wing, crease above": (16.5, -30.5, 18.5),
    "wing, crease": (19.8, -38.0, 18.0),
    "wing, crease below": (18.5, -44.0, 19.5),
    "nasolabial fold, start": (23.0, -34.0, 16.5),
    "tear trough": (21.0, -12.0, 9.5),
    "orbit, below": (31.5, -17.0, 12.0),
    "orbit, below outside": (44.0, -14.0, 5.0),
    "orbit, outside": (52.0, 2.0, -8.0),
    "cheekbone": (48.0, -24.0, 4.0),
    "cheekbone, side": (58.0, -20.0, -14.0),
    "zygion": (66.5, -16.0, -42.0),
    "cheek": (37.0, -42.0, 11.0),
    "cheek, side": (52.0, -44.0, -7.0),
    "masseter": (60.0, -52.0, -38.0),
    "cheek hollow": (45.0, -60.0, -5.0),
    "nasolabial fold": (29.0, -53.0, 15.5),
    "cheilion": (26.0, -66.5, 16.5),
    "beside the mouth": (34.0, -66.0, 9.0),
    "crista philtri": (6.0, -57.5, 31.0),
    "upper lip": (14.0, -55.0, 26.5),
    "upper vermilion": (14.0, -61.5, 28.0),
    "lower vermilion": (14.0, -73.5, 26.0),
    "below the lower lip": (14.0, -83.0, 20.0),
    "chin, side": (13.0, -99.0, 22.5),
    "chin, back": (23.0, -97.0, 11.5),
    "marionette": (27.0, -81.0, 11.0),
    "jaw, front": (28.0, -104.0, 1.0),
    "jaw": (43.5, -96.0, -22.0),
    "gonion": (55.0, -80.0, -50.0),
    "ramus": (60.0, -58.0, -62.0),
    "below the jaw, front": (21.0, -116.0, -16.0),
    "below the jaw": (37.0, -109.0, -42.0),
    "below the gonion": (46.5, -97.0, -66.0),
    "brow, inside": (12.0, 17.0, 21.5),
    "brow": (27.0, 20.0, 18.5),
    "brow, outside": (40.0, 18.0, 9.5),
    "brow, tail": (49.0, 12.0, -1.0),
    "lid sulcus, inside": (19.0, 7.0, 11.5),
    "lid sulcus": (31.0, 9.5, 12.0),
    "lid sulcus, outside": (42.0, 8.0, 6.0),
    "canthus, inside": (17.0, -2.0, 8.0),
    "canthus, outside": (46.0, 0.0, 1.0),
    "lid": (31.5, 0.0, 14.0),
    "temple": (61.0, 24.0, -26.0),
    "temple, low": (63.0, 6.0, -30.0),
    "forehead": (22.0, 45.0, 21.5),
    "forehead, side": (44.0, 42.0, 8.0),
    "frontal eminence": (27.0, 60.0, 17.0),
}
"""After the means of facial anthropometry (Farkas, 1994)."""

SOFTNESS = 7.0
"""Millimetres over which the field rounds a landmark off: the multiquadric's constant."""


@cache
def _field() -> tuple[np.ndarray, np.ndarray]:
    """Centres and (M + 4, 3) weights of the displacement."""
    targets = np.array(list(LANDMARKS.values()))
    mirrored = targets[targets[:, 0] > 0.0] * (-1.0, 1.0, 1.0)
    targets = np.concatenate([targets, mirrored])
    rest = section_surface(*locate(targets))
    anchors = _anchors(rest)
    centres = np.concatenate([rest, anchors])
    wanted = np.concatenate([targets - rest, np.zeros_like(anchors)])
    count = len(centres)
    system = np.zeros((count + 4, count + 4))
    system[:count, :count] = _kernel(centres, centres)
    system[:count, count:] = np.column_stack([np.ones(count), centres])
    system[count:, :count] = system[:count, count:].T
    return centres, np.linalg.solve(system, np.concatenate([wanted, np.zeros((4, 3))]))


def _anchors(near: np.ndarray) -> np.ndarray:
    """Points of the bare head that stay: the cranium, the back and the neck, none close to a landmark."""
    azimuth, descent = np.meshgrid(
        np.linspace(-np.pi, np.pi, 17)[:-1], np.linspace(10.0, lowest_descent(), 17), indexing="ij"
    )
    points = section_surface(azimuth.ravel(), descent.ravel())
    distances = np.linalg.norm(points[:, None] - near[None], axis=-1).min(axis=1)
    return points[distances > 28.0]


def _kernel(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Hardy's multiquadric."""
    squared = ((points[:, None] - centres[None]) ** 2).sum(axis=-1)
    return np.sqrt(squared + SOFTNESS**2)


def face_surface(azimuth: np.ndarray, descent: np.ndarray) -> np.ndarray:
    """(N, 3) points of the head with its landmarks and creases in place, at (N,) azimuths and descents."""
    rest = section_surface(azimuth, descent)
    centres, weights = _field()
    moved = _kernel(rest, centres) @ weights[:-4] + np.column_stack([np.ones(len(rest)), rest]) @ weights[-4:]
    return with_creases(rest + moved)


def seen_at(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and descents of `face_surface`'s points that a viewer far in front sees at (N,) places."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    azimuth, descent = locate(np.column_stack([x, y, np.full_like(x, 12.0)]))
    for _ in range(40):
        point = face_surface(azimuth, descent)
        azimuth = azimuth + 0.6 * (x - point[:, 0]) / 90.0
        descent = descent - 0.6 * (y - point[:, 1])
    return azimuth, descent
