"""Changes to a finished avatar's materials, everywhere or in some regions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.head import REGIONS
from samira_warp.light import ColorSpace, decode_srgb
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, Channel, Surface


class Change(NamedTuple):
    """A material's values x become factor * x + offset: a gain has no offset, a fixed value no factor.

    Attributes:
        factor: One number, or one per colour channel.
        offset: As many; a colour's are display values.
    """

    factor: tuple[float, ...]
    offset: tuple[float, ...]


@dataclass(frozen=True)
class MaterialEdit:
    """What becomes of the materials of some regions; what is None stays as it is.

    One field a channel that the table of `samira_warp.surface` lets be edited.

    Attributes:
        roughness: "x0.5" multiplies, "0.3" sets, 0 to 1.
        specular: Reflectance at normal incidence, likewise; skin's is about 0.035.
        albedo: "x1.2" multiplies, "1.3,0.9,0.9" multiplies red, green and blue, "#c08060" paints with a
            colour.
        regions: Names out of `samira_warp.head.REGIONS`; none is everywhere. An edit fades over a region's
            border as its response to light does.

    Raises:
        UserError: A change is not of that form, or a region has another name.
    """

    roughness: str | None = None
    specular: str | None = None
    albedo: str | None = None
    regions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.changes()
        for region in self.regions:
            if region not in REGIONS:
                raise UserError("region", expected=f"one of {', '.join(REGIONS)}", found=repr(region))

    def changes(self) -> dict[str, Change]:
        """The changes by channel, those that are None left out."""
        return {
            name: _parse(name, text, channel)
            for name, channel in CHANNELS.items()
            if channel.edited is not None and (text := getattr(self, name)) is not None
        }


def edit_materials(
    surface: Surface,
    edits: Sequence[MaterialEdit],
    region_weights: Tensor,
    *,
    color_space: ColorSpace,
) -> Surface:
    """Apply edits one after the other.

    Results are clamped to their channel's range, so no surface reflects more light than meets it.

    Args:
        surface: Materials of N Gaussians.
        edits: What to change.
        region_weights: (N, K) shares of the regions in each Gaussian, 0 to 1.
        color_space: What colours are in: "srgb" decodes an edit's display values, "raw" takes them as they
            are.
    """
    for edit in edits:
        chosen = sorted({REGIONS.index(region) for region in edit.regions})
        weight = (
            region_weights[:, chosen].sum(dim=1, keepdim=True).clamp(max=1.0)
            if chosen
            else torch.ones_like(region_weights[:, :1])
        )
        for name, change in edit.changes().items():
            channel, before = CHANNELS[name], getattr(surface, name)
            factor, offset = before.new_tensor(change.factor), before.new_tensor(change.offset)
            if channel.edited == "color" and color_space == "srgb":
                offset = decode_srgb(offset)
            after = (factor * before + offset).clamp(channel.low, channel.high)
            surface = replace(surface, **{name: torch.lerp(before, after, weight)})
    return surface


def _parse(name: str, text: str, channel: Channel) -> Change:
    """The change of one channel that an option's text says."""
    if channel.edited == "color":
        return _parse_color(name, text)
    return _parse_number(name, text, channel)


def _parse_number(name: str, text: str, channel: Channel) -> Change:
    """x0.5 or 0.3."""
    expected = f"a factor such as x0.5, or a value from {channel.low:g} to {channel.high:g}"
    if text.startswith("x"):
        return Change((_number(name, text[1:], expected, found=text),), (0.0,))
    value = _number(name, text, expected, found=text, least=channel.low, most=channel.high)
    return Change((0.0,), (value,))


def _parse_color(name: str, text: str) -> Change:
    """#rrggbb, x1.2 or 1.3,0.9,0.9."""
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return Change((0.0,) * 3, tuple(value / 255.0 for value in bytes.fromhex(text[1:])))
    expected = "a colour #rrggbb, a factor such as x1.2, or factors red,green,blue"
    words = [text[1:]] * 3 if text.startswith("x") else text.split(",")
    if len(words) != 3:
        raise UserError(name, expected=expected, found=repr(text))
    return Change(tuple(_number(name, word, expected, found=text) for word in words), (0.0,) * 3)


def _number(
    name: str, word: str, expected: str, *, found: str, least: float = 0.0, most: float = math.inf
) -> float:
    """A finite number from ``least`` to ``most``."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not (least <= value <= most and math.isfinite(value)):
        raise UserError(name, expected=expected, found=repr(found))
    return value
