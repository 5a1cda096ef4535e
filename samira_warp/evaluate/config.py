"""Options of the evaluate verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Layer = Literal["image", "albedo", "normal"]
"""What images may show to be scored."""

LpipsNet = Literal["vgg", "alex"]
"""Backbones of LPIPS."""


@dataclass(frozen=True)
class EvaluateConfig:
    """Score 8-bit images against a dataset, and print one JSON object."""

    pred: Path
    """Folder of the predicted images, named as the dataset's, or an output folder of render."""

    data: Path
    """Folder of the dataset, for its pictures and masks."""

    split: str = "dataset"
    """Frames to score where no --truth is given: train or test (the dataset's own), a fraction, or last:N."""

    truth: Path | None = None
    """Folder of true images; all names in it are scored. Default: the dataset's pictures, or its gt/LAYER."""

    layer: Layer = "image"
    """What the images show. Normals are (n + 1) / 2 in world space, and are scored by angle."""

    regions: Path | None = None
    """Folder of label images, with their names in parse.json there or one folder up: scores by region as
    well."""

    lpips_weights: Path | None = None
    """Folder of the backbone's and the linear weights of LPIPS. Default: torch.hub's cache and an installed
    lpips package."""

    lpips_net: LpipsNet = "alex"
    """Backbone of LPIPS."""
