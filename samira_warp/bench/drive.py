"""``bench drive``: from a picture of a face to the avatar's picture, stage by stage."""

from __future__ import annotations

import io
import itertools
import json as json_format
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from samira_warp.avatar import DrivingFrame
from samira_warp.bench import timing
from samira_warp.bench.subject import make_avatar, make_camera
from samira_warp.bench.timing import Stopwatch, hardware, print_table
from samira_warp.data import made_subject
from samira_warp.data.pictures import files_of
from samira_warp.drive import DriveSettings, FaceSignal, FilmedPicture, Performer, open_source
from samira_warp.drive.arkit import SHAPES
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.io.images import read_image, to_uint8
from samira_warp.support.errors import UserError
from samira_warp.view.lights import Lights
from samira_warp.view.look import Look
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Scene, Shown, Sides
from samira_warp.view.session import QUICK_QUALITY
from samira_warp.view.state import Pose, State

SIZES = (256, 512)
RATE = 25.0


def measure(
    device: torch.device,
    *,
    size: int,
    template: HeadTemplate,
    items: Iterator[FilmedPicture | FaceSignal],
    pictures: bool,
) -> dict[str, object]:
    """Median milliseconds of one frame's way through the cpu preset's avatar, one stage after the other.

    It has 20,000 Gaussians, under the learned light. The delay is that of a frame which waits for none before
    it, without a camera's and a browser's own; tracking and rendering have a thread each in `view`, so that
    with two cores as many pictures come as the slower of them makes.

    Args:
        device: Where to render; faces are tracked on the CPU.
        size: Side of the avatar's picture, pixels.
        template: The avatar's head.
        items: What a source gives.
        pictures: Whether these are pictures; else signals.
    """
    avatar, camera = make_avatar("cpu", device=device, template=template), make_camera(size)
    rest = FrameParameters(
        torch.zeros(3), torch.zeros(len(template.joint_names), 3), torch.zeros(template.n_expression)
    )
    frames = [DrivingFrame("0", rest, camera, "train")]
    performer = Performer(avatar.canonical, frames, DriveSettings(), pictures=pictures)
    scene = Scene(Shown(avatar, Path(), Poser(frames, template)), Lights(device=device))
    state, sides, stopwatch = State(Look.of(camera)), Sides.new(), Stopwatch(device)
    # the first pictures are waited for, and tell the subject
    if pictures:
        next((item for item in items if performer.see(item)), None)
    made = 0
    for item in items:
        with stopwatch.stage("track"):
            seen = performer.see(item)
        with stopwatch.stage("pose"):
            pose = performer.perform(seen[0])
        state = replace(state, pose=Pose(live=pose.parameters))
        with stopwatch.stage("picture"):
            picture = scene.picture(state, sides, width=size, height=size, detail="quick")
        with stopwatch.stage("jpeg"):
            Image.fromarray(picture).save(io.BytesIO(), "JPEG", quality=QUICK_QUALITY)
        made += 1
        if made == timing.WARM_UP + timing.REPEATS:
            break
    if made <= timing.WARM_UP:
        raise UserError("--film", expected="more pictures of a face", found=made)
    times = stopwatch.medians()
    tracked, shown = times["track"] + times["pose"], times["picture"] + times["jpeg"]
    return {
        "source": "pictures" if pictures else "signals",
        "size": size,
        "track_ms": times["track"],
        "pose_ms": times["pose"],
        "picture_ms": times["picture"],
        "jpeg_ms": times["jpeg"],
        "delay_ms": tracked + shown,
        "pictures_per_second": 1e3 / max(tracked, shown),
    }


def main(device: str, json: bool, film: Path | None) -> None:
    """Measure pictures and signals at every size, and print a table or JSON rows."""
    on, subject = torch.device(device), made_subject()
    template = subject.head()
    rows = [
        measure(
            on,
            size=size,
            template=template,
            items=_pictures(film) if pictures else _signals(),
            pictures=pictures,
        )
        for pictures, size in itertools.product((True, False), SIZES)
    ]
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table(rows)


def _pictures(film: Path | None) -> Iterator[FilmedPicture | FaceSignal]:
    """A film's pictures, or the built-in subject's."""
    if film is not None:
        yield from open_source(str(film)).frames()
        return
    for number, path in enumerate(files_of(made_subject().dataset() / "images", "*.png")):
        yield FilmedPicture(number / RATE, to_uint8(read_image(path, channels=3)))


def _signals() -> Iterator[FilmedPicture | FaceSignal]:
    """A face that moves all it has."""
    for number in itertools.count():
        share = 0.5 + 0.5 * np.sin(number)
        yield FaceSignal(number / RATE, np.full(len(SHAPES), share), np.array([0.0, 0.2 * share, 0.0]))
