"""What can be looked at of a rendered frame, by name."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar import Rendering
from samira_warp.avatar.residual import POSITION_LIMIT
from samira_warp.light import encode_srgb, to_display
from samira_warp.stage.layer_names import Layer
from samira_warp.surface import CHANNELS


class LayerImage(NamedTuple):
    """One layer of one frame.

    Attributes:
        picture: (H, W, 3) or (H, W, 1) display values in 0..1, for a PNG.
        values: (H, W, C) physical values for an EXR, or None where the picture holds all there is.
    """

    picture: Tensor
    values: Tensor | None = None


def layer_image(rendering: Rendering, layer: Layer) -> LayerImage:
    """Turn one layer into a picture.

    A channel of the surface is drawn as its table says: albedo in display values on white; normals as
    (n + 1) / 2 in world space on mid-grey; responses 0.5 to 1.5 as 0 to 1, likewise. Depth runs from white
    (nearest) to black; irradiance and specular light are sRGB-encoded and come with their linear values;
    residuals are UV maps in metres and radians, their pictures mid-grey at zero and full scale at the
    residual's limit.

    Args:
        rendering: The frame.
        layer: Its name.
    """
    g, motion = rendering.gbuffer, rendering.motion
    alpha = g.alpha
    if layer == "image":
        return LayerImage(rendering.image)
    if layer == "alpha":
        return LayerImage(alpha)
    if layer in CHANNELS:
        return LayerImage(_channel_picture(rendering, layer))
    if layer == "depth":
        return LayerImage(_depth_picture(g.depth, alpha), g.depth)
    if layer in ("irradiance", "specular_light"):
        values = getattr(rendering, layer)
        return LayerImage(_on(1.0, encode_srgb(values), alpha), values * (alpha > 0.0))
    values, limit = {
        "residual_position": (motion.residual_position, POSITION_LIMIT),
        "residual_rotation": (motion.residual_rotation, torch.pi),
    }[layer]
    return LayerImage(0.5 + 0.5 * values / limit, values)


def _channel_picture(rendering: Rendering, name: str) -> Tensor:
    """A channel of the surface as `Channel.drawn` says."""
    channel, values, alpha = CHANNELS[name], getattr(rendering.gbuffer, name), rendering.gbuffer.alpha
    if channel.drawn == "color":
        return _on(1.0, to_display(values, color_space=rendering.color_space), alpha)
    behind = {"amount": 1.0, "balance": 0.5}[channel.drawn]
    return _on(behind, (values - channel.low) / (channel.high - channel.low), alpha)


def _on(background: float, picture: Tensor, alpha: Tensor) -> Tensor:
    """Composite a picture on a grey."""
    return alpha * picture + (1.0 - alpha) * background


def _depth_picture(depth: Tensor, alpha: Tensor) -> Tensor:
    """White at the nearest surface, black at the farthest and where nothing is."""
    surface = alpha > 0.5
    near, far = (
        (depth[surface].aminmax()) if bool(surface.any()) else (depth.new_zeros(()), depth.new_ones(()))
    )
    return torch.where(surface, 1.0 - (depth - near) / (far - near).clamp(min=1e-6), 0.0)
