"""The last result of each stage of a picture, made anew where what it comes of has changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from torch import Tensor

from samira_warp.avatar import GBuffer, Motion, Occlusion, Rendering
from samira_warp.light.radiance_map import RadianceMap

Made = TypeVar("Made")


class Kept(Generic[Made]):
    """One result, and the key of what it was made of."""

    def __init__(self) -> None:
        self._key: Any = None
        self._made: Made | None = None

    def holds(self, key: tuple[Any, ...]) -> bool:
        """Whether the result of ``key`` is there."""
        return self._made is not None and self._key == key

    def get(self, key: tuple[Any, ...], make: Callable[[], Made]) -> Made:
        """The result of ``key``: what is kept, or else what ``make`` gives, which is kept from now on.

        Nothing is kept of a ``make`` that fails.
        """
        if self._made is None or not self.holds(key):
            self._key, self._made = None, None  # two results of one stage need not be held at once
            self._made = make()
            self._key = key
        return self._made


@dataclass(frozen=True, eq=False)
class Stages:
    """What is kept of one picture of one browser.

    Attributes:
        motion: The moved Gaussians, by avatar and pose.
        occlusion: Which directions the head blocks, likewise.
        shares: What of the diffuse light arrives, by what is blocked and the light as it is turned.
        lobes: What of glints is open, by what is blocked and the place that they are seen from.
        surface: A G-buffer, by these, the camera and the materials, under any light.
        lit: The same under the light, by the light as it is turned, and whether it casts shadows.
        backdrop: What is seen of a light behind the head, by the light.
        rendering: The shaded picture, by all of these and the light.
    """

    motion: Kept[Motion] = field(default_factory=Kept)
    occlusion: Kept[Occlusion] = field(default_factory=Kept)
    shares: Kept[Tensor] = field(default_factory=Kept)
    lobes: Kept[Tensor] = field(default_factory=Kept)
    surface: Kept[GBuffer] = field(default_factory=Kept)
    lit: Kept[GBuffer] = field(default_factory=Kept)
    backdrop: Kept[RadianceMap | None] = field(default_factory=Kept)
    rendering: Kept[Rendering] = field(default_factory=Kept)
