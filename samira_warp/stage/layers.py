"""What can be looked at of a rendered frame, by name."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar import Rendering
from samira_warp.avatar.residual import POSITION_LIMIT
from samira_warp.avatar.wrinkles import SLOPE_LIMIT
from samira_warp.light import encode_srgb, to_display
from samira_warp.stage.layer_names import Layer
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.surface import CHANNELS


class LayerImage(NamedTuple):
    """One layer of one frame.

    Attributes:
        picture: (H, W, 3) or (H, W, 1) display values, for a PNG, which clips them to 0..1; with a straight
            alpha (H, W, 4).
        values: (H, W, C) physical values for an EXR, or None where the picture holds all there is.
    """

    picture: Tensor
    values: Tensor | None = None


def layer_image(rendering: Rendering, layer: Layer, *, transparent: bool = False) -> LayerImage:
    """Turn one layer into a picture.

    A channel of the surface is drawn as its table says: albedo in display values on white; normals as
    (n + 1) / 2 in world space on mid-grey; responses 0.95 to 1.05 as 0 to 1, likewise, and specular 0 to 0.1
    on white, both of which come with their values, since they may be beyond. Depth runs from white (nearest)
    to black; irradiance and specular light are sRGB-encoded and come with their linear values; residuals are
    UV maps in metres and radians, their pictures mid-grey at zero and full scale at the residual's limit.

    Args:
        rendering: The frame.
        layer: Its name.
        transparent: Leave out what is behind the head, be it background, white or grey: the colours are those
            of the head alone, not multiplied by its alpha, which is the fourth channel. Only for layers that
            are laid on something (`can_be_transparent`).
    """
    g, motion = rendering.gbuffer, rendering.motion
    alpha = g.alpha
    if layer == "image":
        return LayerImage(_with_alpha(rendering.foreground, alpha) if transparent else rendering.image)
    if layer == "alpha":
        return LayerImage(alpha)
    if layer in CHANNELS:
        picture, behind = _channel_picture(rendering, layer)
        laid = _with_alpha(picture, alpha) if transparent else _on(behind, picture, alpha)
        return LayerImage(laid, None if CHANNELS[layer].scale is None else getattr(g, layer))
    if layer == "depth":
        return LayerImage(_depth_picture(g.depth, alpha), g.depth)
    if layer in ("irradiance", "specular_light"):
        values = getattr(rendering, layer)
        picture = encode_srgb(values)
        laid = _with_alpha(picture, alpha) if transparent else _on(1.0, picture, alpha)
        return LayerImage(laid, values * (alpha > 0.0))
    values, limit = {
        "residual_position": (motion.residual_position, POSITION_LIMIT),
        "residual_rotation": (motion.residual_rotation, torch.pi),
        # two slopes on red and green
        "wrinkles": (torch.nn.functional.pad(motion.slopes, (0, 1)), SLOPE_LIMIT),
    }[layer]
    return LayerImage(0.5 + 0.5 * values / limit, values)


def can_be_transparent(layer: Layer) -> bool:
    """Whether a layer shows the head on something that can be left out."""
    return layer in ("image", *CHANNELS, "irradiance", "specular_light")


def _channel_picture(rendering: Rendering, name: str) -> tuple[Tensor, float]:
    """A channel of the surface as `Channel.drawn` says, straight, and the grey that is behind it."""
    channel, values = CHANNELS[name], getattr(rendering.gbuffer, name)
    if channel.drawn == "color":
        return to_display(values, color_space=rendering.color_space), 1.0
    low, high = channel.scale or (channel.low, channel.high)
    behind = {"amount": 1.0, "balance": 0.5}[channel.drawn]
    if channel.scale is not None:  # what is beyond it is no brighter at the head's edge than within
        values = values.clamp(low, high)
    return (values - low) / (high - low), behind


def _on(background: float, picture: Tensor, alpha: Tensor) -> Tensor:
    """Composite a picture on a grey."""
    return alpha * picture + (1.0 - alpha) * background


def _with_alpha(picture: Tensor, alpha: Tensor) -> Tensor:
    """(H, W, 4) a straight picture (H, W, 1 or 3) and its coverage; black where nothing is."""
    covered = (alpha >= COVERED_ALPHA) * picture
    return torch.cat([covered.expand(*alpha.shape[:2], 3), alpha], dim=-1)


def _depth_picture(depth: Tensor, alpha: Tensor) -> Tensor:
    """White at the nearest surface, black at the farthest and where nothing is."""
    surface = alpha > 0.5
    near, far = (
        (depth[surface].aminmax()) if bool(surface.any()) else (depth.new_zeros(()), depth.new_ones(()))
    )
    return torch.where(surface, 1.0 - (depth - near) / (far - near).clamp(min=1e-6), 0.0)
