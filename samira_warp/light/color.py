"""From linear radiance to display values: the tone map, the sRGB curve and compositing."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from samira_warp.kernels.shading.display import CURVE_OFFSET, CURVE_POWER, CURVE_SCALE, LINE_SLOPE, LINEAR_END
from samira_warp.light.tone import filmic
from samira_warp.support.errors import UserError
from samira_warp.support.tone_names import ToneMap

ColorSpace = Literal["srgb", "raw"]
"""What image values mean: "srgb" is the encoded sRGB of linear shading, "raw" the shading itself."""


LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""


def encode_srgb(linear: Tensor) -> Tensor:
    """Linear values of any shape to sRGB display values.

    Not clipped: 1 and above go on along the curve, negative ones along its line.
    """
    curved = linear.clamp(min=LINEAR_END)
    return torch.where(
        linear <= LINEAR_END, LINE_SLOPE * linear, CURVE_SCALE * curved**CURVE_POWER - CURVE_OFFSET
    )


def decode_srgb(display: Tensor) -> Tensor:
    """Inverse of `encode_srgb`."""
    end = LINE_SLOPE * LINEAR_END
    curved = display.clamp(min=end)
    return torch.where(
        display <= end, display / LINE_SLOPE, ((curved + CURVE_OFFSET) / CURVE_SCALE) ** (1 / CURVE_POWER)
    )


def to_display(values: Tensor, *, color_space: ColorSpace, tone_map: ToneMap = "none") -> Tensor:
    """What shading works in, as a picture shows it.

    Encoded where that is linear light ("srgb"), after the tone map, which is for radiance and not for
    albedo; as it is where it is image values ("raw").

    Raises:
        UserError: A tone map is asked for image values.
    """
    if tone_map != "none":
        if color_space != "srgb":
            raise UserError("tone_map", expected="none where shading works in image values", found=tone_map)
        values = filmic(values)
    return encode_srgb(values) if color_space == "srgb" else values


def compose(
    foreground: Tensor,
    alpha: Tensor,
    background: Tensor | float,
    *,
    color_space: ColorSpace = "srgb",
    tone_map: ToneMap = "none",
) -> Tensor:
    """Eq. alpha_compose in display values: I = alpha encode(C_fg) + (1 - alpha) background.

    Args:
        foreground: (..., 3) linear C_fg, not premultiplied.
        alpha: (..., 1) coverage.
        background: (..., 3) display values, or what broadcasts to them.
        color_space: "srgb" encodes the foreground; "raw" takes its values for display values.
        tone_map: What becomes of the foreground before it is encoded.

    Returns:
        (..., 3) display values; those of the foreground are clipped by a tone map alone.

    Raises:
        UserError: A tone map is asked for image values.
    """
    shown = to_display(foreground, color_space=color_space, tone_map=tone_map)
    return alpha * shown + (1 - alpha) * background
