"""Names of what can be looked at of a rendered frame, for those that offer them without drawing any."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

from samira_warp.surface import CHANNELS

if TYPE_CHECKING:
    Layer: TypeAlias = str
else:
    Layer = Literal[
        "image",
        *CHANNELS,
        "alpha",
        "depth",
        "irradiance",
        "specular_light",
        "residual_position",
        "residual_rotation",
        "wrinkles",
    ]
"""What `samira_warp.stage.layers.layer_image` draws. The channels of a surface come from their table, which a
type checker cannot follow."""
