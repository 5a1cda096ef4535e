"""The perceptual distances of a run: the one that it learns from, and the one that it is scored by."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch

from samira_warp.evaluate import Lpips, find_lpips
from samira_warp.evaluate.lpips import SMALLEST_IMAGE, LpipsNet
from samira_warp.train.config import PresetName
from samira_warp.train.plan import TrainPlan, check_size

TRAINING_LPIPS: dict[PresetName, LpipsNet] = {"cpu": "alex", "paper": "vgg"}
"""VGG at 256 x 256 is 120 GFLOP a step, too much for two cores."""

SCORING_LPIPS: LpipsNet = "alex"
"""What other works' tables are of."""


class PerceptualDistances(NamedTuple):
    """Each a distance, or why there is none.

    Attributes:
        training: A term of the objective.
        scoring: Of the test frames.
    """

    training: Lpips | str
    scoring: Lpips | str

    @classmethod
    def find(cls, preset: PresetName, weights: Path | None) -> PerceptualDistances:
        """Those whose weights are in a folder, or where they are usually kept."""
        return cls(*(find_lpips(net, weights) for net in (TRAINING_LPIPS[preset], SCORING_LPIPS)))

    def at_sizes(self, plan: TrainPlan) -> PerceptualDistances:
        """Those that can be taken of a run's images.

        Raises:
            UserError: The images are too small for SSIM.
        """
        smallest = min(plan.sizes, key=min)
        check_size(smallest, resolution=plan.settings.resolution)
        if min(smallest) >= SMALLEST_IMAGE:
            return self
        reason = f"images are smaller than {SMALLEST_IMAGE} pixels"
        return PerceptualDistances(reason, reason)

    def to(self, device: torch.device | str) -> PerceptualDistances:
        """The same on ``device``."""
        return PerceptualDistances(
            *(distance.to(device) if isinstance(distance, Lpips) else distance for distance in self)
        )

    @property
    def learned_from(self) -> str | None:
        """The network of the objective's term; None where there is no such term."""
        return self.training.net if isinstance(self.training, Lpips) else None
