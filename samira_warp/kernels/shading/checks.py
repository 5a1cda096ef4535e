"""What deferred shading asks of its inputs: a kernel that reads past an array's end returns numbers, too."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import check_cubemap
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor, check_tensors
from samira_warp.surface import CHANNELS, Surface


def check_surface(surface: Surface, *, count: int | str = "M", device: torch.device | None = None) -> None:
    """Raise UserError unless every channel is (M, width) float32, all at as many points and on one device.

    Args:
        surface: What came.
        count: M, or a name for any number of points.
        device: The device expected, or None for any.
    """
    channels = [(name, getattr(surface, name), (count, channel.width)) for name, channel in CHANNELS.items()]
    check_tensors(*channels, device=device)


def check_light(irradiance: Tensor, mips: tuple[Tensor, ...], brdf: Tensor, *, device: torch.device) -> None:
    """Raise UserError unless a filtered light and the BRDF table are what `shade_gbuffer` asks for."""
    check_cubemap("irradiance", irradiance, channels=3, device=device)
    if not mips:
        raise UserError("mips", expected="at least one cubemap", found="none")
    for index, mip in enumerate(mips):
        check_cubemap(f"mips[{index}]", mip, channels=3, device=device)
    check_tensor("brdf", brdf, shape=("N", "N", 2), device=device)
    if len(brdf) < 2:
        raise UserError("brdf", expected="at least 2 rows and columns", found=tuple(brdf.shape))


def check_background(background: Tensor, *, count: int, device: torch.device) -> None:
    """Raise UserError unless a background is (count, 3) or, for all points, (1, 3) float32 on ``device``."""
    everywhere = isinstance(background, Tensor) and background.dim() == 2 and background.shape[0] == 1
    check_tensor("background", background, shape=(1 if everywhere else count, 3), device=device)
