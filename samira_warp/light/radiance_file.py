"""Radiance as a light file's header means it: upright, whole, in Rec. 709's primaries, finite, at least 0.

Rows are decoded in blocks and written where they belong, so that a large map costs little more than itself.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import torch
from torch import Tensor

from samira_warp.io.decoding import decode_blocks, layout_of, opened, orientation_of
from samira_warp.io.images import holds_floats
from samira_warp.io.orientation import LYING, as_stored
from samira_warp.io.radiance_header import RadianceHeader, read_radiance_header
from samira_warp.light.color import decode_srgb
from samira_warp.light.color_layer import ColorLayer, color_layer
from samira_warp.light.primaries import NAMED, to_rec709
from samira_warp.support.errors import UserError

HALF_MAX = 65504.0
"""The largest half float: a sun that was brighter has become infinite in a file of them, and is taken for
this."""

MOST_INFINITE = 0.01
"""Share of a map's values that may be infinite: the sun and its glow cover a thousandth of the sphere."""

_LINEAR = frozenset(["", "unknown", "linear", "scene_linear", "lin_rec709", "rec709"])
"""What files call linear Rec. 709, or say nothing with, in lower case."""

logger = logging.getLogger(__name__)


@dataclass
class _Oddities:
    """Values that are no radiance, counted over the blocks of a map."""

    total: int = 0
    infinite: int = 0
    none: int = 0
    negative: int = 0
    least: float = 0.0


@dataclass(frozen=True)
class _Conversion:
    """From stored values to radiance.

    Attributes:
        linear: Whether stored values are linear; else they are decoded from sRGB.
        matrix: (3, 3) float32 that takes linear values to Rec. 709, None where they are already.
    """

    linear: bool
    matrix: np.ndarray | None
    oddities: _Oddities = field(default_factory=_Oddities)

    def radiance(self, values: np.ndarray) -> np.ndarray:
        """(h, w, 3) radiance of a block of stored values, which are counted and may be overwritten."""
        if not self.linear:
            return decode_srgb(torch.from_numpy(np.ascontiguousarray(values))).numpy()
        odd = self.oddities
        odd.total += values.size
        least, most = values.min(initial=0.0), values.max(initial=0.0)
        if not np.isfinite(least + most):
            infinite = values == np.inf
            odd.infinite += int(np.count_nonzero(infinite))
            odd.none += int(np.count_nonzero(np.isnan(values) | (values == -np.inf)))
            values = np.nan_to_num(values, nan=0.0, posinf=HALF_MAX, neginf=0.0)
            least = values.min(initial=0.0)
        if least < 0.0:
            odd.negative += int(np.count_nonzero(values < 0.0))
            odd.least = min(odd.least, float(least))
        if self.matrix is not None:
            values = values @ self.matrix.T
        return np.maximum(values, 0.0, out=values)


def read_radiance(path: Path, *, ldr: bool) -> Tensor:
    """Read the colours of a light file.

    The picture is the display window, black where nothing is stored. Of several parts and layers the one is
    taken whose name says that it is the picture. Primaries other than Rec. 709's are converted, white staying
    white; a Radiance file's EXPOSURE and COLORCORR are divided out, and its pixels brought into the usual
    order. Infinite values, up to `MOST_INFINITE` of all, become `HALF_MAX`, negative ones 0, which is said.

    Args:
        path: A floating-point file (.hdr, .exr).
        ldr: Also take files of whole numbers (.jpg, .png), decoded from sRGB.

    Returns:
        (H, W, 3) float32 linear radiance, at least 0.

    Raises:
        UserError: The file is missing, cut short, of whole numbers without ``ldr``, has no colours or none
            that can be told from others, is encoded in a way that is not known, or holds values that are not
            numbers.
    """
    with opened(path, whole=True) as image:
        layer = color_layer(image, path)
        conversion = _conversion(image, layer, path, ldr=ldr)
        texels = _decoded(image, layer, path, conversion)
    _judge(conversion.oddities, path)
    if layer.others:
        name, others = layer.name or "the layer without a name", ", ".join(filter(None, layer.others))
        logger.warning("%s: the light is %s, not %s", path, name, others or "another view")
    return torch.from_numpy(texels)


