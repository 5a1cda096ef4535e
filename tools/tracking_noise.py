"""Tell what tracking noise costs an avatar.

Test frames are rendered with the tracker's and with the true parameters, and both are scored.

usage: python tools/tracking_noise.py --avatar DIR --data DIR [--every N]

The dataset brings gt/exact_parameters.npz (what its frames were rendered with) and gt/parse. One row for the
tracker's parameters, one with the true rigid motion (translation, rotation, neck), one with everything true:
what is left in the last row is the avatar's own error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from samira_warp.avatar import Avatar
from samira_warp.data import Frame, TrackedSequence, load_pixels, open_sequence
from samira_warp.data.joints import FLAME_KEYS
from samira_warp.evaluate import ImagePair, evaluate_images
from samira_warp.evaluate.folders import read_region_names
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.head.joints import known_names
from samira_warp.io.images import read_labels, resize_nearest
from samira_warp.support.cli import run

RIGID = ("translation", "rotation", "neck_pose")
ALL = (*RIGID, "eyes_pose", "expr")
"""The head's parameters by their names in the dataset's file."""


@dataclass(frozen=True)
class NoiseConfig:
    """Tell what tracking noise costs an avatar."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/exact_parameters.npz and gt/parse."""
    every: int = 5
    """Take every so many test frames."""
    resolution: int = 256
    """Width and height of the comparison, pixels."""


@torch.no_grad()
def main(config: NoiseConfig) -> None:
    """One row a set of true parameters."""
    avatar, sequence = Avatar.load(config.avatar), open_sequence(config.data)
    names = read_region_names(config.data / "gt" / "parse")
    truth = dict(np.load(config.data / "gt" / "exact_parameters.npz"))
    print(
        "| parameters | PSNR | foreground | "
        + " | ".join(names.values())
        + " |\n|"
        + "---|" * (3 + len(names))
    )
    for title, keys in (("the tracker's", ()), ("true rigid motion", RIGID), ("all true", ALL)):
        pairs = _pairs(config, avatar, sequence, {key: truth[key] for key in keys})
        scores = evaluate_images(pairs, region_names=names, protocol={})
        values = [
            scores["psnr"],
            scores["psnr_foreground"],
            *(scores["regions"][name]["psnr"] for name in names.values()),
        ]
        print(f"| {title} | " + " | ".join(f"{value:.2f}" for value in values) + " |")


def _pairs(
    config: NoiseConfig, avatar: Avatar, sequence: TrackedSequence, truth: dict[str, np.ndarray]
) -> Iterator[ImagePair]:
    light, size = avatar.light(), {"width": config.resolution, "height": config.resolution}
    for index in sequence.test[:: config.every]:
        frame: Frame = sequence.frames[index]
        values = {key: torch.tensor(rows[frame.timestep]).float() for key, rows in truth.items()}
        exact = _with_truth(frame.parameters, sequence.template, values)
        rendering = avatar.render(exact, frame.camera.resized(**size), light)
        pixels = load_pixels(frame, **size)
        labels = resize_nearest(read_labels(config.data / "gt" / "parse" / f"{frame.name}.png"), **size)
        yield ImagePair(
            frame.name,
            rendering.image.clamp(0.0, 1.0),
            pixels.image,
            mask=pixels.mask,
            labels=torch.from_numpy(labels),
        )


def _with_truth(
    parameters: FrameParameters, template: HeadTemplate, truth: dict[str, torch.Tensor]
) -> FrameParameters:
    """The parameters with the true values in the place of those that are known."""
    rotations, joints = parameters.rotations.clone(), known_names(template.joint_names)
    for key in FLAME_KEYS.keys() & truth.keys():
        rotations[[joints.index(name) for name in FLAME_KEYS[key]]] = truth[key].view(-1, 3)
    return replace(
        parameters,
        rotations=rotations,
        translation=truth.get("translation", parameters.translation),
        expression=truth.get("expr", parameters.expression),
    )


if __name__ == "__main__":
    sys.exit(run(main, NoiseConfig, program="python tools/tracking_noise.py"))
