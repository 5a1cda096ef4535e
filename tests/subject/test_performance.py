"""What the built-in subject does."""

import numpy as np
import pytest
import torch

from samira_subject.gestures import LOWER, SPEECH, UPPER, Gesture, shapes_of
from samira_subject.head import build_head
from samira_subject.performance import EASE, GAZE, JAW, PITCH, YAW, perform

NAMES = build_head().template.expression_names
TRACKS = ("translation", "rotation", "neck", "jaw", "eyes", "expression")


@pytest.fixture(scope="module")
def played():
    return perform(NAMES, train=160, test=40, seed=0)


def test_it_begins_at_rest_and_ahead(played):
    assert all(not getattr(played, name)[0].any() for name in TRACKS)


def test_it_turns_far_and_opens_wide(played):
    # the neck's and the root's turns are about the same axes: their sum is the head's to some thousandths
    turn = (played.rotation + played.neck).numpy()[:160]
    assert 0.85 * YAW < turn[:, 1].max() < 1.05 * YAW
    assert -1.05 * YAW < turn[:, 1].min() < -0.85 * YAW
    assert 0.75 * PITCH < np.abs(turn[:, 0]).max() < 1.6 * PITCH
    assert played.jaw[:, 0].min() >= 0
    assert 0.8 * JAW < played.jaw[:, 0].max() <= JAW
    assert played.eyes.abs().max() < 1.1 * GAZE.max()
    assert played.translation.abs().max() < 0.01


def test_test_frames_stay_within_what_was_trained_on_and_cover_most_of_it(played):
    for name in TRACKS:
        track = getattr(played, name)
        train, test = track[:160], track[160:]
        assert (test >= train.min(dim=0).values).all()
        assert (test <= train.max(dim=0).values).all()
        widths = [part.max(dim=0).values - part.min(dim=0).values for part in (train, test)]
        moving = widths[0] > 0
        assert (widths[1][moving] / widths[0][moving]).mean() > 0.5


def test_every_expression_takes_part(played):
    for part in (played.expression[:160], played.expression[160:]):
        assert part.min() >= 0
        assert part.max() <= 1
        assert (part.max(dim=0).values > 0.15).all()


def test_eyes_blink_and_are_not_wide_then(played):
    closed = played.expression[:, NAMES.index("eyeBlink_L")]
    assert 4 <= int((closed == 1.0).sum()) <= 16
    assert not played.expression[closed == 1.0][:, NAMES.index("eyeWide_L")].any()


def test_it_moves_smoothly(played):
    for name, fastest in (("neck", 0.12), ("rotation", 0.05), ("translation", 0.003), ("jaw", 0.25)):
        # radians or metres a frame, of which there are 12.5 in a second
        assert getattr(played, name).diff(dim=0).abs().max() < fastest
    assert played.neck[: EASE // 2].abs().max() < 0.5 * played.neck.abs().max()


def test_the_seed_decides(played):
    again, other = perform(NAMES, train=160, test=40, seed=0), perform(NAMES, train=160, test=40, seed=1)
    for name in TRACKS:
        assert torch.equal(getattr(played, name), getattr(again, name))
        assert not torch.equal(getattr(played, name), getattr(other, name))


@pytest.mark.parametrize("names", [(), ("expression_000", "expression_001")])
@pytest.mark.parametrize(("train", "test"), [(1, 1), (3, 2), (30, 10)])
def test_any_names_and_any_number_of_frames_will_do(names, train, test):
    played = perform(names, train=train, test=test, seed=0)
    assert len(played) == train + test
    assert played.expression.shape == (train + test, len(names))
    assert all(getattr(played, name).isfinite().all() for name in TRACKS)


def test_a_gesture_without_a_side_moves_both():
    assert shapes_of(
        Gesture({"smile": 0.5, "wink_L": 1.0, "absent": 1.0}), ("smile_R", "smile_L", "wink_L", "wink_R")
    ) == {
        0: 0.5,
        1: 0.5,
        2: 1.0,
    }


def test_gestures_name_shapes_that_there_are():
    for gesture in (*UPPER, *LOWER, *SPEECH):
        assert all(shapes_of(Gesture({name: 1.0}), NAMES) for name in gesture.shapes), gesture
