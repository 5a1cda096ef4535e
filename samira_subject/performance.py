"""What the built-in subject does before the camera: it looks about, talks, blinks and pulls faces.

It is exactly tracked. Head and gaze follow sums of slow waves; the upper and the lower face go through their
gestures one after the other, each on its own, so that most pairs of them meet somewhere. Frames to test on
come at the end, go through all of it once more in another order, and stay within what the frames to train on
have shown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_subject.gestures import BLINK, LOWER, SPEECH, UPPER, Gesture, shapes_of
from samira_subject.streams import Purpose, generator_of
from samira_warp.head import FrameParameters

FRAMES_PER_SECOND = 12.5
"""A video's every other frame: 200 of them show 16 seconds."""

YAW, PITCH, ROLL = np.radians([40.0, 15.0, 6.0])
"""Farthest turns of the head."""

NECK_SHARE = 0.75
"""Share of a turn that the neck takes; the rest turns the root."""

SWAY = np.array([0.006, 0.004, 0.008])
"""Farthest translation along each axis, metres."""

JAW = 0.35
"""Widest opening, radians."""

GAZE = np.radians([22.0, 12.0])
"""Farthest turns of the eyes sideways and up or down."""

GAZE_KEPT = 0.35
"""Share of a turn of the head that the eyes take back, to stay with what they look at."""

LIDS_FOLLOW = 0.35
"""Share of a blink by which lids sink when the eyes look down as far as they go."""

EASE = 6
"""Frames over which everything rises from the first frame, which is at rest."""

TURN_PERIODS, SWAY_PERIODS, GAZE_PERIODS = (37.0, 23.0, 53.0), (61.0, 43.0, 71.0), (29.0, 19.0)
"""Frames that a wave takes: yaw, pitch, roll; sway along three axes; gaze sideways and down. All are primes,
so that they meet in all ways."""

QUICK_TILTS = (37.0, 23.0, 19.0)
"""Periods of the turns where what comes with the tilt is to be learned: a wave that comes three times in all
goes with the sway by chance (a correlation of 0.6), and whoever learns from that one learns nothing else."""

GESTURE_STEP = 5.0
"""Frames from a gesture's height to the next one's; each lasts twice as long."""

MOMENT = 3.0
"""Frames that a gesture takes to come and to go at least."""

BLINK_COURSE = (0.35, 1.0, 0.85, 0.3)
"""How far the lids are closed, frame by frame."""

BLINK_PAUSES = (14, 34)
"""Fewest and most frames between blinks."""


@dataclass(frozen=True, eq=False)
class Performance:
    """Tracks of N frames, float32: rotations as axis-angle in radians, lengths in metres.

    Attributes:
        train: How many of the frames, the first ones, are to train on.
        translation: (N, 3).
        rotation: (N, 3).
        neck: (N, 3).
        jaw: (N, 3).
        eyes: (N, 6).
        expression: (N, E) from 0 to 1.
    """

    train: int
    translation: Tensor
    rotation: Tensor
    neck: Tensor
    jaw: Tensor
    eyes: Tensor
    expression: Tensor

    def __len__(self) -> int:
        return len(self.translation)

    def frame(self, index: int) -> FrameParameters:
        """What moves the head in one frame."""
        joints = [self.rotation[index], self.neck[index], self.jaw[index], *self.eyes[index].split(3)]
        return FrameParameters(self.translation[index], torch.stack(joints), self.expression[index])


def perform(
    names: tuple[str, ...], *, train: int, test: int, seed: int, quick_tilts: bool = False
) -> Performance:
    """Play.

    Args:
        names: The template's expression shapes; gestures move those that they know.
        train: Frames to train on; the first one is at rest and looks ahead.
        test: Frames to test on.
        seed: Seed of every choice.
        quick_tilts: Turn with `QUICK_TILTS`.
    """
    generator = generator_of(seed, Purpose.PERFORMANCE)
    frames = train + test
    ease = _smooth_step(np.arange(frames) / EASE)[:, None]
    turn = ease * _waves(generator, QUICK_TILTS if quick_tilts else TURN_PERIODS, frames) * (YAW, PITCH, ROLL)
    sway = ease * _waves(generator, SWAY_PERIODS, frames) * SWAY
    expression, opening = np.zeros((frames, len(names))), np.zeros(frames)
    for gestures, strength in ((UPPER, 1.0), (LOWER, 1.0), (SPEECH, 0.8)):
        for first, count in ((0, train), (train, test)):
            shapes, jaw = _gesture_tracks(gestures, names, count, generator)
            expression[first : first + count] += strength * shapes
            opening[first : first + count] += strength * jaw
    expression, opening = ease * np.clip(expression, 0.0, 1.0), ease[:, 0] * np.clip(opening, 0.0, 1.0)
    gaze = np.clip(
        ease * _waves(generator, GAZE_PERIODS, frames) * 0.7 * GAZE - GAZE_KEPT * turn[:, :2], -GAZE, GAZE
    )
    _move_lids(expression, names, gaze, _blinks(generator, frames))
    tracks = {
        "translation": sway,
        "rotation": _axis_angle((1.0 - NECK_SHARE) * turn),
        "neck": _axis_angle(NECK_SHARE * turn),
        "jaw": np.stack([JAW * opening, np.zeros(frames), np.zeros(frames)], axis=1),
        "eyes": np.tile(_axis_angle(np.pad(gaze, ((0, 0), (0, 1)))), 2),
        "expression": expression,
    }
    return Performance(
        train,
        **{
            name: torch.from_numpy(_within(track, train).astype(np.float32)) for name, track in tracks.items()
        },
    )


