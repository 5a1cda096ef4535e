"""Masks and mattes as programs write them, read as coverage.

Coverage is 0 where the scene is and 1 where the head is. Files hold it as grey of 8 or 16 bits or of floats,
as the alpha of a cut-out, as labels 0 and 1, or as two colours of a palette; what could mean several things
is refused, since a wrong matte trains the scene into the head.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.io.images import Channels, read_channels
from samira_warp.support.errors import UserError

OPAQUE = 254.0 / 255.0
"""An alpha channel that is nowhere below this says nothing of what is the head."""

_WHAT = "the head's coverage (grey from black to white, or the alpha of a cut-out)"

_LOSSY = (".jpg", ".jpeg", ".webp")
"""Their codes are no labels: compression makes others of them."""

_MOST_LABELS = 32
"""8-bit codes that are all below this are the labels of regions, or a mask that nobody could see."""

_COLOURED = 0.1
"""Channels that differ by more are a colour; compression makes less of grey."""

_PURE_SHARE = 0.8
"""Share of the pixels of a mask that are quite in or quite out, at least: the others are its edge."""


def read_matte(path: Path) -> np.ndarray:
    """Coverage (H, W) float32 in 0..1.

    Raises:
        UserError: The file is missing or cannot be decoded, or what it holds is not coverage: a picture in
            colours, labels of several regions, values out of range.
    """
    channels = read_channels(path)
    coverage = _cut_out(channels)
    if coverage is None:
        coverage = _scaled(_grey(channels, path), channels.full_scale, path)
    if not np.isfinite(coverage).all() or coverage.min() < 0.0 or coverage.max() > 1.0:
        found = f"values from {np.nanmin(coverage):g} to {np.nanmax(coverage):g}"
        raise UserError(path, expected=f"{_WHAT}, from 0 to 1", found=found)
    return coverage


def _cut_out(channels: Channels) -> np.ndarray | None:
    """The alpha of a file whose alpha says something, or which has nothing else; else None."""
    if "A" not in channels.names:
        return None
    alpha = channels.pixels[..., channels.names.index("A")]
    return alpha if len(channels.names) == 1 or alpha.min() < OPAQUE else None


def _grey(channels: Channels, path: Path) -> np.ndarray:
    """(H, W) values of a file's only colour, or of two colours of which one is black."""
    colour = channels.pixels[..., [index for index, name in enumerate(channels.names) if name != "A"]]
    if colour.shape[2] == 1:
        return colour[..., 0]
    if colour.shape[2] != 3:
        raise UserError(path, expected=_WHAT, found=f"channels {', '.join(channels.names)}")
    coloured = np.ptp(colour, axis=2) > _COLOURED
    if not coloured.any():
        return colour.mean(axis=2)
    black, other = np.zeros(3, np.float32), colour[coloured][0]
    is_other = (colour == other).all(axis=2)
    if not (is_other | (colour == black).all(axis=2)).all():
        found = f"a picture in colours, {coloured.mean():.0%} of it"
        raise UserError(path, expected=_WHAT, found=found)
    return is_other.astype(np.float32)


def _scaled(grey: np.ndarray, full_scale: int, path: Path) -> np.ndarray:
    """(H, W) coverage of values that were scaled by what the file's whole numbers could hold.

    Args:
        grey: Values of the file, of whole numbers divided by ``full_scale``.
        full_scale: The largest whole number, 0 of a floating-point file.
        path: The file.
    """
    if full_scale == 0 or path.suffix.lower() in _LOSSY or grey.max() == 0.0:
        return grey
    codes = np.rint(grey.astype(np.float64) * full_scale)
    largest = codes.max()
    if largest == 1.0:  # what an array of true and false becomes
        return codes.astype(np.float32)
    pure = np.count_nonzero((codes == 0.0) | (codes == largest)) >= _PURE_SHARE * codes.size
    if full_scale > 255 and largest == 255.0 and pure:  # 8 bits in a file of 16
        return (codes / 255.0).astype(np.float32)
    if full_scale == 255 and largest < _MOST_LABELS and len(np.unique(codes)) <= _MOST_LABELS:
        found = f"whole numbers from {codes.min():g} to {largest:g}, which may be labels of regions"
        raise UserError(path, expected=_WHAT, found=found)
    return grey
