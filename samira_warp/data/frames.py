"""A tracked sequence: its frames, what is known of each, and which of them train."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from samira_warp.camera import Camera
from samira_warp.data.split import Split
from samira_warp.head.model import FrameParameters
from samira_warp.head.template import HeadTemplate


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """One picture of a sequence and the files that belong to it.

    Attributes:
        name: The image file's stem, which outputs are named by.
        timestep: Index of the moment, shared by all cameras that saw it.
        image_path: The picture, laid on a background of one colour or with an alpha channel.
        mask_path: The head's coverage, None where the dataset has none.
        albedo_path: The estimated albedo as display values, None where the frame has none.
        parameters_path: The tracked parameters.
        camera: The view at the image file's own size.
    """

    name: str
    timestep: int
    image_path: Path
    mask_path: Path | None
    albedo_path: Path | None
    parameters_path: Path
    camera: Camera


@dataclass(frozen=True, eq=False)
class Frame(FrameFiles):
    """A picture with its tracked parameters, which were read and checked."""

    parameters: FrameParameters


@dataclass(frozen=True, eq=False)
class Listing:
    """The pictures of a dataset and how they are divided; no parameters were read.

    Attributes:
        root: The dataset's folder.
        split: How the frames were divided.
        frames: All frames, by timestep, then by name.
        train: Indices into ``frames``.
        test: Indices into ``frames``; none is in ``train``.
    """

    root: Path
    split: Split
    frames: tuple[FrameFiles, ...]
    train: tuple[int, ...]
    test: tuple[int, ...]

    @property
    def selected(self) -> tuple[int, ...]:
        """The part that the split names: indices into ``frames``."""
        return self.train if self.split.part == "train" else self.test


@dataclass(frozen=True, eq=False)
class Sequence(Listing):
    """A tracked head: all that training and rendering need but the pixels.

    Attributes:
        frames: As in Listing, with parameters.
        shape: (n_shape,) float32 identity coefficients, the same for every frame.
        template: The head model that was tracked.
        template_path: Where it was read.
        canonical_static_offset: (V, 3) float32 metres, None where the export has none; frames that repeat it share its memory.
    """

    frames: tuple[Frame, ...]
    shape: torch.Tensor
    template: HeadTemplate
    template_path: Path
    canonical_static_offset: torch.Tensor | None