def _within(track: np.ndarray, train: int) -> np.ndarray:
    """A track whose frames to test on stay within the range of those to train on."""
    return np.concatenate(
        [track[:train], np.clip(track[train:], track[:train].min(axis=0), track[:train].max(axis=0))]
    )


def _waves(generator: np.random.Generator, periods: tuple[float, ...], frames: int) -> np.ndarray:
    """(frames, len(periods)) smooth tracks in -1 to 1.

    They come near both ends about once a period and reach one of them.
    """
    time = np.arange(frames)[:, None]
    main, slow, fast = (generator.uniform(0.0, 2.0 * np.pi, len(periods)) for _ in range(3))
    period = np.array(periods)
    swell = 0.8 + 0.2 * np.sin(2.0 * np.pi * time / (2.7 * period) + slow)
    bend = 0.5 * np.sin(2.0 * np.pi * time / (1.7 * period) + fast)
    waves = swell * np.sin(2.0 * np.pi * time / period + main + bend)
    return waves / np.abs(waves).max(axis=0)


def _gesture_tracks(
    gestures: tuple[Gesture, ...], names: tuple[str, ...], frames: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Gestures one after the other in a shuffled order, each at least once if the frames allow.

    Returns:
        (frames, E) coefficients and (frames,) shares of the jaw's opening, which may exceed 1 where gestures
        overlap.
    """
    expression, jaw = np.zeros((frames, len(names))), np.zeros(frames)
    step = min(GESTURE_STEP, frames / len(gestures))
    order: list[Gesture] = []
    for place in range(int(np.ceil(frames / step))):
        order = order or [gestures[index] for index in generator.permutation(len(gestures))]
        gesture = order.pop()
        middle = (place + 0.5) * step + generator.uniform(-0.2, 0.2) * step
        lasts = max(step, MOMENT)
        weight = (
            generator.uniform(0.75, 1.0)
            * np.cos(np.clip((np.arange(frames) - middle) / lasts, -1.0, 1.0) * 0.5 * np.pi) ** 2
        )
        for index, value in shapes_of(gesture, names).items():
            expression[:, index] += generator.uniform(0.85, 1.0) * value * weight
        jaw += gesture.jaw * weight
    return expression, jaw


def _blinks(generator: np.random.Generator, frames: int) -> np.ndarray:
    """(frames,) how far the lids are closed by blinks."""
    closed = np.zeros(frames)
    begin = EASE
    while begin < frames:
        length = min(len(BLINK_COURSE), frames - begin)
        closed[begin : begin + length] = BLINK_COURSE[:length]
        begin += len(BLINK_COURSE) + int(generator.integers(*BLINK_PAUSES))
    return closed


def _move_lids(expression: np.ndarray, names: tuple[str, ...], gaze: np.ndarray, blink: np.ndarray) -> None:
    """Let the lids blink and follow the gaze, in place; a closed eye is neither wide nor narrowed."""
    down = gaze[:, 1] / GAZE[1]
    closed = np.clip(blink + LIDS_FOLLOW * np.clip(down, 0.0, 1.0), 0.0, 1.0)
    for index, name in enumerate(names):
        if name.startswith(BLINK):
            expression[:, index] = closed
        elif name.startswith(("eyeWide", "eyeSquint")):
            expression[:, index] *= 1.0 - closed


def _axis_angle(turns: np.ndarray) -> np.ndarray:
    """(N, 3) axis-angle of turns (N, 3) about the head's own y, then x, then z: yaw, pitch (down), roll."""
    return Rotation.from_euler("YXZ", turns).as_rotvec()


def _smooth_step(value: np.ndarray) -> np.ndarray:
    clipped = np.clip(value, 0.0, 1.0)
    return clipped * clipped * (3.0 - 2.0 * clipped)
