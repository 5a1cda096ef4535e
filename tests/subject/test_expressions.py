"""What the built-in head's expressions, jaw and eyes move, and what they leave alone."""

import numpy as np
import pytest
from heads import (
    FACE,
    MOUTH,
    anatomy,
    expression,
    faces_seen,
    lip_edges,
    model,
    parts_seen,
    pose,
    share_facing,
)
from matplotlib.path import Path
from scipy.spatial.transform import Rotation

from samira_subject.anatomy.expressions import SIDED, WHOLE
from samira_subject.anatomy.eyes import EYE, EYE_RADIUS
from samira_subject.anatomy.mouth import HALF_WIDTH
from samira_subject.head import ORIGIN, build_head
from samira_subject.performance import JAW, perform

NAMES = sorted([*WHOLE, *(f"{name}_{side}" for name in SIDED for side in "LR")])
SYMMETRIC = (
    "browInnerUp", "jawForward", "mouthFunnel", "mouthPucker", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper",
)  # fmt: skip
EYELIDS = (EYE[0] + np.arange(-16.0, 15.0, 0.29), np.arange(-9.0, 9.0, 0.29))


def test_the_template_has_them_all():
    assert list(build_head().template.expression_names) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_each_moves_some_millimetres_of_face(name):
    a, moved = anatomy(), np.linalg.norm(expression(name), axis=1)
    assert 1.0 < moved.max() < 12.0
    still = ["left_eyeball", "right_eyeball", "left_ear", "right_ear", "teeth_upper"]
    if name.startswith("jaw"):
        # what the jaw carries goes with it as one
        carried = expression(name)[a.is_part("teeth_lower", "tongue")]
        np.testing.assert_allclose(carried, carried[:1].repeat(len(carried), axis=0), atol=1e-4)
    else:
        still += ["teeth_lower", "tongue"]
    assert moved[a.is_part(*still)].max() == 0
    assert moved[a.points[:, 1] < -150].max() < 1.0


