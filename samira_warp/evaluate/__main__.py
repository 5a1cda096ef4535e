"""``python -m samira_warp.evaluate``: scores a folder of images and prints one JSON object."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from samira_warp.data import open_listing
from samira_warp.evaluate.evaluate import evaluate_images
from samira_warp.evaluate.folders import find_comparisons, read_pairs, read_region_names
from samira_warp.evaluate.lpips import LpipsNet, find_lpips
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


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

    layer: Literal["image", "albedo", "normal"] = "image"
    """What the images show. Normals are (n + 1) / 2 in world space, and are scored by angle."""

    regions: Path | None = None
    """Folder of label images, with their names in parse.json there or one folder up: scores by region as
    well."""

    lpips_weights: Path | None = None
    """Folder of the backbone's and the linear weights of LPIPS. Default: torch.hub's cache and an installed
    lpips package."""

    lpips_net: LpipsNet = "alex"
    """Backbone of LPIPS."""


def main(config: EvaluateConfig) -> None:
    """Score and print."""
    listing = open_listing(config.data, split=config.split)
    truth = config.truth
    if truth is None and config.layer != "image":
        truth = config.data / "gt" / config.layer
        if not truth.is_dir():
            raise UserError(
                truth, expected=f"the dataset's true {config.layer}, or --truth DIR", found="neither"
            )
    region_names = None if config.regions is None else read_region_names(config.regions)
    comparisons = find_comparisons(
        listing, predictions=config.pred, truth=truth, layer=config.layer, regions=config.regions
    )
    result = evaluate_images(
        read_pairs(comparisons, layer=config.layer),
        layer=config.layer,
        lpips="normals are scored by angle"
        if config.layer == "normal"
        else find_lpips(config.lpips_net, config.lpips_weights),
        region_names=region_names,
        protocol={
            "split": config.split if truth is None else f"all images of {truth}",
            "truth": f"{config.data if truth is None else truth}, box-resized to the prediction's size",
            "bits": "8-bit files",
        },
    )
    json.dump(result, sys.stdout, indent=1, allow_nan=False)
    print()


if __name__ == "__main__":
    sys.exit(run(main, EvaluateConfig, program="python -m samira_warp.evaluate"))
