"""Refit a trained avatar's light and materials in several ways, and score how each relights.

usage: python tools/compare_light.py --avatar DIR --data DIR [--steps N] [--only NAME ...] [--json]

Geometry, motion and normals stay those of the avatar; light, albedo, roughness, reflectance and response
factors start over as in training and are fitted to the training frames again, once a variant. Each is then
scored on the test frames under the capture light and under the dataset's true relit frames, as
`tools/relight_table.py` does.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
from relight_table import AvatarPrediction, at_size, matte_of, pairs, read_lights
from torch import Tensor

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.gaussians import (
    ROUGHNESS_RANGE,
    SKIN_ROUGHNESS,
    SKIN_SPECULAR,
    SPECULAR_RANGE,
    range_logits,
)
from samira_warp.avatar.storage import TEMPLATE_FILE, find_avatar, read_record
from samira_warp.data import PixelCache, TrackedSequence, open_sequence
from samira_warp.evaluate import evaluate_images
from samira_warp.io.images import read_image
from samira_warp.kernels.gathering.gather import gather
from samira_warp.light import LearnableLight, decode_srgb
from samira_warp.light.color import ColorSpace
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.train.initialize import initial_albedo
from samira_warp.train.losses import Known, LossWeights, Target, linear_albedo, total_loss
from samira_warp.train.schedule import learning_rate
from samira_warp.train.setup import PIXEL_CACHE_BYTES

REFITTED = ("albedo_logits", "roughness_logits", "specular_logits")
"""The Gaussians' parameters that start over."""


@dataclass(frozen=True)
class Variant:
    """One way to fit light and materials; the defaults are training's.

    Attributes:
        tied: One map for diffuse and specular light.
        color_space: What shading works in.
        response: Learn response factors.
        response_prior: Weight of the prior on their logits.
        roughness: Least and greatest roughness, inside the range that training has.
        specular: Least and greatest reflectance, likewise.
    """

    tied: bool = False
    color_space: ColorSpace = "srgb"
    response: bool = True
    response_prior: float = LossWeights().response
    roughness: tuple[float, float] = ROUGHNESS_RANGE
    specular: tuple[float, float] = SPECULAR_RANGE


VARIANTS = {
    "as trained": Variant(),
    "tied light": Variant(tied=True),
    "raw": Variant(color_space="raw"),
    "no response": Variant(response=False),
    "no response, tied light": Variant(response=False, tied=True),
    "no response prior": Variant(response_prior=0.0),
    "response prior 0.1": Variant(response_prior=0.1),
    "roughness 0.3 to 1": Variant(roughness=(0.3, 1.0)),
    "roughness 0.5": Variant(roughness=(0.5, 0.5)),
    "specular 0.028 to 0.045": Variant(specular=(0.028, 0.045)),
    "specular 0.035": Variant(specular=(0.035, 0.035)),
}


@dataclass(frozen=True)
class CompareConfig:
    """Refit a trained avatar's light and materials in several ways, and score how each relights."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """The avatar's dataset, with gt/relight and gt/capture_light.json."""
    steps: int = 500
    """Steps of each fit, one training frame a step."""
    resolution: int = 256
    """Width and height of the images, pixels."""
    only: tuple[str, ...] = field(default_factory=lambda: tuple(VARIANTS))
    """The variants to fit, by name."""
    json: bool = False
    """Print JSON rows instead of a table."""


def main(config: CompareConfig) -> None:
    """Fit and score every variant; one row each, as soon as it is known."""
    unknown = [name for name in config.only if name not in VARIANTS]
    if unknown:
        raise UserError("--only", expected=f"some of {', '.join(VARIANTS)}", found=", ".join(unknown))
    sequence = _open_own(config)
    rows = []
    with PixelCache(sequence.frames, resolution=config.resolution, max_bytes=PIXEL_CACHE_BYTES) as pixels:
        for name in config.only:
            avatar = _fit(config, VARIANTS[name], sequence, pixels)
            scores = _score(config, avatar, sequence)
            rows.append({"variant": name, **scores, "settings": asdict(VARIANTS[name])})
            if not config.json:
                _print_row({"variant": name, **scores}, header=len(rows) == 1)
    if config.json:
        print(json.dumps(rows))


def _open_own(config: CompareConfig) -> TrackedSequence:
    """The dataset, divided as it was for training.

    Raises:
        UserError: It is not the one that the avatar was trained on.
    """
    folder = find_avatar(config.avatar)
    split = read_record(folder).get("split", "dataset")
    sequence = open_sequence(config.data, split=split, flame=folder / TEMPLATE_FILE)
    trained_on = {frame.name for frame in read_frames(folder) if frame.part == "train"}
    strange = [
        sequence.frames[index].name
        for index in sequence.train
        if sequence.frames[index].name not in trained_on
    ]
    if strange:
        raise UserError(
            config.data,
            expected="the dataset that the avatar was trained on",
            found=f"{strange[0]}, new to it",
        )
    return sequence


def _print_row(row: dict[str, str | float], *, header: bool) -> None:
    if header:
        print("| " + " | ".join(row) + " |\n|" + "---|" * len(row))
    print(
        "| "
        + " | ".join(value if isinstance(value, str) else f"{value:.2f}" for value in row.values())
        + " |",
        flush=True,
    )


