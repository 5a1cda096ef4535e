"""Scores: metrics, LPIPS, and the command that compares folders of images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.evaluate.evaluate import ImagePair, evaluate_images
    from samira_warp.evaluate.lpips import Lpips, find_lpips

__all__ = ["ImagePair", "Lpips", "evaluate_images", "find_lpips"]

__getattr__ = lazily(
    __name__,
    {"ImagePair": "evaluate", "evaluate_images": "evaluate", "Lpips": "lpips", "find_lpips": "lpips"},
)
