"""One training run from its configuration to its results."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from samira_warp.avatar import Avatar, DrivingFrame, write_frames
from samira_warp.check import open_checked
from samira_warp.data import PixelCache, Sequence
from samira_warp.data.pixels import load_mask
from samira_warp.data.subjects import made_subject
from samira_warp.evaluate import ImagePair, evaluate_images, find_lpips
from samira_warp.evaluate.lpips import SMALLEST_IMAGE, Lpips
from samira_warp.io.files import read_json, replace_file, replace_folder
from samira_warp.io.images import to_uint8
from samira_warp.support.errors import UserError
from samira_warp.train.checkpoint import last_checkpoint
from samira_warp.train.config import PRESETS, Schedule, TrainConfig
from samira_warp.train.losses import SSIM_WINDOW
from samira_warp.train.setup import PIXEL_CACHE_BYTES, image_size, resolve, run_facts, start
from samira_warp.train.trainer import Trainer

FREE_ON_RESUME = ("resume", "data", "out", "device", "checkpoint_every", "preview_every", "lpips_weights")
"""Settings that may differ when a run goes on: they say where things are, not what is computed."""

RECORDED_ONLY = ("settings", "versions", "subject", "torch_threads")
"""Facts that are written down but may differ when a run goes on; settings are compared one by one."""

TRAINING_LPIPS = {"cpu": "alex", "paper": "vgg"}
"""VGG at 256 x 256 is 120 GFLOP a step, too much for two cores."""


def train(config: TrainConfig) -> Path | None:
    """Train an avatar, write its run folder and score it on the test frames.

    Everything that can be checked without decoding images is checked before the run folder is touched; what
    can be checked without a dataset, before the built-in subject is made, where ``data`` is None and it is
    not there yet.

    Returns:
        The run folder, or None when Ctrl-C ended the run early (a checkpoint was saved).

    Raises:
        UserError: The configuration or the dataset cannot be used, or the built-in subject cannot be kept.
    """
    config = resolve(config)
    checkpoint = _checkpoint(config)
    _check_size(config, (config.resolution, config.resolution))
    lpips = find_lpips(TRAINING_LPIPS[config.preset], config.lpips_weights)
    if config.data is None:
        config = replace(config, data=_built_in())
    sequence = open_checked(config.data, split=config.split, flame=config.flame)
    size = image_size(sequence, config.resolution)
    _check_size(config, size)
    perceptual = lpips if min(size) >= SMALLEST_IMAGE else f"images are smaller than {SMALLEST_IMAGE} pixels"
    steps = min(config.epochs * len(sequence.train), config.max_steps or sys.maxsize)
    facts = run_facts(config, sequence, steps=steps, perceptual=isinstance(perceptual, Lpips))
    resumed = None if checkpoint is None else _resumable(config, checkpoint, facts)
    with PixelCache(sequence.frames, width=size[0], height=size[1], max_bytes=PIXEL_CACHE_BYTES) as pixels:
        if resumed is None:
            begun = start(config, sequence, pixels, steps=steps)
            avatar, record = (
                begun.avatar,
                {**facts, "reference_frame": begun.reference, "encoder": begun.encoder},
            )
        else:
            avatar, record = Avatar.load(resumed.checkpoint, device=config.device), resumed.record
        trainer = Trainer(
            config,
            sequence,
            pixels,
            avatar,
            size=size,
            schedule=Schedule(steps),
            perceptual=perceptual.to(config.device) if isinstance(perceptual, Lpips) else None,
            cap=max(PRESETS[config.preset].gaussian_cap, config.gaussians),
        )
        if resumed is not None:
            trainer.resume(resumed.checkpoint)
        config.out.mkdir(parents=True, exist_ok=True)
        _announce(sequence, record["encoder"], perceptual, config)
        replace_file(config.out / "config.json", json.dumps(record, indent=1))
        if not trainer.run(config.out, record=record):
            print(
                f"stopped at step {trainer.step} of {steps}; go on with the same command and --resume",
                file=sys.stderr,
            )
            return None
        replace_folder(config.out / "avatar", lambda folder: _write_result(folder, trainer, record))
        results = score(trainer, perceptual)
        replace_file(config.out / "results.json", json.dumps(results, indent=1))
    print(json.dumps({name: value for name, value in results.items() if name not in ("frames", "protocol")}))
    return config.out


@torch.no_grad()
def score(trainer: Trainer, lpips: Lpips | str) -> dict[str, Any]:
    """Render the test frames with the parameters they came with, and score them in 8 bits against the
    truth.
    """
    sequence, avatar = trainer.sequence, trainer.avatar
    light = avatar.light()

    def pairs() -> Iterator[ImagePair]:
        for index in sequence.test:
            frame = sequence.frames[index]
            rendering = avatar.render(frame.parameters.to(trainer.device), trainer.camera(frame), light)
            prediction = torch.from_numpy(to_uint8(rendering.image.cpu().numpy())).float() / 255.0
            # not the cache's mask: at its 16 bits, pixels covered by exactly one half would count as
            # foreground
            mask = load_mask(frame, width=trainer.size[0], height=trainer.size[1])
            yield ImagePair(frame.name, prediction, trainer.pixels[index].image, mask=mask)

    width, height = trainer.size
    protocol = {
        "split": f"test frames of --split {trainer.config.split}",
        "size": [width, height],
        "bits": "8-bit predictions, box-resized truth",
        "parameters": "as tracked",
    }
    return evaluate_images(pairs(), lpips=lpips, protocol=protocol)


def _write_result(folder: Path, trainer: Trainer, record: dict[str, Any]) -> None:
    """The avatar with its frames: fine-tuned parameters where it trained, the tracker's elsewhere."""
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
            trainer.camera(frames[index]),
            part,
        )
        for index, part in parts
    ]
    write_frames(folder, driving)


