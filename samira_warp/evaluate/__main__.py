"""``samira-warp evaluate``, or ``python -m samira_warp.evaluate``: scores as one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

from samira_warp.evaluate.config import EvaluateConfig
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


def main(config: EvaluateConfig) -> None:
    """Score and print."""
    from samira_warp.data import open_listing
    from samira_warp.evaluate.evaluate import evaluate_images
    from samira_warp.evaluate.folders import find_comparisons, read_pairs, read_region_names
    from samira_warp.evaluate.lpips import find_lpips

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


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.evaluate") -> int:
    """The verb from its options to its exit status."""
    return run(main, EvaluateConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
