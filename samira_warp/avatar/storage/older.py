"""The versions of the avatar folder, and what older ones wrote as the newest writes it.

1   does not say whether the learned light is one map or two: it always is two
2   keeps the poses of FLAME's five joints in rotation, neck, jaw and eyes
3   keeps the poses of any joints in rotations
4   says whether the head blocks the light: before, it never did
5   says by how much Gaussians are smoothed in space, and which are guesses: before, a wider low-pass widened
    them in the picture, and none was known to be a guess
6   says whether wrinkles turn the normals: before, none did
7   says in how many octaves the displacement is seen: before, in as many as positions
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

FORMAT = 7
"""The version that is written."""

UNSMOOTHED = 4
"""The last version that says neither how Gaussians are smoothed, for which a reader finds what stands for it
(`storage.folder`), nor which are guesses."""

READABLE = (1, 2, 3, 4, 5, 6, 7)
"""The versions that are read, oldest first."""

POSE_PARTS = ("rotation", "neck", "jaw", "eyes")
"""FLAME's joints as they were kept before version 3: (T, 3) each, and (T, 6) for both eyes."""


def settings_of_version(settings: dict[str, Any], version: int) -> dict[str, Any]:
    """An avatar's settings of some version as today's."""
    before: dict[str, Any] = {"tied_light": False} if version == 1 else {}
    before |= {"visibility": False} if version <= 3 else {}
    before |= {"smoothing": 0.0} if version <= UNSMOOTHED else {}
    motion = settings.get("motion")
    if isinstance(motion, dict):
        motion = motion | ({"wrinkles": False} if version <= 5 else {})
        motion |= {"displacement_bands": motion.get("bands")} if version <= 6 else {}
        before |= {"motion": motion}
    return {**settings, **before}


def frames_of_version(tensors: dict[str, Tensor], version: int) -> dict[str, Tensor]:
    """The tensors of an avatar's frames of some version as today's.

    Raises:
        KeyError: One is missing.
    """
    if version >= 3:
        return tensors
    others = {name: value for name, value in tensors.items() if name not in POSE_PARTS}
    return {**others, "rotations": joined_poses(*(tensors[name] for name in POSE_PARTS))}


def joined_poses(rotation: Tensor, neck: Tensor, jaw: Tensor, eyes: Tensor) -> Tensor:
    """(T, 5, 3) values of FLAME's joints from those that `POSE_PARTS` name."""
    return torch.cat([rotation, neck, jaw, eyes], dim=1).unflatten(1, (-1, 3))
