"""Cuts, and the longest part without one, on made-up tracks and pictures."""

import numpy as np
import pytest

from samira_warp.vision import find_cuts, longest_continuous
from samira_warp.vision.cuts import colour_histogram

RED, BLUE = np.eye(64)[[3, 40]]


def film(*shots):
    """(colours, landmarks) of shots: (colours (64,), x of the face or None, pictures)."""
    face = np.random.default_rng(0).uniform(0.0, 100.0, (30, 3))
    colours, landmarks = [], []
    for colour, x, count in shots:
        colours += [colour] * count
        landmarks += [np.full_like(face, np.nan) if x is None else face + np.array([x, 0.0, 0.0])] * count
    return np.array(colours), np.array(landmarks)


@pytest.mark.parametrize(
    ("shots", "expected"),
    [
        ([(RED, 0, 4), (BLUE, 60, 3)], [4]),
        ([(RED, 0, 4), (BLUE, 0, 3)], []),  # a light is switched on
        ([(RED, 0, 4), (RED, 60, 3)], []),  # the head jerks: that is for who follows it
        ([(RED, 0, 4), (BLUE, None, 3), (RED, 0, 2)], [4, 7]),  # something else is shown in between
        ([(RED, 0, 4), (0.9 * RED + 0.1 * BLUE, 60, 3)], []),
        ([(RED, 0, 1)], []),
    ],
)
def test_a_cut_changes_colours_and_moves_the_face(shots, expected):
    assert find_cuts(*film(*shots)) == expected


@pytest.mark.parametrize(
    ("person", "cuts", "expected"),
    [
        ([0, 0, 0, 0], [], slice(0, 4)),
        ([0, 0, 0, 0, 0], [2], slice(2, 5)),
        ([0, 0, 1, 1, 1, 0], [], slice(2, 5)),
        ([-1, 0, -1, 0, -1], [], slice(1, 4)),
        ([0, 0, -1, -1, -1, 0, 1, 1], [], slice(0, 6)),
        ([0, 0, 1, 1], [], slice(0, 2)),
        ([-1, -1], [1], slice(0, 0)),
        ([], [], slice(0, 0)),
    ],
)
def test_the_longest_part_is_of_one_shot_and_one_person(person, cuts, expected):
    assert longest_continuous(np.array(person, int), cuts) == expected


def test_histograms_follow_light_slowly_and_scenes_at_once():
    generator = np.random.default_rng(0)
    room = np.clip(generator.normal(110, 30, (90, 160, 3)), 0, 255).astype(np.uint8)
    brighter = np.clip(room.astype(int) + 3, 0, 255).astype(np.uint8)
    garden = (room * [0.4, 1.2, 0.3]).clip(0, 255).astype(np.uint8)
    first, second, third = (colour_histogram(picture) for picture in (room, brighter, garden))
    assert first.shape == (64,)
    assert first.dtype == np.float32
    assert np.isclose(first.sum(), 1.0)
    # 3 of 255 levels move a hundredth of a cell's 85 a channel: 3 x 3 / 85 of the pixels at most
    assert 0.5 * np.abs(second - first).sum() < 3 * 3 / 85
    assert 0.5 * np.abs(third - first).sum() > 0.4


@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 700, 3), (700, 2, 3)])
def test_histograms_of_odd_shapes(shape):
    assert np.isclose(colour_histogram(np.zeros(shape, np.uint8)).sum(), 1.0)
