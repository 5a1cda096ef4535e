"""Scoring a set of images: per frame, averaged, over the foreground and by region."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from samira_warp.evaluate import metrics
from samira_warp.evaluate.config import Layer
from samira_warp.evaluate.lpips import SMALLEST_IMAGE, Lpips

PROTOCOL = {
    "psnr": f"dB over the whole frame, range 1, at most {metrics.PSNR_CAP:.0f}",
    "ssim": "whole frame, Gaussian window 11, sigma 1.5, range 1, borders reflected",
    "l1": "mean absolute difference over the whole frame x 100",
    "psnr_foreground": f"psnr over mask > {metrics.FOREGROUND}",
    "psnr_gain": f"psnr over mask > {metrics.FOREGROUND} after one least-squares gain per channel, "
    "in display values",
    "average": "mean over frames of each frame's score; a region's over the frames that show it",
    "background": "white",
}
"""How scores of images were computed; reported beside them."""


@dataclass(frozen=True)
class ImagePair:
    """A prediction and what it should be, of one size.

    Attributes:
        name: The frame's name.
        prediction: (H, W, 3) float32: display values in 0..1, or world-space normals.
        truth: (H, W, 3) float32 of the same kind.
        mask: (H, W) float32 coverage, None where the dataset has none.
        labels: (H, W) uint8 region labels, None without regions.
    """

    name: str
    prediction: Tensor
    truth: Tensor
    mask: Tensor | None = None
    labels: Tensor | None = None


@dataclass
class _Totals:
    """Sums of scores over the frames that have them."""

    sums: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)

    def add(self, scores: Mapping[str, float | None]) -> None:
        for name, score in scores.items():
            self.sums.setdefault(name, 0.0)
            self.counts.setdefault(name, 0)
            if score is not None:
                self.sums[name] += score
                self.counts[name] += 1

    def means(self) -> dict[str, float | None]:
        return {name: self.sums[name] / count if count else None for name, count in self.counts.items()}


def evaluate_images(
    pairs: Iterable[ImagePair],
    *,
    layer: Layer = "image",
    lpips: Lpips | str = "not asked for",
    region_names: Mapping[int, str] | None = None,
    protocol: Mapping[str, Any],
) -> dict[str, Any]:
    """Score predictions against the truth.

    Args:
        pairs: The images; only one pair is held at a time.
        layer: "normal" is scored by angle alone; "albedo" has its SSIM and L1 over the foreground too.
        lpips: The distance, or why there is none.
        region_names: Names of the labels, where pairs carry labels.
        protocol: What else to say about how the scores came about: split, size, 8-bit or float.

    Returns:
        What ``results.json`` and the command report: averages by name (None where no frame has the score),
        ``lpips_reason`` where a frame has no LPIPS, ``regions`` with averages by region, ``frames`` with
        scores by frame name, and ``protocol``.
    """
    distance, reason = (None, lpips) if isinstance(lpips, str) else (lpips, None)
    totals, region_totals = _Totals(), {name: _Totals() for name in (region_names or {}).values()}
    frames: dict[str, Any] = {}
    with torch.no_grad():
        for pair in pairs:
            small = min(pair.truth.shape[:2]) < SMALLEST_IMAGE
            if distance is not None and small:
                reason = f"images are smaller than {SMALLEST_IMAGE} pixels"
            tensors = (
                _score_normals(pair)
                if layer == "normal"
                else _score_image(pair, layer, None if small else distance)
            )
            scores = {name: _finite(score) for name, score in tensors.items()}
            totals.add(scores)
            frames[pair.name] = scores
            if region_names is not None and pair.labels is not None:
                frames[pair.name]["regions"] = _score_regions(pair, pair.labels, layer, region_names)
                for name, region_scores in frames[pair.name]["regions"].items():
                    region_totals[name].add(region_scores)
    result: dict[str, Any] = dict(totals.means())
    if layer != "normal" and reason is not None:
        result["lpips_reason"] = reason
    if region_names is not None:
        result["regions"] = {name: total.means() for name, total in region_totals.items() if total.counts}
    result["protocol"] = _protocol(layer, lpips, len(frames)) | dict(protocol)
    result["frames"] = frames
    return result


def _score_image(pair: ImagePair, layer: Layer, lpips: Lpips | None) -> dict[str, Tensor | None]:
    similarity = metrics.ssim_map(pair.prediction, pair.truth)
    scores: dict[str, Tensor | None] = {
        "psnr": metrics.psnr(pair.prediction, pair.truth),
        "ssim": similarity.mean(),
        "l1": metrics.l1(pair.prediction, pair.truth),
        "lpips": None if lpips is None else lpips(pair.prediction, pair.truth),
        "psnr_foreground": None,
        "psnr_gain": None,
    }
    if pair.mask is None:
        return scores
    inside = pair.mask > metrics.FOREGROUND
    scores["psnr_foreground"] = metrics.psnr_where(pair.prediction, pair.truth, inside)
    scores["psnr_gain"] = metrics.psnr_gain(pair.prediction, pair.truth, pair.mask)
    if layer == "albedo":
        scores["ssim_foreground"] = similarity[inside].mean()
        scores["l1_foreground"] = metrics.l1(pair.prediction[inside], pair.truth[inside])
    return scores


def _score_normals(pair: ImagePair) -> dict[str, Tensor | None]:
    mask = torch.ones_like(pair.truth[..., 0]) if pair.mask is None else pair.mask
    return {"normal_angle": metrics.normal_angle(pair.prediction, pair.truth, mask)}


def _score_regions(
    pair: ImagePair, labels: Tensor, layer: Layer, names: Mapping[int, str]
) -> dict[str, dict[str, float | None]]:
    """Scores over each label's pixels, for the labels that the frame shows."""
    shown = {name: where for label, name in names.items() if (where := labels == label).any()}
    if layer == "normal":
        angles = metrics.normal_angle_map(pair.prediction, pair.truth)
        return {name: {"normal_angle": _finite(angles[where].mean())} for name, where in shown.items()}
    similarity = metrics.ssim_map(pair.prediction, pair.truth)
    return {
        name: {
            "psnr": _finite(metrics.psnr_where(pair.prediction, pair.truth, where)),
            "ssim": _finite(similarity[where].mean()),
        }
        for name, where in shown.items()
    }


def _protocol(layer: Layer, lpips: Lpips | str, frame_count: int) -> dict[str, Any]:
    common = {"layer": layer, "frames": frame_count}
    if layer == "normal":
        return common | {
            "normal_angle": f"mean degrees over mask > {metrics.FOREGROUND}",
            "average": PROTOCOL["average"],
        }
    return (
        common
        | PROTOCOL
        | {"lpips_net": None if isinstance(lpips, str) else f"{lpips.net}, LPIPS v0.1, whole frame"}
    )


def _finite(score: Tensor | None) -> float | None:
    """A number that JSON can hold: None for an absent score and for the mean of nothing."""
    if score is None or not math.isfinite(value := score.item()):
        return None
    return value
