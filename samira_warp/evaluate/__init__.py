"""Scores: metrics, LPIPS, and the command that compares folders of images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.evaluate.config import EvaluateConfig
    from samira_warp.evaluate.evaluate import ImagePair, evaluate_images
    from samira_warp.evaluate.lpips import Lpips, find_lpips

__all__ = [
    "EvaluateConfig",
    "ImagePair",
    "Lpips",
    "evaluate_images",
    "find_lpips",
]

__getattr__ = lazily(
    __name__,
    {
        "EvaluateConfig": "config",
        "ImagePair": "evaluate",
        "Lpips": "lpips",
        "evaluate_images": "evaluate",
        "find_lpips": "lpips",
    },
)
