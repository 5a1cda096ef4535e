"""Environment maps in and out, the BRDF table, and deferred shading."""

from samira_warp.light.color import ColorSpace, compose, decode_srgb, encode_srgb, to_display
from samira_warp.light.environment import Environment
from samira_warp.light.equirect import equirect_directions
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.learnable import LearnableLight
from samira_warp.light.shading import Shaded, shade

__all__ = [
    "ColorSpace",
    "Environment",
    "FilteredLight",
    "LearnableLight",
    "Shaded",
    "compose",
    "decode_srgb",
    "encode_srgb",
    "equirect_directions",
    "shade",
    "to_display",
]
