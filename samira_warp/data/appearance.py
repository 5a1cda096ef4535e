"""Albedo and light as a tracker found them, where it left them with its dataset."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.head.template import HeadTemplate
from samira_warp.io.npz import read_npz
from samira_warp.light.harmonics import FUNCTIONS
from samira_warp.support.errors import UserError

APPEARANCE_FILE = "appearance.npz"
"""In a dataset's folder; no dataset has to have it."""


class TrackedAppearance(NamedTuple):
    """What a matte head under one distant light looks like: pixel = albedo times irradiance over pi.

    Their product is what pictures tell; how bright and of which colour each of them is, they do not.

    Attributes:
        albedo: (V, 3) float32, linear, of every vertex of the template.
        light: (9, 3) float32 radiance in the spherical harmonics of `samira_warp.light.harmonics`; axes are
            the world's.
    """

    albedo: Tensor
    light: Tensor


def read_appearance(root: Path, template: HeadTemplate) -> TrackedAppearance | None:
    """Read a dataset's `APPEARANCE_FILE`; None where it has none.

    It holds albedo (V, 3) and light (9, 3). Nothing in it is unpickled.

    Args:
        root: The dataset's folder.
        template: Its head, whose V vertices the albedo is of.

    Raises:
        UserError: The file is broken, lacks an array, or has one of a wrong shape, not finite, or without
            any light.
    """
    path = root / APPEARANCE_FILE
    if not path.is_file():
        return None
    shapes = {"albedo": (len(template.v_template), 3), "light": (FUNCTIONS, 3)}
    arrays = read_npz(path, wanted=shapes.__contains__)
    for key, shape in shapes.items():
        if key not in arrays:
            raise UserError(f"{path}: {key}", expected="an array", found="no such key")
        array = arrays[key]
        if array.shape != shape or array.dtype.kind != "f":
            found = f"{array.dtype} of shape {array.shape}"
            raise UserError(f"{path}: {key}", expected=f"real numbers of shape {shape}", found=found)
    albedo, light = (torch.from_numpy(arrays[key]).to(torch.float32) for key in shapes)
    if not bool((albedo.isfinite() & (albedo >= 0.0)).all()):
        raise UserError(f"{path}: albedo", expected="finite values of at least 0", found="others")
    if not (bool(light.isfinite().all()) and bool((light[0] > 0.0).all())):
        raise UserError(f"{path}: light", expected="finite values, the first ones positive", found="others")
    return TrackedAppearance(albedo, light)
