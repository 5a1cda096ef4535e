"""From linear radiance to display values: the sRGB curve and compositing."""

from __future__ import annotations

from typing import Literal

import torch

ColorSpace = Literal["srgb", "raw"]
"""What image values mean: "srgb" is the encoded sRGB of linear shading, "raw" the shading itself."""

_LINEAR_END = 0.0031308
"""Below this linear value the curve is a line (IEC 61966-2-1)."""

_LINE_SLOPE = 12.92


def encode_srgb(linear: torch.Tensor) -> torch.Tensor:
    """Linear values of any shape to sRGB display values. Not clipped: 1 and above go on along the curve, negative ones along its line."""
    curved = linear.clamp(min=_LINEAR_END)
    return torch.where(linear <= _LINEAR_END, _LINE_SLOPE * linear, 1.055 * curved ** (1 / 2.4) - 0.055)


def decode_srgb(display: torch.Tensor) -> torch.Tensor:
    """Inverse of `encode_srgb`."""
    end = _LINE_SLOPE * _LINEAR_END
    curved = display.clamp(min=end)
    return torch.where(display <= end, display / _LINE_SLOPE, ((curved + 0.055) / 1.055) ** 2.4)


def compose(
    foreground: torch.Tensor, alpha: torch.Tensor, background: torch.Tensor, *, exposure: float = 1.0, color_space: ColorSpace = "srgb"
) -> torch.Tensor:
    """Eq. alpha_compose in display values: I = alpha encode(C_fg exposure) + (1 - alpha) background.

    Args:
        foreground: (..., 3) linear C_fg, not premultiplied.
        alpha: (..., 1) coverage.
        background: (..., 3) display values, or anything that broadcasts to them.
        exposure: Factor on the linear foreground.
        color_space: "srgb" encodes the foreground; "raw" takes its values for display values.

    Returns:
        (..., 3) display values, not clipped.
    """
    exposed = foreground * exposure
    display = encode_srgb(exposed) if color_space == "srgb" else exposed
    return alpha * display + (1 - alpha) * background
