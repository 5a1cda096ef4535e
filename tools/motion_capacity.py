"""How fast the motion network learns a motion that is shown to it, without pictures in between.

usage: python tools/motion_capacity.py --data DIR [--steps N] [--rate R] [--ablate NAME ...] [--json]

The dataset brings gt/hidden_motion.npz (tools/make_subject.py --hidden-motion). The network of a run that
begins is fitted to it, a training frame a step, by the mean square over the atlas, at the rates of a run of
so many steps. What it recovers of test frames, region by region, is counted as by tools/motion_table.py, but
on every texel that moves. What training by pictures recovers less of, pictures do not say.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from motion_table import Tracks, read_hidden, region_rows
from relight_table import print_rows
from torch import Tensor
from tqdm import tqdm

from samira_warp.avatar import Avatar, conditions_of
from samira_warp.avatar.avatar import DISPLACEMENT_UNIT
from samira_warp.avatar.residual import POSITION_LIMIT, limit_residual
from samira_warp.data import PixelCache, TrackedSequence, open_sequence
from samira_warp.nets import Conditions
from samira_warp.nets.motion import RESIDUAL_CHANNELS
from samira_warp.support.cli import run
from samira_warp.train.config import Ablation, TrainConfig
from samira_warp.train.optimizer import ADAM_EPSILON
from samira_warp.train.plan import make_plan
from samira_warp.train.schedule import learning_rate
from samira_warp.train.settings import resolve
from samira_warp.train.setup import PIXEL_CACHE_BYTES, start


@dataclass(frozen=True)
class CapacityConfig:
    """Fit the motion network to a motion that is known."""

    data: Path
    """Dataset with gt/hidden_motion.npz."""
    steps: int = 1000
    """Training frames shown."""
    rate: float = 1.0
    """Factor on the network's learning rates."""
    ablate: tuple[Ablation, ...] = ()
    """Parts of the network to leave out."""
    seed: int = 42
    """Seed of its first weights and of the order of the frames."""
    json: bool = False
    """Print JSON rows instead of a table."""


class Example(NamedTuple):
    """One frame as the network sees it, and what it is to say.

    Attributes:
        displacement: (3, H, W) D_uv in DISPLACEMENT_UNIT.
        conditions: Standardised.
        truth: (H, W, 3) metres along the world's axes.
        axes: (3, 3) the head's axes in the world.
    """

    displacement: Tensor
    conditions: Conditions
    truth: Tensor
    axes: Tensor


def main(config: CapacityConfig) -> None:
    """Fit, and print what is recovered."""
    hidden, sequence = read_hidden(config.data), open_sequence(config.data)
    avatar = _new_avatar(config, sequence)
    with torch.no_grad():
        examples = [_example(avatar, sequence, index, hidden) for index in range(len(sequence.frames))]
    _fit(avatar, [examples[index] for index in sequence.train], config)
    with torch.no_grad():
        train, test = (
            _tracks(avatar, [examples[index] for index in part]) for part in (sequence.train, sequence.test)
        )
    print_rows(region_rows(avatar, train, test), as_json=config.json)


def _new_avatar(config: CapacityConfig, sequence: TrackedSequence) -> Avatar:
    """The avatar of step 0 of a run."""
    asked = TrainConfig(seed=config.seed, max_steps=config.steps, ablate=config.ablate, preset="cpu")
    settings = resolve(asked, data=config.data, out=Path())
    plan = make_plan(settings, sequence, asked)
    with PixelCache(sequence.frames, resolution=settings.resolution, max_bytes=PIXEL_CACHE_BYTES) as pixels:
        return start(plan, sequence, pixels).avatar


def _example(avatar: Avatar, sequence: TrackedSequence, index: int, hidden: Tensor) -> Example:
    frame, canonical = sequence.frames[index], avatar.canonical
    head = canonical.pose(frame.parameters)
    displacement = canonical.displacement(head, in_head=True) / DISPLACEMENT_UNIT
    return Example(
        displacement.permute(2, 0, 1),
        avatar.statistics(conditions_of(frame.parameters)),
        canonical.atlas.positions(hidden[frame.timestep]),
        head.head_transform[:3, :3],
    )


def _position(avatar: Avatar, example: Example) -> Tensor:
    """(H, W, 3) metres along the world's axes, as the network has it."""
    residual = avatar.motion(example.displacement, example.conditions).permute(1, 2, 0)
    return limit_residual(residual[..., :RESIDUAL_CHANNELS])[0]


def _fit(avatar: Avatar, examples: Sequence[Example], config: CapacityConfig) -> None:
    optimizer = torch.optim.Adam(avatar.motion.parameters(), eps=ADAM_EPSILON, fused=True)
    generator = torch.Generator().manual_seed(config.seed)
    valid = avatar.canonical.atlas.valid
    for step in tqdm(range(config.steps), unit="step", dynamic_ncols=True):
        for group in optimizer.param_groups:
            group["lr"] = config.rate * learning_rate("network", step=step, steps=config.steps)
        example = examples[int(torch.randint(len(examples), (1,), generator=generator))]
        off = (_position(avatar, example) - example.truth)[valid] / POSITION_LIMIT
        optimizer.zero_grad()
        off.square().mean().backward()
        optimizer.step()


def _tracks(avatar: Avatar, examples: Sequence[Example]) -> Tracks:
    """What the network says and what is true of some frames, along the head's axes."""
    valid = avatar.canonical.atlas.valid
    truth = torch.stack([example.truth[valid] @ example.axes for example in examples])
    residual = torch.stack([_position(avatar, example)[valid] @ example.axes for example in examples])
    return Tracks(truth, residual, torch.ones(truth.shape[:2], dtype=torch.bool))


if __name__ == "__main__":
    sys.exit(run(main, CapacityConfig, program="python tools/motion_capacity.py"))
