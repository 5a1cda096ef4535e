"""A film on disk, as the fit reads it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from samira_warp.io.images import read_image, resize_box
from samira_warp.tracker.observed import View

AT_ONCE = 64
"""Pictures that are in float32 at once: of 192 x 192 pixels, 28 MB."""


@dataclass(frozen=True)
class Film:
    """Frames of one camera.

    Attributes:
        pictures: N files, all of the view's size.
        mattes: Their N coverages.
        view: The camera.
        rate: Frames a second.
        focal: What is known of the focal length, pixels.
    """

    pictures: tuple[Path, ...]
    mattes: tuple[Path, ...]
    view: View
    rate: float
    focal: float

    def size_at(self, side: int) -> tuple[int, int]:
        """(height, width) of the pictures with so many pixels along the longer side, never enlarged."""
        scale = min(side / max(self.view.width, self.view.height), 1.0)
        return max(round(self.view.height * scale), 1), max(round(self.view.width * scale), 1)

    def load(self, rows: Tensor, side: int) -> tuple[Tensor, Tensor]:
        """Some frames, and their mattes, small.

        Returns:
            (n, h, w, 3) and (n, h, w) uint8.

        Raises:
            UserError: A file cannot be read.
        """
        height, width = self.size_at(side)

        def small(path: Path, channels: Literal[1, 3]) -> np.ndarray:
            return to_bytes(resize_box(read_image(path, channels=channels), width=width, height=height))

        chosen = rows.tolist()
        pictures = np.stack([small(self.pictures[row], 3) for row in chosen])
        mattes = np.stack([small(self.mattes[row], 1).reshape(height, width) for row in chosen])
        return torch.from_numpy(pictures), torch.from_numpy(mattes)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Display values in 0..1 as bytes."""
    return np.rint(values * 255.0).clip(0, 255).astype(np.uint8)


def halved(pictures: Tensor) -> Tensor:
    """(n, h / 2, w / 2, 3) uint8 of (n, h, w, 3): the next level of a pyramid."""
    parts = []
    for some in pictures.split(AT_ONCE):
        small = torch.nn.functional.avg_pool2d(some.permute(0, 3, 1, 2).float(), 2, ceil_mode=True)
        parts.append(small.round().to(torch.uint8).permute(0, 2, 3, 1))
    return torch.cat(parts).contiguous()
