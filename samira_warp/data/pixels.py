"""A frame's pixels at the resolution that is trained or scored."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.frames import FrameFiles
from samira_warp.data.mattes import read_matte
from samira_warp.io.images import composite_on_white, has_alpha, read_on_white, read_rgba, resize_box

BACKGROUND_TOLERANCE = 4.0 / 255.0
"""Uncovered pixels this close to one colour are an export's background; JPEG's rounding stays within it."""

UNCOVERED = 0.02
"""Coverage above the least of a matte by less than this is none: a network's sigmoid is that far from 0."""

MOST_FLOOR = 0.1
"""A matte whose least coverage is more than this shows no background: the head fills the frame."""


@dataclass(frozen=True, eq=False)
class FramePixels:
    """Pixels of one frame, all of one size.

    Attributes:
        image: (H, W, 3) float32 display values in 0..1, laid on white.
        mask: (H, W) float32 coverage in 0..1.
        albedo: (H, W, 3) float32 sRGB-encoded values as stored, None where the frame has none.
    """

    image: Tensor
    mask: Tensor
    albedo: Tensor | None

    def to(self, device: torch.device | str) -> FramePixels:
        """The same pixels on ``device``; out of page-locked memory nothing waits for the copy."""
        ahead = self.image.is_pinned()
        return self._each(lambda values: values.to(device, non_blocking=ahead))

    def pinned(self) -> FramePixels:
        """The same pixels in page-locked memory, which takes a GPU."""
        return self._each(Tensor.pin_memory)

    def _each(self, change: Callable[[Tensor], Tensor]) -> FramePixels:
        albedo = None if self.albedo is None else change(self.albedo)
        return FramePixels(change(self.image), change(self.mask), albedo)


def load_pixels(frame: FrameFiles, *, width: int, height: int) -> FramePixels:
    """Decode a frame, lay it on white in display values and box-resize it.

    Coverage is the mask file, at the image's size, else the image's alpha channel, else one everywhere. An
    image with an alpha channel is composited by it. Where a mask says that the scene is still behind the
    head, or the export's background, white takes its place (see ``on_white``).

    Args:
        frame: The frame.
        width: Width of the result, pixels.
        height: Height of the result, pixels.

    Raises:
        UserError: A file is missing or cannot be decoded, or a mask is none.
    """
    colour, mask = read_rgba(frame.image_path)
    if mask is not None:
        mask = _straight(frame, mask)
    colour = _straight(frame, colour)
    if mask is not None:
        colour = composite_on_white(colour, mask)
    if frame.mask_path is not None:
        mask = _straight(frame, read_matte(frame.mask_path))
        colour = on_white(colour, resize_box(mask, width=colour.shape[1], height=colour.shape[0]))
    if mask is None:
        mask = np.ones(colour.shape[:2], np.float32)
    albedo = None if frame.albedo_path is None else _straight(frame, read_on_white(frame.albedo_path))

    def at_size(array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(resize_box(array, width=width, height=height)))

    return FramePixels(at_size(colour), at_size(mask), None if albedo is None else at_size(albedo))


def load_mask(frame: FrameFiles, *, width: int, height: int) -> Tensor | None:
    """(H, W) float32 coverage in 0..1, box-resized: the mask file, else the image's alpha channel, else None.

    Raises:
        UserError: The file is missing or cannot be decoded, or is no mask.
    """
    path = frame.mask_path
    mask = read_rgba(frame.image_path)[1] if path is None else read_matte(path)
    if mask is None:
        return None
    mask = _straight(frame, mask)
    return torch.from_numpy(np.ascontiguousarray(resize_box(mask, width=width, height=height)))


def unmatted_albedos(frames: Iterable[FrameFiles]) -> list[FrameFiles]:
    """The frames that have a pseudo-albedo and neither a mask nor an alpha channel; no pixels are decoded.

    Albedo is compared inside a matte alone: without one it would be what is behind the head as well.

    Raises:
        UserError: A picture is missing or no image.
    """
    return [
        frame
        for frame in frames
        if frame.albedo_path is not None and frame.mask_path is None and not has_alpha(frame.image_path)
    ]


def read_picture(frame: FrameFiles) -> np.ndarray:
    """(H, W, 3) float32 display values of a frame's picture with what is behind the head, else on white.

    Raises:
        UserError: The file is missing or cannot be decoded.
    """
    return _straight(frame, read_on_white(frame.image_path))


def _straight(frame: FrameFiles, pixels: np.ndarray) -> np.ndarray:
    """A frame's file as a pinhole would show it."""
    return pixels if frame.lens is None else frame.lens.straightened(pixels, frame.camera)


def on_white(colour: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Replace what is behind the head in an opaque image by white.

    Where the uncovered pixels are all of one colour B, the image is m C + (1 - m) B, and adding (1 - m) (1 -
    B) is exact: an image already on white stays as it is. Otherwise the scene is still behind the head, and
    the mask is the only matte there is; the least coverage counts as none, since a network's mattes, a
    sigmoid as it comes, never quite reach 0.

    Args:
        colour: (H, W, 3) display values.
        mask: (H, W) coverage.
    """
    least = mask.min()
    if least > MOST_FLOOR:  # the head fills the frame
        return composite_on_white(colour, mask)
    uncovered = mask <= least + UNCOVERED
    outside = colour[uncovered]
    background = np.median(outside, axis=0)
    # the head's own share in such a pixel
    tolerance = BACKGROUND_TOLERANCE + mask[uncovered, None]
    if (np.abs(outside - background) > tolerance).any():
        return composite_on_white(colour, (mask - least) / (1.0 - least))
    if (background >= 1.0 - BACKGROUND_TOLERANCE - least).all():
        return colour
    return colour + (1.0 - mask[..., None]) * (1.0 - background)
