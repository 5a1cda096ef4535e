"""Environment maps in and out, light rigs, the BRDF table, and deferred shading."""

from samira_warp.light.color import ColorSpace, compose, decode_srgb, encode_srgb, to_display
from samira_warp.light.environment import Environment as Environment  # public as samira_warp.Environment
from samira_warp.light.equirect import equirect_directions
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.lamps import AreaLight, DirectionalLight, PointLight
from samira_warp.light.learnable import LearnableLight
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.light.rig import LightRig
from samira_warp.light.shading import Shaded, shade
from samira_warp.light.tone import filmic

__all__ = [
    "AreaLight",
    "ColorSpace",
    "DirectionalLight",
    "FilteredLight",
    "LearnableLight",
    "LightRig",
    "PointLight",
    "RadianceMap",
    "Shaded",
    "compose",
    "decode_srgb",
    "encode_srgb",
    "equirect_directions",
    "filmic",
    "shade",
    "to_display",
]
