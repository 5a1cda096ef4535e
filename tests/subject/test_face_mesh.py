"""Where the landmarks lie on the built-in head, by the anatomy's own knowledge of it."""

import csv

import numpy as np
import pytest
from heads import anatomy, lip_edges, pose
from subjects import TESTS

from samira_subject.anatomy.eyes import EYE
from samira_subject.head import ORIGIN, build_template
from samira_warp.head.landmark_placement import EYE_RIMS, IRIS_RADIUS, LIP_RIMS
from samira_warp.head.landmarks import LANDMARKS

RIGHT_EYE, LEFT_EYE = (
    {name: EYE_RIMS[f"{side}_{name}"][1:-1] for name in ("upper", "lower")} for side in ("right", "left")
)
"""Landmarks on lids' edges, from the outer corner to the inner one, without them."""

UPPER_LIP, LOWER_LIP = (LIP_RIMS[name][1:-1] for name in ("lip_upper", "lip_lower"))
"""Where lips meet, from the subject's right to their left, without the corners."""

MIDLINE = (
    10,
    151,
    9,
    8,
    168,
    6,
    197,
    195,
    5,
    4,
    1,
    19,
    94,
    2,
    164,
    0,
    11,
    12,
    13,
    14,
    15,
    16,
    17,
    18,
    200,
    199,
    175,
    152,
)
"""From the forehead down to the chin."""


USED = 5e-3
"""Weight from which a corner counts: the file's last digit, a micrometre, is less of any face."""


def at(vertices):
    """(478, 3) landmarks on a posed head, millimetres."""
    template = build_template()
    return template.landmarks.points(vertices, template.faces)


@pytest.fixture(scope="module")
def rest():
    return at(pose())


def test_every_landmark_is_there_once():
    landmarks = build_template().landmarks
    assert landmarks.ids.tolist() == list(range(LANDMARKS))
    # float32 of three weights
    assert np.abs(landmarks.barycentrics.sum(axis=1) - 1.0).max() < 3e-7
    assert landmarks.barycentrics.min() >= 0.0


def test_they_are_where_the_file_says(rest):
    """The file has micrometres; the template float32 metres, and weights of edges of 12 mm."""
    path = TESTS.parent / "samira_subject" / "face_mesh.csv"
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    wanted = np.array([[float(row[axis]) for axis in "xyz"] for row in rows])
    assert np.abs(rest + ORIGIN - wanted).max() < 2e-3


def test_the_midline_runs_down_the_face(rest):
    line = rest[list(MIDLINE)]
    # in a furrow of it the nearest skin lies a little beside it
    assert np.abs(line[:, 0]).max() < 2e-2
    # the wing of the nose and where lips meet turn back
    assert (np.diff(line[:, 1]) < 0.5).all()


def test_both_sides_mirror_each_other(rest):
    """Every landmark has one at its mirror image."""
    distances = np.linalg.norm(rest[:, None] * (-1.0, 1.0, 1.0) - rest[None], axis=2)
    other = distances.argmin(axis=1)
    assert np.array_equal(other[other], np.arange(LANDMARKS))
    # where lips meet in the midline they bow, and the nearest of the edge is a little beside it
    assert distances.min(axis=1).max() < 2e-2
    for right, left in ((33, 263), (133, 362), (61, 291), (234, 454), (159, 386), (468, 473)):
        assert other[right] == left
        assert rest[right, 0] < 0.0 < rest[left, 0]


@pytest.mark.parametrize(("eye", "side", "corners"), [(RIGHT_EYE, -1, (33, 133)), (LEFT_EYE, 1, (263, 362))])
def test_lid_landmarks_lie_on_the_lids_edges(rest, eye, side, corners):
    a = anatomy()
    edge = (a.lid == 0.0) & (side * a.points[:, 0] > 0.0)
    landmarks = build_template().landmarks
    outer, inner = rest[list(corners)]
    for name, ids in eye.items():
        for index in (*ids, *corners):
            used = build_template().faces[landmarks.faces[index]][landmarks.barycentrics[index] > USED]
            assert edge[used].all(), f"{index} is off the lid's edge"
        across = np.concatenate([[outer[0]], rest[list(ids), 0], [inner[0]]])
        assert (side * np.diff(across) < -0.1).all(), f"the {name} lid's landmarks are out of order"
    assert (rest[list(eye["upper"]), 1] > rest[list(eye["lower"]), 1]).all()


def test_a_blink_brings_the_lids_landmarks_together(rest):
    closed = at(pose(eyeBlink_L=1.0, eyeBlink_R=1.0))
    for eye in (RIGHT_EYE, LEFT_EYE):
        middle = (eye["upper"][3], eye["lower"][3])
        before, after = (abs(points[middle[0], 1] - points[middle[1], 1]) for points in (rest, closed))
        assert before > 7.0
        assert after < 0.1 * before


def test_lip_landmarks_lie_where_the_lips_meet_and_part_with_the_jaw(rest):
    upper, lower = lip_edges()
    faces, landmarks = build_template().faces, build_template().landmarks
    corners = set(np.flatnonzero(anatomy().turn == 0.0))
    opened = at(pose(jaw=0.3))
    for ids, edge in ((UPPER_LIP, upper), (LOWER_LIP, lower)):
        for index in ids:
            used = faces[landmarks.faces[index]][landmarks.barycentrics[index] > USED]
            assert set(used) <= set(edge) | corners, f"{index} is not where the lips meet"
        assert (np.diff(rest[[78, *ids, 308], 0]) > 0.3).all()
    gap = opened[list(UPPER_LIP), 1] - opened[list(LOWER_LIP), 1]
    assert np.abs(rest[list(UPPER_LIP), 1] - rest[list(LOWER_LIP), 1]).max() < 0.5
    assert gap[4] > 15.0
    assert (gap > 2.0).all()


def test_iris_landmarks_turn_with_the_eyes(rest):
    for first, sign in ((468, -1.0), (473, 1.0)):
        middle, right, above, left, below = rest[first : first + 5]
        assert np.abs(middle[:2] - (EYE * (sign, 1.0, 1.0))[:2]).max() < 1e-3
        for point, direction in ((right, (1, 0)), (above, (0, 1)), (left, (-1, 0)), (below, (0, -1))):
            # placed as seen from before
            wanted = 1000.0 * IRIS_RADIUS * np.array(direction)
            assert np.abs(point[:2] - middle[:2] - wanted).max() < 2e-3
    turned = at(pose(eyes=(0.0, 0.2, 0.0, 0.0, 0.2, 0.0)))
    moved = (turned - rest)[[468, 473]]
    # 0.2 radians of a radius of 13.45 mm, to the subject's left
    assert np.abs(moved[:, 0] - 13.45 * np.sin(0.2)).max() < 0.05
