"""Where pixels look and are lit from in plain torch: `kernels.shading.aiming`."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.shading.aiming import Aimed
from samira_warp.light.equirect import turn_directions
from samira_warp.support.constants import COVERED_ALPHA


def aim(normal: Tensor, alpha: Tensor, camera: Camera, *, rotate: float) -> Aimed:
    """See `kernels.shading.aiming.aim`; the camera's transform is of the dtype that is meant."""
    toward = -camera.ray_directions().flatten(0, 1)
    covered = alpha >= COVERED_ALPHA
    return Aimed(*(torch.where(covered, turn_directions(values, rotate), 0.0) for values in (toward, normal)))
