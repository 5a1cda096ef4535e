"""The frames to render: the avatar's own, or another sequence's."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from samira_warp.avatar import Avatar, CanonicalHead, DrivingFrame, read_frames
from samira_warp.avatar.driving import Driver, PoseRange, match_expressions, match_joints
from samira_warp.avatar.storage import TEMPLATE_FILE, read_record
from samira_warp.data import TrackedSequence, open_sequence
from samira_warp.drive import DriveSettings, Performer, open_source, record
from samira_warp.drive.recording import sampled
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.render.config import RenderConfig
from samira_warp.stage.frames import chosen_frames, parse_frames
from samira_warp.support.errors import UserError


def select_frames(config: RenderConfig, avatar: Avatar, folder: Path) -> list[DrivingFrame]:
    """The frames to render, at the size to render them.

    Raises:
        UserError: There are none, or the sequence cannot drive the avatar.
    """
    parse_frames(config.frames)  # before anything is read
    own = read_frames(folder)
    if config.drive is not None:
        driven = _performed(config, config.drive, avatar, own)
    elif config.data is not None:
        driven = _driven(config, config.data, avatar, folder, own)
    else:
        driven = _own(config, own, avatar.canonical.template)
    chosen = chosen_frames(list(driven), config.frames)
    longer = config.resolution or max(own[0].camera.width, own[0].camera.height)
    return [frame._replace(camera=frame.camera.with_longer_side(longer)) for frame in chosen]


def _own(config: RenderConfig, frames: list[DrivingFrame], template: HeadTemplate) -> Iterator[DrivingFrame]:
    """The frames that are stored with the avatar."""
    part = config.split or "test"
    if part not in ("train", "test"):
        raise UserError(
            "--split", expected="train or test of the avatar's own frames, or --data DIR", found=repr(part)
        )
    if config.neutral_frame is not None:
        raise UserError(
            "--neutral-frame", expected="--data DIR, the sequence that it is a frame of", found="none"
        )
    driver = Driver.own(template, gain=config.expression_gain)
    return (
        frame._replace(parameters=driver.drive(frame.parameters)) for frame in frames if frame.part == part
    )


def _driven(
    config: RenderConfig, data: Path, avatar: Avatar, folder: Path, own: list[DrivingFrame]
) -> Iterator[DrivingFrame]:
    """Frames of another sequence: its pose and expression, the avatar's own shape and static offset.

    The avatar's own person is not held to what was seen in training: test frames of its dataset go beyond.
    """
    record = read_record(folder)
    trained_on = record.get("subject") == data.resolve().name
    split = config.split or (record.get("split", "dataset") if trained_on else "dataset")
    sequence = open_sequence(data, split=split, flame=folder / TEMPLATE_FILE)
    expressions = match_expressions(
        sequence.template, avatar.canonical.template, source=sequence.template_path
    )
    joints = match_joints(sequence.template, avatar.canonical.template)
    for kind, left_out in (("expressions", expressions.left_out), ("joints", joints.left_out)):
        if left_out:
            print(f"note: the avatar has no {kind} {', '.join(left_out)}", file=sys.stderr)
    same_person = _is_person(sequence, avatar.canonical)
    seen = [frame.parameters for frame in own if frame.part == "train"]
    held = PoseRange.of(seen) if config.clamp and seen and not same_person else None
    driver = Driver(
        sequence.template,
        expressions,
        joints,
        neutral=_neutral(config, sequence),
        gain=config.expression_gain,
        seen=held,
    )
    for index in sequence.selected:
        frame = sequence.frames[index]
        parameters = frame.parameters if same_person else replace(frame.parameters, dynamic_offset=None)
        yield DrivingFrame(frame.name, driver.drive(parameters), frame.camera, sequence.split.part)


def _performed(
    config: RenderConfig, text: str, avatar: Avatar, own: list[DrivingFrame]
) -> Iterator[DrivingFrame]:
    """Frames of what --drive names, as many a second as a film of them has, before the training camera."""
    settings = DriveSettings(
        config.neutral, smoothing=config.smoothing, gain=config.expression_gain, clamp=config.clamp
    )
    source = open_source(text)
    try:
        performer = Performer(avatar.canonical, own, settings, pictures=source.pictures)
        if source.live:
            print(f"recording {source.name}; Ctrl-C ends that", file=sys.stderr, flush=True)
        performances = record(source, performer, neutral=config.neutral)
    finally:
        source.end()
    camera = performer.stance.frame.camera
    for number, performance in enumerate(sampled(performances, config.fps)):
        yield DrivingFrame(f"{number:05d}", performance.parameters, camera, "test")


def _is_person(sequence: TrackedSequence, canonical: CanonicalHead) -> bool:
    """Whether a sequence is of the avatar's own person, tracked as the avatar was."""
    if sequence.template.hash != canonical.template.hash or not torch.equal(
        sequence.shape, canonical.shape.cpu()
    ):
        return False
    tracked, own = sequence.static_offset, canonical.static_offset
    if tracked is None or own is None:
        return tracked is own
    return torch.equal(tracked, own.cpu())


def _neutral(config: RenderConfig, sequence: TrackedSequence) -> FrameParameters | None:
    """The driver's frame that --neutral-frame names, whichever part of the sequence is rendered."""
    number, count = config.neutral_frame, len(sequence.frames)
    if number is None:
        return None
    if not 0 <= number < count:
        raise UserError("--neutral-frame", expected=f"a frame from 0 to {count - 1}", found=number)
    return sequence.frames[number].parameters
