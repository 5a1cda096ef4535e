"""How large a picture may be: asked before the work on it begins."""

from __future__ import annotations

from typing import NoReturn

from samira_warp.support.errors import UserError

LARGEST_SIDE = 8192
"""Pixels along a rendered picture's longer side.

Its G-buffer is 4.25 GiB there, and shading makes several times as much of it. H.264's largest pictures end
there too (level 6.2), and float32 still places a Gaussian to a thousandth of a pixel.
"""

GBUFFER_BYTES = 68
"""Bytes of a pixel's G-buffer: float32 of the surface's ten numbers, the light's five, depth and coverage."""


def check_side(name: str, pixels: int) -> None:
    """Raise UserError unless square pictures of so many pixels a side can be rendered.

    Args:
        name: What asks for them, for the message.
        pixels: Their side.
    """
    if pixels < 1:
        raise UserError(name, expected="a positive number of pixels", found=pixels)
    if pixels > LARGEST_SIDE:
        _refuse(name, f"{pixels}", pixels * pixels)


def check_size(name: str, *, width: int, height: int) -> None:
    """Raise UserError unless pictures of a size can be rendered.

    Args:
        name: What asks for them, for the message.
        width: W, pixels.
        height: H, pixels.
    """
    if max(width, height) > LARGEST_SIDE:
        _refuse(name, f"{width} x {height}", width * height)


def _refuse(name: str, found: str, pixels: int) -> NoReturn:
    gigabytes = pixels * GBUFFER_BYTES / 2**30
    raise UserError(
        name,
        expected=f"at most {LARGEST_SIDE} pixels along the longer side",
        found=f"{found}, whose G-buffer alone is {gigabytes:,.0f} GiB",
    )