def _fit(config: CompareConfig, variant: Variant, sequence: TrackedSequence, pixels: PixelCache) -> Avatar:
    """The avatar with light and materials fitted anew."""
    avatar = _start_over(Avatar.load(config.avatar), variant, sequence, pixels)
    groups = {
        "light": list(avatar.light.parameters()),
        **{name: [getattr(avatar.gaussians, name)] for name in REFITTED},
    }
    if variant.response:
        groups["response"] = [avatar.response_logits]
    optimizer = torch.optim.Adam(
        [{"params": values, "name": name} for name, values in groups.items()], lr=0.0, eps=1e-15, fused=True
    )
    weights = LossWeights(
        response=variant.response_prior,
        normal_smoothness=0.0,
        normal_prior=0.0,
        materials=0.0,
        materials_contrast=0.0,
        residual=0.0,
        mask=0.0,
    )
    known = Known.of(avatar)
    frames = {frame.name: frame for frame in read_frames(config.avatar) if frame.part == "train"}
    generator = torch.Generator().manual_seed(0)
    for step in range(config.steps):
        index = sequence.train[int(torch.randint(len(sequence.train), (1,), generator=generator))]
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(group["name"], step=step, steps=config.steps)
        optimizer.zero_grad(set_to_none=True)
        frame, target = frames[sequence.frames[index].name], _target(pixels, index, variant)
        _loss(avatar, frame, target, weights, known).backward()
        optimizer.step()
        _hold_ranges(avatar, variant)
    return avatar.requires_grad_(False)


def _start_over(avatar: Avatar, variant: Variant, sequence: TrackedSequence, pixels: PixelCache) -> Avatar:
    """Initial light and materials on the avatar's geometry."""
    avatar.requires_grad_(False)
    avatar.settings = replace(
        avatar.settings, color_space=variant.color_space, tied_light=variant.tied, response=variant.response
    )
    displayed = initial_albedo(
        sequence, pixels, avatar.canonical, torch.full((*avatar.canonical.atlas.valid.shape, 3), 0.5)
    )
    albedo = decode_srgb(displayed) if variant.color_space == "srgb" else displayed
    gaussians = avatar.gaussians
    sampled = gather(albedo.flatten(0, 1).contiguous(), avatar.uv_samples)
    gaussians.albedo_logits.copy_(torch.logit(sampled.clamp(0.01, 0.99)))
    _set_range(gaussians.roughness_logits, SKIN_ROUGHNESS, ROUGHNESS_RANGE)
    _set_range(gaussians.specular_logits, SKIN_SPECULAR, SPECULAR_RANGE)
    avatar.response_logits.zero_()
    avatar.light = LearnableLight(torch.ones(3), tied=variant.tied)
    for name in REFITTED:
        getattr(gaussians, name).requires_grad_(True)
    avatar.response_logits.requires_grad_(variant.response)
    _hold_ranges(avatar, variant)
    return avatar


def _loss(avatar: Avatar, frame: DrivingFrame, target: Target, weights: LossWeights, known: Known) -> Tensor:
    height, width = target.image.shape[:2]
    rendering = avatar.render(frame.parameters, frame.camera.resized(width=width, height=height))
    terms = total_loss(rendering, target, avatar, weights, known, stage_two=True, perceptual=None)
    return torch.stack(list(terms.values())).sum()


def _target(pixels: PixelCache, index: int, variant: Variant) -> Target:
    content = pixels[index]
    albedo = (
        None if content.albedo is None else linear_albedo(content.albedo, color_space=variant.color_space)
    )
    return Target(content.image, content.mask, albedo, content.image.new_ones(3))


@torch.no_grad()
def _hold_ranges(avatar: Avatar, variant: Variant) -> None:
    """Keep roughness and reflectance inside the variant's ranges."""
    gaussians = avatar.gaussians
    for logits, bounds, whole in (
        (gaussians.roughness_logits, variant.roughness, ROUGHNESS_RANGE),
        (gaussians.specular_logits, variant.specular, SPECULAR_RANGE),
    ):
        shares = ((torch.tensor(bounds) - whole[0]) / (whole[1] - whole[0])).clamp(0.0, 1.0)
        low, high = torch.logit(shares).tolist()
        logits.clamp_(low, high)


@torch.no_grad()
def _set_range(logits: Tensor, value: float, whole: tuple[float, float]) -> None:
    logits.copy_(range_logits(torch.full_like(logits, value), whole))


@torch.no_grad()
def _score(config: CompareConfig, avatar: Avatar, sequence: TrackedSequence) -> dict[str, float]:
    """PSNR of the test frames under the learned light and under each true light.

    With their mean without the capture light, and the albedo's.
    """
    scores: dict[str, float] = {}
    learned = AvatarPrediction(avatar, avatar.light())
    for light in read_lights(config.data):
        if light.name == "capture":
            scores["learned light"] = evaluate_images(
                pairs(sequence, light, learned, resolution=config.resolution), protocol={}
            )["psnr"]
        predict = AvatarPrediction(avatar, light.environment.filtered())
        scores[light.name] = evaluate_images(
            pairs(sequence, light, predict, resolution=config.resolution), protocol={}
        )["psnr"]
    others = [score for name, score in scores.items() if name not in ("learned light", "capture")]
    return {
        **scores,
        "mean relit": sum(others) / len(others),
        "albedo": _albedo_score(config, avatar, sequence),
    }


def _albedo_score(config: CompareConfig, avatar: Avatar, sequence: TrackedSequence) -> float:
    """PSNR of every tenth test frame's albedo against gt/albedo, inside the matte."""
    errors = []
    for frame in [sequence.frames[index] for index in sequence.test[::10]]:
        truth = at_size(
            read_image(config.data / "gt" / "albedo" / f"{frame.name}.png", channels=3), config.resolution
        )
        inside = matte_of(frame, config.resolution) > 0.95
        camera = frame.camera.resized(width=config.resolution, height=config.resolution)
        albedo = avatar.render(frame.parameters, camera).albedo
        errors.append((albedo[inside] - truth[inside]).square().mean())
    return float(-10.0 * torch.log10(torch.stack(errors).mean()))


if __name__ == "__main__":
    sys.exit(run(main, CompareConfig, program="python tools/compare_light.py"))
