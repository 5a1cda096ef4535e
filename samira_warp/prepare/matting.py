"""Robust Video Matting, fetched by torch.hub; its code and weights (GPL-3.0) are no part of this project."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from samira_warp.data.mattes import read_matte
from samira_warp.data.pictures import pictures_of
from samira_warp.io.images import image_size, read_image, resize_box
from samira_warp.prepare.frames import clear_unfinished, write_whole
from samira_warp.support.device_names import DeviceName
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError

REPOSITORY = "PeterL1n/RobustVideoMatting:53d74c6"
"""At the commit whose code was looked at: what a branch's name stands for may change."""

VARIANTS = {"cuda": "resnet50", "cpu": "mobilenetv3"}
"""The larger network is a little finer at hair, and several times as slow."""

INSTALL = (
    "pip install torchvision, of your torch's build (https://pytorch.org), "
    "and run this once with access to github.com"
)

WARM_UP = 10
"""Pictures that the recurrent network sees before the first whose matte counts, as VHAP has it: it begins
with a guess."""

CHUNK = 100
"""Frames between fresh starts of the recurrent network: an interrupted run goes on from one, to the same
mattes."""

SHARP_SIDE = 512
"""Pixels of the longer side at which the network looks at a whole picture (its authors' rule); the rest is
refined."""

ASPECT_TOLERANCE = 0.01
"""Relative; a matte of another shape than its frame is another picture's."""

Matte = Callable[[np.ndarray, list[Any]], tuple[np.ndarray, list[Any]]]
"""(H, W, 3) uint8 picture and recurrent state in, (H, W) float32 coverage in 0..1 and the next state out."""


class MattingMissing(Exception):  # noqa: N818 - it is no error: the other stages run without
    """Robust Video Matting cannot be used here; the message says why."""


def load_matting(device: DeviceName) -> Matte:
    """Fetch Robust Video Matting and put it on a device.

    Raises:
        MattingMissing: It cannot be fetched or run.
    """
    chosen = pick_device(device)
    if importlib.util.find_spec("torchvision") is None:
        raise MattingMissing("torchvision is not installed")
    try:
        network = torch.hub.load(
            REPOSITORY, VARIANTS[chosen.type], trust_repo=True, skip_validation=True, verbose=False
        )
    except Exception as fault:
        # A missing network, a broken torchvision, another repository's code: all end in the same advice.
        raise MattingMissing(" ".join(f"{type(fault).__name__}: {fault}".split())) from fault
    network = network.eval().to(chosen)

    @torch.inference_mode()
    def matte(picture: np.ndarray, state: list[Any]) -> tuple[np.ndarray, list[Any]]:
        source = torch.from_numpy(picture).to(chosen).permute(2, 0, 1)[None].float() / 255.0
        ratio = min(SHARP_SIDE / max(picture.shape[:2]), 1.0)
        _, alpha, *after = network(source, *state, ratio)
        return alpha[0, 0].float().clamp(0.0, 1.0).cpu().numpy(), after

    return matte


def matte_still(matte: Matte, picture: np.ndarray) -> np.ndarray:
    """(H, W) coverage of one picture (H, W, 3) that belongs to no sequence."""
    alpha, state = matte(picture, [None] * 4)
    for _ in range(WARM_UP - 1):
        alpha, state = matte(picture, state)
    return alpha


def write_mattes(matte: Matte, frames: dict[str, Path], folder: Path) -> None:
    """Write the mattes that are not there yet, named as their frames.

    Raises:
        UserError: A frame cannot be read.
        OSError: A matte cannot be written.
    """
    names = sorted(frames)
    folder.mkdir(parents=True, exist_ok=True)
    clear_unfinished(folder)
    with tqdm(total=len(names), desc="mattes", unit="frame", dynamic_ncols=True) as bar:
        for first in range(0, len(names), CHUNK):
            chunk = names[first : first + CHUNK]
            if not all((folder / frames[name].name).exists() for name in chunk):
                before = names[max(first - WARM_UP, 0) : first] or [names[0]] * WARM_UP
                _write_chunk(
                    matte, [frames[name] for name in before], [frames[name] for name in chunk], folder
                )
            bar.update(len(chunk))


def _write_chunk(matte: Matte, before: list[Path], chunk: list[Path], folder: Path) -> None:
    state: list[Any] = [None] * 4
    for path in before:
        _, state = matte(_picture(path), state)
    for path in chunk:
        alpha, state = matte(_picture(path), state)
        if not (folder / path.name).exists():
            write_whole(folder / path.name, alpha)


def copy_mattes(source: Path, frames: dict[str, Path], folder: Path) -> None:
    """Take the mattes of another program: a picture's alpha channel, or its brightness.

    Raises:
        UserError: A frame has no matte of its name, or one of another shape.
    """
    given = pictures_of(source)
    folder.mkdir(parents=True, exist_ok=True)
    clear_unfinished(folder)
    for name in tqdm(sorted(frames), desc="mattes", unit="frame", dynamic_ncols=True):
        if name not in given:
            raise UserError(
                source,
                expected=f"a matte of every frame, as {name}.png",
                found=f"{len(given)} pictures, none of that name",
            )
        if (folder / frames[name].name).exists():
            continue
        write_whole(folder / frames[name].name, fitted(read_matte(given[name]), given[name], frames[name]))


def write_opaque(frames: dict[str, Path], folder: Path) -> None:
    """Mattes that take the whole picture for the head, where there are none: VHAP's export needs some."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in frames.values():
        width, height = image_size(path)
        write_whole(folder / path.name, np.ones((height, width), np.float32))


def fitted(values: np.ndarray, path: Path, frame: Path) -> np.ndarray:
    """A picture's values (H, W[, C]) at the size of the frame that it belongs to.

    Raises:
        UserError: It is of another shape.
    """
    width, height = image_size(frame)
    if abs(values.shape[1] * height / (values.shape[0] * width) - 1.0) > ASPECT_TOLERANCE:
        raise UserError(
            path,
            expected=f"the shape of {frame} ({width} x {height})",
            found=f"{values.shape[1]} x {values.shape[0]}",
        )
    return resize_box(values, width=width, height=height)


def _picture(path: Path) -> np.ndarray:
    return np.rint(read_image(path, channels=3) * 255.0).astype(np.uint8)
