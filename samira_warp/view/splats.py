"""The head as splats that the browser draws itself: each Gaussian shaded where it is, none hiding another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.avatar import Avatar, MaterialEdit, Motion
from samira_warp.io.images import to_uint8
from samira_warp.light import FilteredLight, shade
from samira_warp.support.tone_names import ToneMap

SPLAT_UNITS = 10.0
"""In a metre, of what splats are sent in: viser keeps covariances in half floats, and those of thin splats in
square metres are too small for them."""


class BrowserSplats(NamedTuple):
    """N splats.

    Attributes:
        centers: (N, 3) float32 metres, world space.
        covariances: (N, 3, 3) float32 square metres.
        colors: (N, 3) uint8 display values.
        opacities: (N, 1) uint8, 255 is opaque.
    """

    centers: np.ndarray
    covariances: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray


def shaded_splats(
    avatar: Avatar,
    motion: Motion,
    light: FilteredLight,
    *,
    eye: Tensor,
    arrival: Tensor | None,
    edits: tuple[MaterialEdit, ...],
    tone_map: ToneMap,
) -> BrowserSplats:
    """What an eye sees of every Gaussian under a light.

    Args:
        avatar: The avatar.
        motion: Its moved Gaussians.
        light: What lights them.
        eye: (3,) metres, world space; highlights are where it sees them.
        arrival: What of the light arrives at them (`Avatar.arrival`), None without shadows.
        edits: Changes to the materials.
        tone_map: What brings radiance into the range of a display.
    """
    moved = motion.gaussians
    view = torch.nn.functional.normalize(eye - moved.means, dim=1)
    surface = avatar.surface(motion, edits=edits, arrival=arrival)
    shaded = shade(surface, view, light, color_space=avatar.settings.color_space, tone_map=tone_map)
    # scipy's quaternions end with the real part
    turns = Rotation.from_quat(moved.quaternions.roll(-1, dims=1).cpu().numpy()).as_matrix()
    axes = turns.astype(np.float32) * moved.scales[:, None, :].cpu().numpy()
    return BrowserSplats(
        moved.means.cpu().numpy(),
        axes @ axes.swapaxes(1, 2),
        to_uint8(shaded.image.cpu().numpy()),
        to_uint8(avatar.gaussians.opacities.cpu().numpy()[:, None]),
    )