def _decoded(image: oiio.ImageInput, layer: ColorLayer, path: Path, conversion: _Conversion) -> np.ndarray:
    """(H, W, 3) float32, upright."""
    layout = layout_of(image, path, part=layer.part)
    orientation = orientation_of(image, path, part=layer.part)
    size = (layout.width, layout.height) if orientation in LYING else (layout.height, layout.width)
    texels = np.zeros((*size, 3), np.float32)
    stored = as_stored(texels, orientation)
    channels = range(min(layer.channels), max(layer.channels) + 1)
    picked = [channel - channels.start for channel in layer.channels] * (3 // len(layer.channels))
    rows, columns = layout.rows, layout.columns
    for start, block in decode_blocks(image, path, part=layer.part, channels=channels):
        first, end = max(start, rows.stored.start), min(start + len(block), rows.stored.stop)
        if first < end:
            values = block[first - start : end - start, columns.stored]
            if picked != list(range(len(channels))):
                values = values.take(picked, axis=2)
            shift = rows.picture.start - rows.stored.start
            stored[first + shift : end + shift, columns.picture] = conversion.radiance(values)
    return texels


def _conversion(image: oiio.ImageInput, layer: ColorLayer, path: Path, *, ldr: bool) -> _Conversion:
    """What the header says of the layer's values.

    Raises:
        UserError: They are whole numbers without ``ldr``, or encoded in a way that is not known.
    """
    spec = image.spec(layer.part)
    if not holds_floats(spec):
        if ldr:
            return _Conversion(False, None)
        raise UserError(
            path,
            expected="floating-point radiance (.hdr or .exr), because an 8-bit image clips the lamps and "
            "the sun that light a face (--ldr takes it as it is)",
            found="whole numbers",
        )
    if image.format_name() == "hdr":
        return _Conversion(True, _radiance_matrix(read_radiance_header(path), path))
    chromaticities = spec.getattribute("chromaticities")
    matrix = _named_matrix(spec, path) if chromaticities is None else _matrix(chromaticities, path)
    return _Conversion(True, None if matrix is None else matrix.astype(np.float32))


def _radiance_matrix(header: RadianceHeader, path: Path) -> np.ndarray | None:
    """What undoes a Radiance file's gains, and converts its primaries; None where there is nothing to do."""
    if header.gamma != 1.0:
        raise UserError(path, expected="linear radiance", found=f"GAMMA={header.gamma:g} in its header")
    matrix = None if header.primaries is None else _matrix(header.primaries, path)
    if (header.gain == 1.0).all():
        return None if matrix is None else matrix.astype(np.float32)
    return ((np.eye(3) if matrix is None else matrix) / header.gain).astype(np.float32)


def _named_matrix(spec: oiio.ImageSpec, path: Path) -> np.ndarray | None:
    name = spec.get_string_attribute("colorInteropID")
    if not name and spec.get_int_attribute("oiio:subimages", 1) == 1:  # of several, it is the first one's
        name = spec.get_string_attribute("oiio:ColorSpace")
    if name in NAMED:
        return to_rec709(NAMED[name])
    if name.lower() in _LINEAR:
        return None
    raise UserError(path, expected="linear radiance of known primaries", found=f"the colour space {name}")


def _matrix(chromaticities: tuple[float, ...], path: Path) -> np.ndarray | None:
    try:
        return to_rec709(chromaticities)
    except ValueError as error:
        stated = ", ".join(f"{number:g}" for number in chromaticities)
        raise UserError(path, expected="primaries of colours", found=f"{error}: {stated}") from error


def _judge(odd: _Oddities, path: Path) -> None:
    """Refuse a map of values that no light has, and say what was taken for something else."""
    if odd.none or odd.infinite > MOST_INFINITE * odd.total:
        found = f"{odd.none + odd.infinite} of {odd.total} values that are infinite or not numbers"
        raise UserError(path, expected="finite radiance", found=found)
    if odd.infinite:
        logger.warning(
            "%s: %d of %d values are infinite, as half floats beyond %g are, and taken for that",
            path,
            odd.infinite,
            odd.total,
            HALF_MAX,
        )
    if odd.negative:
        logger.warning(
            "%s: %d of %d values are negative, down to %.3g, and taken for 0",
            path,
            odd.negative,
            odd.total,
            odd.least,
        )
