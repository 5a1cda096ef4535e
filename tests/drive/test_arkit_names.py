"""The names of shapes in the spellings that people have for them."""

import numpy as np
import pytest
from takes_written import COLUMNS, SENT

from samira_warp.drive.arkit import NUMBER_OF, SHAPES, gaze_of, half_of, known_shape


def test_there_are_52_in_unreals_order():
    assert [name[0].upper() + name[1:] for name in SHAPES] == SENT[:52]
    assert len(set(SHAPES)) == 52
    assert sorted(COLUMNS) == sorted(SENT)


@pytest.mark.parametrize(
    "spelt", ["eyeBlink_L", "EyeBlinkLeft", "eye_blink_left", "eyeBlinkLeft", "EYEBLINK_l"]
)
def test_spellings_of_one_name(spelt):
    assert known_shape(spelt) == "eyeBlinkLeft"


@pytest.mark.parametrize("name", ["jawLeft", "mouthLeft", "mouthRight", "browInnerUp"])
def test_a_direction_is_no_side(name):
    assert known_shape(name) == name
    assert half_of(name) is None


def test_halves_of_what_arkit_does_not_part():
    assert half_of("cheekPuff_L") == half_of("cheekPuff_R") == "cheekPuff"
    assert half_of("browInnerUp_R") == "browInnerUp"
    assert known_shape("cheekPuff_L") is None
    assert half_of("eyeBlink_L") is None
    assert known_shape("expression_012") is half_of("expression_012") is None


def test_eyes_that_look_in_by_the_shapes_turn_to_each_other():
    shapes = np.zeros(52)
    shapes[[NUMBER_OF["eyeLookInLeft"], NUMBER_OF["eyeLookInRight"]]] = 0.5
    shapes[[NUMBER_OF["eyeLookDownLeft"], NUMBER_OF["eyeLookDownRight"]]] = 0.25
    left, right = gaze_of(shapes)
    # the left eye turns to the right, the right one to the left, both look down
    assert left[1] < -0.2 < 0.2 < right[1]
    assert min(left[0], right[0]) > 0.1
