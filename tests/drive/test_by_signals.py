"""ARKit's shapes on heads: by the names of their expressions, and by a fit where these have none."""

from dataclasses import replace

import numpy as np
import pytest
from subjects import small_template

from samira_subject.head import build_template
from samira_warp.drive.arkit import NUMBER_OF, SHAPES, FaceSignal
from samira_warp.drive.by_signals import JAW_OPEN, SignalDriver, map_shapes, relative
from samira_warp.drive.fitted_shapes import fit_shapes, known_shapes
from samira_warp.support.errors import UserError


def signal(head=None, eyes=None, **shapes):
    values = np.zeros(len(SHAPES))
    for name, value in shapes.items():
        values[NUMBER_OF[name]] = value
    return FaceSignal(0.0, values, None if head is None else np.array(head), eyes)


@pytest.fixture(scope="module")
def head():
    return build_template()


def numbered(head, mixing):
    """The head with its expressions mixed, and numbers for their names."""
    shapes = head.shapedirs.copy()
    shapes[..., head.n_shape :] = head.shapedirs[..., head.n_shape :] @ mixing
    names = tuple(f"expression_{number:03d}" for number in range(head.n_expression))
    return replace(head, shapedirs=shapes, expression_names=names)


def test_the_built_in_head_by_names(head):
    driver = SignalDriver(head)
    assert driver.map.missing == ("mouthClose", "tongueOut")
    face = driver.face(signal(eyeBlinkLeft=0.7, cheekPuff=0.5, jawOpen=1.0))
    moved = dict(zip(head.expression_names, face.expression.tolist(), strict=True))
    assert {name: value for name, value in moved.items() if value} == {
        "eyeBlink_L": 0.7,
        "cheekPuff_L": 0.5,
        "cheekPuff_R": 0.5,
    }
    jaw = face.rotations[head.joint_names.index("jaw")]
    np.testing.assert_allclose(np.degrees(jaw.numpy()), [JAW_OPEN, 0, 0])


def test_eyes_follow_their_angles_or_the_shapes(head):
    eyes = [head.joint_names.index(name) for name in ("left_eye", "right_eye")]
    driver = SignalDriver(head)
    by_angles = driver.face(signal(eyes=np.array([[0.1, 0.2, 0.0]] * 2), eyeLookUpLeft=1.0))
    np.testing.assert_allclose(by_angles.rotations[eyes].numpy(), [[0.1, 0.2, 0.0]] * 2)
    by_shapes = driver.face(signal(eyeLookOutLeft=1.0, eyeLookInRight=1.0))
    assert (by_shapes.rotations[eyes][:, 1] > 0.5).all(), "both to the left"


def test_shapes_beyond_their_range_are_held(head):
    driver = SignalDriver(head, gain=3.0)
    face = driver.face(signal(mouthPucker=0.5, mouthFunnel=-0.5))
    assert face.expression.max() == 1.0
    assert face.expression.min() == 0.0


def test_relative_to_a_neutral_face():
    neutral = signal(head=[0, 0.3, 0], jawOpen=0.1)
    less = relative(signal(head=[0, 0.5, 0], jawOpen=0.4), neutral)
    np.testing.assert_allclose(less.head, [0, 0.2, 0])
    assert less.shapes[NUMBER_OF["jawOpen"]] == pytest.approx(0.3)
    assert not relative(neutral, neutral).gaze.any()


def test_a_fit_undoes_a_mixing(head):
    """The shapes are exactly in what the mixed expressions span: but for the ridge, nothing is left over."""
    mixing = np.linalg.qr(np.random.default_rng(0).normal(size=(head.n_expression,) * 2))[0]
    found = fit_shapes(numbered(head, mixing.astype(np.float32)))
    # shapes that move landmarks alike share coefficients, and float16 has four digits
    assert found.left < 0.03
    assert found.jaw[0, NUMBER_OF["jawOpen"]] > 0.9 * np.radians(JAW_OPEN)


def test_the_fit_is_said_and_moves_the_head(head, capsys):
    driver = SignalDriver(numbered(head, np.eye(head.n_expression, dtype=np.float32)))
    assert "by a linear map to its 42 expressions" in driver.map.said
    assert "left over" in driver.map.said
    assert set(driver.map.missing) == {"mouthClose", "tongueOut"}
    face = driver.face(signal(mouthSmileLeft=1.0))
    assert int(face.expression.argmax()) == head.expression_names.index("mouthSmile_L")


def test_a_head_without_names_and_landmarks_is_refused():
    with pytest.raises(UserError, match="numbers for names, and without landmarks"):
        map_shapes(replace(small_template(), landmarks=None))


def test_the_asset_is_of_the_built_in_head(head):
    known = known_shapes()
    points = head.landmarks.points(head.v_template.astype(np.float64), head.faces)
    # stored as float32
    np.testing.assert_allclose(known.rest[head.landmarks.ids], points, atol=1e-6)
    number = head.n_shape + head.expression_names.index("mouthSmile_L")
    moved = head.landmarks.points(head.shapedirs[..., number].astype(np.float64), head.faces)
    # displacements are float16, of millimetres: half a unit in 2^11 of 0.016 m
    found = known.moved[known.names.index("mouthSmileLeft")][head.landmarks.ids]
    np.testing.assert_allclose(found, moved, atol=1e-5)
