"""Changes to a finished avatar's materials, everywhere or in some regions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch

from samira_warp.avatar.gbuffer import SurfaceAttributes
from samira_warp.head import REGIONS
from samira_warp.light import ColorSpace, decode_srgb
from samira_warp.support.errors import UserError


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
        """The changes by material, those that are None left out."""
        parsers = {"roughness": _parse_scalar, "specular": _parse_scalar, "albedo": _parse_albedo}
        return {
            name: parse(name, text)
            for name, parse in parsers.items()
            if (text := getattr(self, name)) is not None
        }


def edit_materials(
    surface: SurfaceAttributes,
    edits: Sequence[MaterialEdit],
    region_weights: torch.Tensor,
    *,
    color_space: ColorSpace,
) -> SurfaceAttributes:
    """Apply edits one after the other; results are clamped to 0..1, so no surface reflects more light than
    meets it.

    Args:
        surface: Materials of N Gaussians.
        edits: What to change.
        region_weights: (N, K) shares of the regions in each Gaussian, 0 to 1.
        color_space: What albedo is in: "srgb" decodes a colour's display values, "raw" takes them as they
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
            before = getattr(surface, name)
            factor, offset = before.new_tensor(change.factor), before.new_tensor(change.offset)
            if name == "albedo" and color_space == "srgb":
                offset = decode_srgb(offset)
            after = (factor * before + offset).clamp(0.0, 1.0)
            surface = surface._replace(**{name: torch.lerp(before, after, weight)})
    return surface


def _parse_scalar(name: str, text: str) -> Change:
    """x0.5 or 0.3."""
    expected = "a factor such as x0.5, or a value from 0 to 1"
    if text.startswith("x"):
        return Change((_number(name, text[1:], expected, found=text),), (0.0,))
    return Change((0.0,), (_number(name, text, expected, found=text, most=1.0),))


def _parse_albedo(name: str, text: str) -> Change:
    """#rrggbb, x1.2 or 1.3,0.9,0.9."""
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return Change((0.0,) * 3, tuple(value / 255.0 for value in bytes.fromhex(text[1:])))
    expected = "a colour #rrggbb, a factor such as x1.2, or factors red,green,blue"
    words = [text[1:]] * 3 if text.startswith("x") else text.split(",")
    if len(words) != 3:
        raise UserError(name, expected=expected, found=repr(text))
    return Change(tuple(_number(name, word, expected, found=text) for word in words), (0.0,) * 3)


def _number(name: str, word: str, expected: str, *, found: str, most: float = math.inf) -> float:
    """A finite number from 0 to ``most``."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not (0.0 <= value <= most and math.isfinite(value)):
        raise UserError(name, expected=expected, found=repr(found))
    return value
