"""Scores: metrics, LPIPS, and the command that compares folders of images."""

from samira_warp.evaluate.evaluate import ImagePair, evaluate_images
from samira_warp.evaluate.lpips import Lpips, find_lpips

__all__ = ["ImagePair", "Lpips", "evaluate_images", "find_lpips"]
