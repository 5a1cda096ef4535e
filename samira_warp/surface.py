"""What a visible surface is made of, said once: the table of channels.

Gaussians carry a value of every channel, the rasteriser blends them, the G-buffer names what it blended,
shading reads it, layers draw it and edits change it: all of them follow this table, and so does the
specification in `samira_warp.reference`. Reading the table loads neither torch nor Warp.

Some channels are the surface's own; others say what of the light gets there past the rest of the head. Those
are neutral until a light is chosen (`avatar.gbuffer.blend_arrival`).

A channel is added in three places: here; where it comes from, `Avatar.surface` or `avatar.occlusion`; and
where it is used, a parameter of its name in the kernels of `samira_warp.kernels.shading.deferred` and their
twin in `reference`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, get_args

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["CHANNELS", "Channel", "Surface"]


Blend = Literal["mean", "direction"]
"""What several Gaussians in one pixel come to: their weighted mean, or the direction of that mean, a unit
vector in world space."""


@dataclass(frozen=True)
class Channel:
    """One quantity of a surface, and what becomes of it on its way to a picture.

    Attributes:
        width: Numbers per point: 1, or 3 for a colour or a direction.
        low: The least value; where edits stop.
        high: The greatest value, likewise.
        blend: What several Gaussians in one pixel come to.
        drawn: How its layer shows it: a "color" as display values on white, an "amount" from black to white
            on white, a "balance" likewise on the grey between them.
        scale: The values at which a picture of it is black and white, where most of its range is never
            reached; None is from low to high.
        edited: What a `MaterialEdit` may set it to, a "number" or a "color"; None cannot be edited.
        neutral: The value that leaves the shading as it is, for a surface that has none of its own; None has
            to be given.
        of: Whether it is the surface's own, or says what of the light arrives.
    """

    width: Literal[1, 3]
    low: float = 0.0
    high: float = 1.0
    blend: Blend = "mean"
    drawn: Literal["color", "amount", "balance"] = "amount"
    scale: tuple[float, float] | None = None
    edited: Literal["number", "color"] | None = None
    neutral: float | None = None
    of: Literal["surface", "light"] = "surface"


@dataclass(frozen=True, eq=False)
class Surface:
    """Every channel, (..., width) float32, of the same points: Gaussians, or pixels, or points to be shaded.

    The fields are the table. Their order is that of the features which the rasteriser blends and of the
    parameters of the shading kernels.
    """

    albedo: Annotated["Tensor", Channel(3, drawn="color", edited="color")]
    """Linear diffuse reflectance a."""
    normal: Annotated["Tensor", Channel(3, -1.0, 1.0, blend="direction", drawn="balance")]
    """Unit normals n in world space; zero where a pixel shows nothing."""
    roughness: Annotated["Tensor", Channel(1, edited="number")]
    """Perceptual roughness rho; its square is GGX's alpha."""
    specular: Annotated["Tensor", Channel(1, scale=(0.0, 0.1), edited="number")]
    """Reflectance f at normal incidence; skin's is about 0.035."""
    response_diffuse: Annotated[
        "Tensor", Channel(1, 0.5, 1.5, drawn="balance", scale=(0.95, 1.05), neutral=1.0)
    ]
    """Factor tau^d on the diffuse light (Eq. response_shading); what is learned is a few per cent from 1."""
    response_specular: Annotated[
        "Tensor", Channel(1, 0.5, 1.5, drawn="balance", scale=(0.95, 1.05), neutral=1.0)
    ]
    """Factor tau^s on the specular light."""
    visibility: Annotated["Tensor", Channel(3, neutral=1.0, of="light")]
    """Share of the diffuse light that no other part of the head blocks, by colour."""
    visibility_specular: Annotated["Tensor", Channel(1, neutral=1.0, of="light")]
    """Share of the reflected lobe that is not blocked."""
    ambient_occlusion: Annotated["Tensor", Channel(1, neutral=1.0, of="light")]
    """Share o of a uniform sky that is not blocked, weighted by the cosine; 1 is in the open. What is blocked
    returns light, from surfaces as bright as this one: E = v E_0 + a (1 - o) E, so that light that bounces
    between them makes it E = v E_0 / (1 - a (1 - o))."""

    @classmethod
    def of(cls, **channels: "Tensor") -> "Surface":
        """The surface of some channels, (..., width) each, and the neutral values of those that are left out.

        Raises:
            TypeError: A channel without a neutral value is missing, or there is none of that name.
        """
        given = next(iter(channels.values()))
        for name, channel in CHANNELS.items():
            if name not in channels and channel.neutral is not None:
                channels[name] = given.new_full((*given.shape[:-1], channel.width), channel.neutral)
        return Surface(**channels)

    def channels(self) -> "dict[str, Tensor]":
        """The channels by name, in the table's order."""
        return {name: getattr(self, name) for name in CHANNELS}

    def map(self, function: "Callable[[Tensor], Tensor]", *, blend: Blend | None = None) -> "Surface":
        """The surface with a function of every channel, or only of those that blend so.

        Of a G-buffer that is its surface alone.
        """
        return Surface(
            **{
                name: function(values) if blend in (None, CHANNELS[name].blend) else values
                for name, values in self.channels().items()
            }
        )


CHANNELS: dict[str, Channel] = {
    name: channel for name, hint in Surface.__annotations__.items() for _, channel in [get_args(hint)]
}
"""The table: every channel of `Surface` by name, in order."""

SURFACE_CHANNELS = [name for name, channel in CHANNELS.items() if channel.of == "surface"]
"""Those of the surface itself, by name."""

LIGHT_CHANNELS = [name for name, channel in CHANNELS.items() if channel.of == "light"]
"""Those that say what of a light arrives."""

SURFACE_WIDTH = sum(CHANNELS[name].width for name in SURFACE_CHANNELS)
"""Numbers of a point's own channels together."""

LIGHT_WIDTH = sum(CHANNELS[name].width for name in LIGHT_CHANNELS)
"""Numbers that say what of a light arrives there."""