class _Resumed(NamedTuple):
    """Where a run goes on.

    Attributes:
        checkpoint: Its last checkpoint.
        record: How it was made, as config.json has it.
    """

    checkpoint: Path
    record: dict[str, Any]


def _checkpoint(config: TrainConfig) -> Path | None:
    """The checkpoint to go on from, None for a new run.

    Raises:
        UserError: There is none to go on from, or a run that a new one would overwrite.
    """
    if config.out.exists() and not config.out.is_dir():
        raise UserError(config.out, expected="a folder", found="a file")
    if config.resume:
        return last_checkpoint(config.out / "checkpoints")
    if any((config.out / "checkpoints").glob("step_*")):
        raise UserError(
            config.out, expected="a new folder, or --resume to go on with the run there", found="a run"
        )
    return None


def _resumable(config: TrainConfig, checkpoint: Path, facts: dict[str, Any]) -> _Resumed:
    """The run to go on with.

    Raises:
        UserError: The settings or the data are not those that the run was begun with.
    """
    path = config.out / "config.json"
    record = read_json(path)
    for name, kind in (("settings", dict), ("encoder", str)):
        if not isinstance(record.get(name), kind):
            raise UserError(
                f"{path}: {name}", expected="how the run was begun", found=type(record.get(name)).__name__
            )
    now = json.loads(json.dumps(facts))
    compared = {name: value for name, value in now["settings"].items() if name not in FREE_ON_RESUME}
    found = {
        f"--{name.replace('_', '-')}": (record["settings"].get(name), value)
        for name, value in compared.items()
    }
    found |= {name: (record.get(name), value) for name, value in now.items() if name not in RECORDED_ONLY}
    for name, (then, value) in found.items():
        if then != value:
            raise UserError(f"{config.out}: {name}", expected=f"{then} as the run was begun", found=value)
    if record.get("torch_threads") != now["torch_threads"]:
        print(
            f"begun with {record.get('torch_threads')} threads, now {now['torch_threads']}: the bits will differ",
            file=sys.stderr,
        )
    return _Resumed(checkpoint, record)


def _check_size(config: TrainConfig, size: tuple[int, int]) -> None:
    """Refuse images that are too small for SSIM.

    Raises:
        UserError: They are.
    """
    if min(size) < SSIM_WINDOW:
        expected = f"images of at least {SSIM_WINDOW} pixels a side"
        raise UserError(
            f"--resolution {config.resolution}", expected=expected, found=f"{size[0]} x {size[1]}"
        )


def _built_in() -> Path:
    """The built-in subject's dataset, for want of another."""
    built_in = made_subject()
    print(f"no --data: the built-in subject, in {built_in.folder()}", file=sys.stderr)
    return built_in.dataset()


def _announce(sequence: Sequence, encoder: str, perceptual: Lpips | str, config: TrainConfig) -> None:
    """Say what will be trained, and which optional parts are missing and why."""
    print(
        f"{sequence.root.name}: {len(sequence.train)} training and {len(sequence.test)} test frames on {config.device}",
        file=sys.stderr,
    )
    for note in sequence.notes:
        print(note, file=sys.stderr)
    print(f"image encoder: {encoder}", file=sys.stderr)
    if isinstance(perceptual, str):
        print(f"no LPIPS term: {perceptual}", file=sys.stderr)
    if not any(sequence.frames[index].albedo_path for index in sequence.train):
        print("no pseudo-albedo: the absolute brightness of a relit image is undefined", file=sys.stderr)
