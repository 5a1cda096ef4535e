"""What an avatar is made of, beside its head and its Gaussians."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from samira_warp.nets import MotionSettings


@dataclass(frozen=True)
class AvatarSettings:
    """What an avatar is made of; saved with it.

    Attributes:
        uv_size: Width and height of the UV maps.
        motion: Sizes and variants of the motion network.
        residual: Refine mesh binding by the motion network (Eq. final_motion).
        response: Learn semantic response factors; False keeps tau = 1.
        displacement_frame: "head" removes the head joint's motion from D_uv; "world" is the literal Eq.
            uv_displacement.
        residual_frame: Axes of the residual: "world" is Eq. final_motion; "head" turns with the head joint.
        color_space: "srgb" shades in linear light and encodes; "raw" shades in image values.
        tied_light: The learned light is one map for diffuse and specular light, instead of two.
        visibility: The head blocked its learned light while it was learned; False has painted the shadows
            that it cast into the rest.
        smoothing: Standard deviation, metres, of the smoothing of every Gaussian in space: no detail is
            finer than what training could see (Mip-Splatting's 3D filter).
    """

    uv_size: int = 256
    motion: MotionSettings = field(default_factory=MotionSettings)
    residual: bool = True
    response: bool = True
    displacement_frame: Literal["head", "world"] = "head"
    residual_frame: Literal["world", "head"] = "world"
    color_space: Literal["srgb", "raw"] = "srgb"
    tied_light: bool = False
    visibility: bool = True
    smoothing: float = 0.0
