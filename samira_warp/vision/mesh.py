"""The face mesh network: 468 points of a face in a square about it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from samira_warp.vision.crops import Square, cut
from samira_warp.vision.face_shape import face_shape, roll_of, yaw_of
from samira_warp.vision.runtime import Network

POINTS = 468

MARGIN = 0.25
"""Of the square about a face, on each side, in longer sides of the landmarks' own rectangle; MediaPipe's."""

PIXEL_CENTRE = 0.5
"""The network counts pixels from their centres: its 0 is the middle of the first one.

MediaPipe takes it for the corner. Readings of a square and of its mirror image then lie 1.1 of the 192 pixels
apart in x, on average over the three clips (1.07, 1.09 and 1.17), half a pixel each; with this, 0.1. No
mirror tells of y, for which the same is taken."""

SETTLED = 4.0
"""Pixels of the network's 192 by which two readings of a face may differ, on average over the points.

Those of a face that is seen from before differ by 0.7 to 1.0 and 2 at most, and more as it turns away: by 2.6
and 3.6 at 35 degrees, 3.5 and 4.7 at 45. This is for the former and doubles towards the profile. Squares
without a face, or with one that is rolled by 70 degrees and more, wander by 7 to 30, pass after pass; no
score tells them apart."""

STEADY = 0.02
"""Of a square's side: by how much the next one may be elsewhere, larger, or turned (radians)."""

PASSES = 6
"""How often a reading is repeated at most. A face has settled after two in a film, three after the
detector."""


class MeshReading(NamedTuple):
    """What the network says of a square.

    Attributes:
        landmarks: (468, 3) float64 x, y, z: pixels of the picture, z of the same unit, smaller nearer.
        presence: 0..1, whether there is a face; above 0.999 for many squares that are cut wrongly.
    """

    landmarks: np.ndarray
    presence: float


class SettledReading(NamedTuple):
    """The mean of a reading and of one in a mirror, of squares that follow from each other.

    Attributes:
        landmarks: (468, 3) float64, as a `MeshReading`'s.
        presence: The lower of the two.
        apart: How far apart the two are, on average over the points, pixels of the network's 192.
    """

    landmarks: np.ndarray
    presence: float
    apart: float

    @property
    def settled(self) -> bool:
        """Whether the readings agree, as they do for faces."""
        return self.apart < SETTLED * (1.0 + abs(np.sin(yaw_of(self.landmarks))))


def read_mesh(network: Network, picture: np.ndarray, square: Square) -> MeshReading:
    """Run the network on a square of a picture (H, W, 3) uint8.

    In a mirrored square it reads every point in its mirror image's place; they are numbered as ever.
    """
    reading = read_unnamed(network, picture, square)
    if not square.mirrored:
        return reading
    return reading._replace(landmarks=reading.landmarks[face_shape().mirror])


def read_unnamed(network: Network, picture: np.ndarray, square: Square) -> MeshReading:
    """As `read_mesh`, the points in the order in which they come out."""
    outputs = [*network(cut(picture, square, network.size)).values()]
    values, score = sorted((out.astype(np.float64).ravel() for out in outputs), key=len, reverse=True)
    shares = values.reshape(POINTS, 3) / network.size
    places = square.to_picture(shares[:, :2] + PIXEL_CENTRE / network.size)
    landmarks = np.concatenate([places, shares[:, 2:] * square.side], axis=1)
    return MeshReading(landmarks, float(1.0 / (1.0 + np.exp(-np.clip(score[0], -100, 100)))))


def square_about(landmarks: np.ndarray) -> Square:
    """The square that the network wants: along the eye line, about all points, with a margin."""
    roll = roll_of(landmarks)
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    along = landmarks[:, :2] @ turn
    low, high = along.min(axis=0), along.max(axis=0)
    x, y = turn @ ((low + high) / 2)
    return Square(float(x), float(y), float((high - low).max()) * (1.0 + 2.0 * MARGIN), roll)


def settle(network: Network, picture: np.ndarray, square: Square) -> SettledReading:
    """Read a face in a square that is about right, then in the mirror image of the one that follows from it.

    The mean of both is nearer the truth than either: on two rendered heads, whose surfaces are known, the
    median distance falls from 2.2 to 1.9 pixels (512 x 512) and from 1.8 to 1.6 (256 x 256); it is 2.6 where
    the detector's square is read once. From picture to picture it jitters no less, by 0.2 to 0.4 of the
    network's 192 pixels: that comes with the picture. Two more readings, larger and smaller or shifted, gain
    nothing.

    Repeated until the squares agree, which faces come to from squares half or one and a half times as large
    as the right ones, shifted by 0.4 or rolled by 45 degrees.

    Args:
        network: The face mesh.
        picture: (H, W, 3) uint8.
        square: Where to begin: from the detector, or from the landmarks of the picture before.
    """
    before = read_mesh(network, picture, square)
    for number in range(1, PASSES):
        about = replace(square_about(before.landmarks), mirrored=number % 2 == 1)
        after = read_mesh(network, picture, about)
        steady = _steps(square, about) < STEADY
        square = about
        if steady:
            break
        if number < PASSES - 1:
            before = after
    apart = np.linalg.norm((after.landmarks - before.landmarks)[:, :2], axis=1).mean()
    return SettledReading(
        (before.landmarks + after.landmarks) / 2,
        min(before.presence, after.presence),
        float(apart) / square.side * network.size,
    )


def _steps(before: Square, after: Square) -> float:
    """The largest of the steps between two squares."""
    turned = (after.roll - before.roll + np.pi) % (2 * np.pi) - np.pi
    moved = np.hypot(after.x - before.x, after.y - before.y)
    return float(max(moved / before.side, abs(after.side / before.side - 1.0), abs(turned)))
