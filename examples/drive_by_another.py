"""Drive an avatar by another person's sequence.

    python tools/make_subject.py --seed 7 --train 1 --test 24 --relit 0 --resolution 64 --out person_7
    python examples/drive_by_another.py --avatar runs/built_in --data person_7 --out driven

Every frame becomes OUT/NAME.png: the other person as filmed beside the avatar. Both are taken relative to
their neutral faces; expressions are matched by name where the heads differ; poses are held to what the avatar
was trained on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro

from samira_warp import Avatar, Environment, open_sequence, read_frames
from samira_warp.avatar import Driver, PoseRange, match_expressions, match_joints
from samira_warp.data import load_pixels
from samira_warp.io import write_png


@dataclass(frozen=True)
class Options:
    """Drive an avatar by another person's sequence."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset folder of the person who drives: any format that `samira-warp check` knows."""
    out: Path
    """Folder of the pictures."""
    flame: Path | None = None
    """Head model of a dataset that brings none."""
    light: Path | None = None
    """A panorama or a cube cross; default the light that was learned with the avatar."""
    neutral_frame: int | None = None
    """Frame whose face is neutral, counted from 0; default a face without expression."""
    gain: float = 1.0
    """Factor on the expression, relative to neutral."""
    every: int = 1
    """Take every so many frames."""
    resolution: int = 256
    """Longer side of a picture, pixels."""


@torch.no_grad()
def main(options: Options) -> None:
    """Render every frame beside the picture that drives it."""
    avatar = Avatar.load(options.avatar)
    sequence = open_sequence(options.data, flame=options.flame)
    theirs, own = sequence.template, avatar.canonical.template
    expressions, joints = match_expressions(theirs, own, source=options.data), match_joints(theirs, own)
    for kind, left_out in (("expressions", expressions.left_out), ("joints", joints.left_out)):
        if left_out:
            print(f"note: the avatar has no {kind} {', '.join(left_out)}", file=sys.stderr)
    trained = [frame.parameters for frame in read_frames(options.avatar) if frame.part == "train"]
    neutral = None if options.neutral_frame is None else sequence.frames[options.neutral_frame].parameters
    held = PoseRange.of(trained)
    driver = Driver(theirs, expressions, joints, neutral=neutral, gain=options.gain, seen=held)
    # Filtered once for all frames.
    light = avatar.light() if options.light is None else Environment.load(options.light).filtered()

    options.out.mkdir(parents=True, exist_ok=True)
    for frame in sequence.frames[:: options.every]:
        # What a tracker adds to single frames belongs to the other person's face.
        parameters = driver.drive(replace(frame.parameters, dynamic_offset=None))
        camera = frame.camera.with_longer_side(options.resolution)
        driven = avatar.render(parameters, camera, light).image.cpu().numpy()
        filmed = load_pixels(frame, width=camera.width, height=camera.height).image.numpy()
        write_png(options.out / f"{frame.name}.png", np.concatenate([filmed, driven], axis=1))


if __name__ == "__main__":
    main(tyro.cli(Options))