@pytest.mark.parametrize("name", NAMES)
def test_those_of_one_side_are_the_others_mirrored(name):
    partner = {"_L": name[:-2] + "_R", "_R": name[:-2] + "_L"}.get(name[-2:])
    partner = partner or (name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left"))
    mirrored = expression(partner)[anatomy().mirror] * (-1.0, 1.0, 1.0)
    np.testing.assert_allclose(expression(name), mirrored, atol=1e-5)  # float32 millimetres
    if name.endswith("_L"):
        moved = np.linalg.norm(expression(name), axis=1)
        left = anatomy().points[:, 0] > 0
        assert moved[left].max() > 1.5 * moved[anatomy().points[:, 0] < -8].max()
    if partner == name:
        assert name in SYMMETRIC


@pytest.mark.parametrize("name", NAMES)
def test_no_face_shows_its_back(name):
    vertices = anatomy().points + expression(name)
    share, count = share_facing(vertices, *FACE)
    assert count > 5000
    assert share > 0.999


@pytest.mark.parametrize("side", [1, -1])
def test_a_blink_closes_the_lids(side):
    x, y = np.sort(side * EYELIDS[0]), EYELIDS[1]
    assert {"left_eyeball", "right_eyeball"} & parts_seen(pose(), x, y)
    closed = pose(**{f"eyeBlink_{'L' if side > 0 else 'R'}": 1.0})
    # rays 0.29 mm apart in both directions: a gap of 0.3 mm over any length would let one through
    assert parts_seen(closed, x, y) == {"skin"}
    # nor does the lids' lining show
    seen = build_head().template.faces[faces_seen(closed, x, y)]
    assert (anatomy().lid[seen] >= 0).all()


def test_lids_are_outside_the_globe_open_and_closed():
    a = anatomy()
    lids = (a.lid >= 0) & (a.lid < 16) & (a.points[:, 0] > 0)
    for weights in ({}, {"eyeBlink_L": 1.0}, {"eyeWide_L": 1.0}, {"eyeSquint_L": 1.0}):
        away = np.linalg.norm(pose(**weights)[lids] - EYE, axis=1)
        # lids are a millimetre thick
        assert away.min() > EYE_RADIUS + 1.0
    # a linear blink cuts the corner of the lids' arc: half-way they are nearest, and still upon the white
    away = np.linalg.norm(pose(eyeBlink_L=0.5)[lids] - EYE, axis=1)
    assert away.min() > EYE_RADIUS


def test_lips_meet_at_rest_and_hide_what_is_behind_them():
    upper, lower = lip_edges()
    points = anatomy().points
    np.testing.assert_allclose(points[upper, 0], points[lower, 0], atol=1e-6)
    assert np.linalg.norm(points[upper] - points[lower], axis=1).max() < 0.4
    assert np.ptp(points[upper, 0]) > 1.9 * HALF_WIDTH
    assert parts_seen(pose(), *MOUTH) == {"skin"}


def test_the_jaw_opens_the_mouth():
    upper, lower = lip_edges()
    opened = pose(jaw=JAW)
    middle = len(upper) // 2
    assert anatomy().points[upper[middle], 0] == 0
    gap = np.linalg.norm(opened[upper] - opened[lower], axis=1)
    assert gap[middle] > 15
    # it closes towards the corners without a step
    assert gap[[0, -1]].max() < 0.35 * gap[middle]
    assert np.abs(np.diff(gap)).max() < 0.25 * gap[middle]
    assert "teeth_upper" in parts_seen(opened, *MOUTH)


@pytest.mark.parametrize("jaw", [0.1, JAW])
def test_the_jaw_carries_teeth_and_tongue_as_a_bone(jaw):
    a = anatomy()
    hinge = 1000.0 * (model().joint_regressor[2] @ model().v_template).numpy() - ORIGIN
    carried = a.is_part("teeth_lower", "tongue")
    expected = Rotation.from_rotvec([jaw, 0.0, 0.0]).apply(a.points[carried] - hinge) + hinge
    opened = pose(jaw=jaw)
    # weights are shares to float32's rounding, of 0.2 m
    np.testing.assert_allclose(opened[carried], expected, atol=1e-3)
    still = a.is_part("teeth_upper", "left_eyeball", "right_eyeball", "left_ear", "right_ear") | (
        a.points[:, 1] > 10
    )
    np.testing.assert_allclose(opened[still], a.points[still], atol=1e-3)


def test_tooth_by_tooth_they_close_without_cutting():
    """Upper incisors stand in front of the lower ones, which pass behind them."""
    a = anatomy()
    edges = {
        name: a.is_part(name) & (a.tooth[:, 1] == 1.0) & (np.abs(a.points[:, 0]) < 10)
        for name in ("teeth_upper", "teeth_lower")
    }
    upper, lower = (a.points[chosen] for chosen in edges.values())
    assert upper[:, 2].min() > lower[:, 2].max() - 0.5
    assert 0 < (lower[:, 1].max() - upper[:, 1].min()) < 3.5


@pytest.mark.parametrize("frame", range(4, 200, 25))
def test_teeth_show_between_the_lips_alone(frame):
    """Whatever gestures meet: nothing of the mouth's inside comes through cheeks, lips or chin."""
    played = perform(NAMES, train=160, test=40, seed=0)
    vertices = pose(
        jaw=float(played.jaw[frame, 0]), **dict(zip(NAMES, played.expression[frame].tolist(), strict=True))
    )
    x, y = np.arange(-45.0, 45.0, 0.9), np.arange(-112.0, -30.0, 0.9)
    seen = faces_seen(vertices, x, y)
    hidden = anatomy().is_part("teeth_upper", "teeth_lower", "tongue")[build_head().template.faces[:, 0]][
        seen
    ] & (seen >= 0)
    upper, lower = lip_edges()
    opening = Path(np.concatenate([vertices[upper, :2], vertices[lower, :2][::-1]]))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)[hidden]
    # half a millimetre to either side of the edges, whichever way round matplotlib takes their turn
    inside = opening.contains_points(places, radius=0.5) | opening.contains_points(places, radius=-0.5)
    assert inside.all()


def test_eyes_turn_in_their_sockets():
    """A look to the side: pupils move by what a turn about the globe's middle gives, and lids stay."""
    a = anatomy()
    looking = pose(eyes=(0.0, 0.4, 0.0) * 2)
    for name, side in (("left_eyeball", 1), ("right_eyeball", -1)):
        pole = np.flatnonzero(a.is_part(name))[0]
        reach = a.points[pole] - EYE * (side, 1, 1)
        np.testing.assert_allclose(
            looking[pole] - a.points[pole], Rotation.from_rotvec([0, 0.4, 0]).apply(reach) - reach, atol=1e-2
        )
    still = ~a.is_part("left_eyeball", "right_eyeball")
    np.testing.assert_allclose(looking[still], a.points[still], atol=1e-3)
