"""Which channels of a light file are its colours, told by their names.

Renderers put many passes into one OpenEXR file: as parts with names, each with channels of its own, or as
channels whose names have the layer before a dot (diffuse.R). A layer whose name says that it is no light
(normals, depth, ids) is never taken for one; of those that remain, the whole picture goes before one that
says nothing of itself, and that before a share of the light (diffuse, reflections).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses

from samira_warp.support.errors import UserError

_WHOLE = re.compile("rgba|rgb|beauty|combined|colou?r|composite|image|final|main|default|master|ci?")
"""Words for the whole picture."""

_SHARE = re.compile(
    "diff|diffuse|spec|specular|gloss|glossy|dir|direct|ind|indirect|emit|emission|emissive|sss|subsurface|"
    "trans|transmission|transmissive|coat|sheen|volume|reflect|reflection|refract|refraction|gi|shadows?|"
    "caustics"
)
"""Words for a share of the light."""

_NO_LIGHT = re.compile(
    "n|ng|ns|p|pos|z|uvs?|ids?|ao|masks?|alpha|index|samples|error|mist|.*(normal|position|depth|motion|"
    "velocity|vector|crypto|matte|albedo|occlusion|roughness|tangent|variance).*"
)
"""Words for what is no light."""

_COLORS = {"r": 0, "g": 1, "b": 2, "red": 0, "green": 1, "blue": 2}
_GREYS = ("y", "l", "luminance", "grey", "gray")
"""What the channels of colours are called, and the one of a picture that has none."""

_SECOND_VIEW = "right"
"""The view of a stereo pair that the other goes before."""

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


class ColorLayer(NamedTuple):
    """A layer of colours.

    Attributes:
        part: The number of its part in the file.
        channels: The numbers of its red, green and blue channels in the part; of a grey picture, its one.
        name: Its part's name and its own; empty where neither has one.
        others: The names of the file's other layers of colours.
    """

    part: int
    channels: tuple[int, ...]
    name: str
    others: tuple[str, ...]


class _Candidate(NamedTuple):
    part: int
    channels: tuple[int, ...]
    name: str
    rank: tuple[int, ...]


def color_layer(image: oiio.ImageInput, path: Path) -> ColorLayer:
    """The layer of an open file that is its picture.

    Raises:
        UserError: It has none, or several that their names do not tell apart.
    """
    parts = list(_parts(image))
    candidates = [layer for part, spec in enumerate(parts) for layer in _candidates(part, spec)]
    if not candidates:
        found = "; ".join(filter(None, (_described(spec) for spec in parts)))
        raise UserError(path, expected="channels R, G, B or a single one, of light", found=found)
    candidates.sort(key=lambda layer: layer.rank)
    best = candidates[0]
    rivals = [layer.name for layer in candidates if layer.rank == best.rank]
    if len(rivals) > 1 and best.rank[0] > 0:
        expected = "one layer whose name tells that it is the picture (rgba, beauty, combined)"
        raise UserError(path, expected=expected, found=", ".join(rivals))
    return ColorLayer(best.part, best.channels, best.name, tuple(layer.name for layer in candidates[1:]))


def _parts(image: oiio.ImageInput) -> Iterator[oiio.ImageSpec]:
    """The headers of a file's parts, its first where the format has no others."""
    count = image.spec().get_int_attribute("oiio:subimages", 1) if image.format_name() == "openexr" else 1
    for part in range(count):
        yield image.spec(part)


def _candidates(part: int, spec: oiio.ImageSpec) -> Iterator[_Candidate]:
    """The layers of a part that may be light."""
    layers: dict[str, dict[str, int]] = {}
    for number, channel in enumerate(spec.channelnames):
        layer, _, component = channel.rpartition(".")
        layers.setdefault(layer, {})[component.lower()] = number
    for layer, components in layers.items():
        colors = {_COLORS[name]: number for name, number in components.items() if name in _COLORS}
        grey = _grey(components, alone=len(layers) == 1)
        channels = tuple(number for _, number in sorted(colors.items())) if len(colors) == 3 else grey
        name = ".".join(filter(None, (_part_name(spec), layer)))
        rank = _rank(
            ".".join((name, *_telling(components, channels))), view=spec.get_string_attribute("view")
        )
        if channels and rank is not None and spec.get_string_attribute("colorInteropID") != "data":
            yield _Candidate(part, channels, name, (*rank, 3 - len(channels)))


def _grey(components: dict[str, int], *, alone: bool) -> tuple[int, ...]:
    """The channel of brightness of a layer without colours: named so, or the only one that a file has."""
    if not {"x", "ry", "by"} & set(components):  # of vectors, and of colours as luminance and chroma
        named = tuple(number for name, number in components.items() if name in _GREYS)
        if len(named) == 1:
            return named
    rest = tuple(number for name, number in components.items() if name not in ("a", "alpha"))
    return rest if alone and len(rest) == 1 else ()


def _telling(components: dict[str, int], channels: tuple[int, ...]) -> list[str]:
    """Names of the chosen channels that say more than which colour they are, or that they are brightness."""
    return [
        name
        for name, number in components.items()
        if number in channels and name not in _COLORS and name not in _GREYS
    ]


def _rank(name: str, *, view: str) -> tuple[int, int, int] | None:
    """The less, the more a layer is the picture; None where it is no light.

    Whether it is the whole, unknown or a share; whether it is a second view; how much else its name says.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    if any(map(_NO_LIGHT.fullmatch, words)):
        return None
    second = int(_SECOND_VIEW in (view.lower(), *words))
    if any(map(_SHARE.fullmatch, words)):
        return 2, second, 0
    more = [word for word in words if not _WHOLE.fullmatch(word)]
    return (1, second, 0) if words and len(more) == len(words) else (0, second, len(more))


def _part_name(spec: oiio.ImageSpec) -> str:
    return spec.get_string_attribute("oiio:subimagename")


def _described(spec: oiio.ImageSpec) -> str:
    name, channels = _part_name(spec), ", ".join(spec.channelnames)
    return f"{name}: {channels}" if name else channels
