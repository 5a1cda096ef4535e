"""What a finished run leaves: the avatar with its frames, and how it scores on the test frames."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

import samira_warp
from samira_warp.avatar import Avatar, DrivingFrame, write_frames
from samira_warp.data import PixelCache, TrackedSequence
from samira_warp.data.pixels import load_mask
from samira_warp.evaluate import ImagePair, evaluate_images
from samira_warp.evaluate.folders import read_frame_labels, read_region_names
from samira_warp.io.images import to_uint8
from samira_warp.train.begun import AVATAR_FOLDER
from samira_warp.train.perceptual import PerceptualDistances
from samira_warp.train.plan import TrainPlan
from samira_warp.train.settings import Settings
from samira_warp.train.trainer import Trainer

LIGHTS = Path(samira_warp.__file__).parent / "assets" / "lights"
"""Small environment maps that come with the package."""

ROWS = {
    "psnr": ("PSNR", "{:.2f} dB"),
    "psnr_foreground": ("PSNR of the foreground", "{:.2f} dB"),
    "psnr_gain": ("after a gain per channel", "{:.2f} dB"),
    "ssim": ("SSIM", "{:.4f}"),
    "l1": ("L1 x 100", "{:.3f}"),
    "lpips": ("LPIPS", "{:.4f}"),
}
"""Scores in the table, with their names and formats."""


@torch.no_grad()
def score(
    avatar: Avatar,
    sequence: TrackedSequence,
    pixels: PixelCache,
    *,
    plan: TrainPlan,
    distances: PerceptualDistances,
    regions: Path | None = None,
) -> dict[str, Any]:
    """Score the test frames in 8 bits against the truth, rendered with the parameters they came with.

    Args:
        avatar: At the end of its run.
        sequence: What it was trained on.
        pixels: The sequence's, at the run's resolution.
        plan: The run.
        distances: The perceptual ones.
        regions: Folder of label images, with their names: scores by region as well.

    Raises:
        UserError: A picture or its labels cannot be read.
    """
    light = avatar.light()

    def pairs() -> Iterator[ImagePair]:
        for index in sequence.test:
            frame = sequence.frames[index]
            camera = frame.camera.with_longer_side(plan.settings.resolution)
            size = {"width": camera.width, "height": camera.height}
            # an avatar that painted its light's shadows into the rest casts none under that light
            rendering = avatar.render(frame.parameters, camera, light, shadows=avatar.settings.visibility)
            prediction = torch.from_numpy(to_uint8(rendering.image.cpu().numpy())).float() / 255.0
            # not the cache's mask: at its 16 bits, pixels covered by exactly one half would count as
            # foreground
            mask = load_mask(frame, **size)
            labels = None if regions is None else read_frame_labels(regions, frame.name, **size)
            yield ImagePair(frame.name, prediction, pixels[index].image, mask=mask, labels=labels)

    protocol = {
        "split": f"test frames of --split {plan.settings.split}",
        **_sizes(plan),
        "bits": "8-bit predictions, box-resized truth",
        "parameters": "as tracked",
        "lpips_training": distances.learned_from,
    }
    names = None if regions is None else read_region_names(regions)
    return evaluate_images(pairs(), lpips=distances.scoring, region_names=names, protocol=protocol)


def _sizes(plan: TrainPlan) -> dict[str, Any]:
    """The ``size`` [W, H] of the images that are scored, or ``sizes`` where cameras are of several shapes."""
    sizes = [list(size) for size in plan.sizes]
    return {"size": sizes[0]} if len(sizes) == 1 else {"sizes": sizes}


def write_result(folder: Path, trainer: Trainer, record: dict[str, Any]) -> None:
    """Write the avatar with its frames: fine-tuned parameters where it trained, the tracker's elsewhere."""
    trainer.avatar.save(folder, record=record)
    frames = trainer.sequence.frames
    fitted = {
        index: trainer.tracked.frame(row, frames[index].parameters)
        for row, index in enumerate(trainer.sequence.train)
    }
    parts = [(index, "test") for index in trainer.sequence.test] + [
        (index, "train") for index in trainer.sequence.train
    ]
    driving = [
        DrivingFrame(
            frames[index].name,
            fitted.get(index, frames[index].parameters),
            trainer.camera(index),
            part,
        )
        for index, part in parts
    ]
    write_frames(folder, driving)


def summary(results: dict[str, Any], settings: Settings) -> str:
    """The end of a run in words: where the avatar is, a table of its scores, and what to do next.

    Args:
        results: As `score` gives them.
        settings: Of the run.
    """
    protocol = results["protocol"]
    sizes = protocol["sizes"] if "sizes" in protocol else [protocol["size"]]
    named = {
        name: format.format(results[key])
        for key, (name, format) in ROWS.items()
        if results.get(key) is not None
    }
    if results["lpips"] is None:
        named["LPIPS"] = f"none: {results['lpips_reason']}"
    column = max(map(len, named))
    return "\n".join(
        [
            f"the avatar is in {settings.out / AVATAR_FOLDER}; "
            f"on {len(results['frames'])} test frames of "
            f"{' or '.join(f'{width} x {height}' for width, height in sizes)}:",
            *(f"  {name:<{column}}  {value}" for name, value in named.items()),
            "next: its pictures, the same under another light, and their scores again, by any layer:",
            *(f"  {command}" for command in _next_commands(settings)),
        ]
    )


def _next_commands(settings: Settings) -> list[str]:
    """Commands that show and score the avatar, as a shell takes them."""
    out, data, split = (str(value) for value in (settings.out, settings.data, settings.split))
    pictures, relit = (str(settings.out / name) for name in ("render", "relit"))
    light = ("--env", str(LIGHTS / "dusk.hdr"), "--background", "env")
    calls = (
        ("render", "--avatar", out, "--out", pictures, "--layers", "image", "albedo", "normal", "--video"),
        ("render", "--avatar", out, "--out", relit, *light),
        ("evaluate", "--pred", str(Path(pictures, "image")), "--data", data, "--split", split),
    )
    return [shlex.join(("python", "-m", f"samira_warp.{verb}", *words)) for verb, *words in calls]
