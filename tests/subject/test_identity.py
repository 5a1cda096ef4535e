"""The people that the built-in head can be."""

import numpy as np
import pytest
from heads import FACE, MOUTH, anatomy, lip_edges, normals, parts_seen, people, pose, share_facing

from samira_subject.anatomy.eyes import EYE, EYE_RADIUS
from samira_subject.anatomy.identity import IDENTITIES
from samira_subject.head import build_head

PEOPLE = 6


def shapes():
    template = build_head().template
    return 1000.0 * template.shapedirs[:, :, : template.n_shape].astype(np.float64)


def test_seed_zero_is_the_mean_and_others_are_others():
    assert not build_head(0).identity.any()
    drawn = people(20)
    assert len(np.unique(drawn, axis=0)) == 20
    # plausible: within two standard deviations
    assert np.abs(drawn).max() < 2
    assert np.array_equal(build_head(5).identity, build_head(5).identity)
    assert build_head(5).template is build_head(0).template


@pytest.mark.parametrize("index", range(len(IDENTITIES)), ids=IDENTITIES)
def test_each_moves_some_millimetres_and_is_its_own(index):
    moved = shapes()[:, :, index]
    assert 0.5 < np.linalg.norm(moved, axis=1).max() < 12.0
    # no shape is nearly a sum of the others: that much of it is left without them
    flat = shapes().reshape(-1, len(IDENTITIES))
    others = np.delete(flat, index, axis=1)
    rest = flat[:, index] - others @ np.linalg.lstsq(others, flat[:, index], rcond=None)[0]
    assert np.linalg.norm(rest) > 0.1 * np.linalg.norm(flat[:, index])


@pytest.mark.parametrize("person", range(PEOPLE))
def test_whoever_it_is_the_face_is_whole(person):
    a, faces = anatomy(), build_head().template.faces
    identity = people(PEOPLE)[person]
    vertices = pose(identity=identity)
    assert (np.einsum("fc,fc->f", normals(vertices, faces), normals(a.points, faces)) > 0).all()
    upper, lower = lip_edges()
    assert np.linalg.norm(vertices[upper] - vertices[lower], axis=1).max() < 0.4
    assert parts_seen(vertices, *MOUTH) == {"skin"}
    for side, name in ((1, "left_eyeball"), (-1, "right_eyeball")):
        lids = (a.lid >= 0) & (a.lid < 8) & (side * a.points[:, 0] > 0)
        middle = EYE * (side, 1, 1) + (vertices - a.points)[a.is_part(name)][0]
        assert np.linalg.norm(vertices[lids] - middle, axis=1).min() > EYE_RADIUS + 1.0


@pytest.mark.parametrize("person", range(PEOPLE))
def test_whoever_it_is_a_blink_closes_both_eyes(person):
    identity = people(PEOPLE)[person]
    closed = pose(identity=identity, eyeBlink_L=1.0, eyeBlink_R=1.0)
    x = np.arange(-50.0, 50.0, 0.41)
    assert parts_seen(closed, x, np.arange(-9.0, 9.0, 0.37)) == {"skin"}


@pytest.mark.parametrize("person", range(PEOPLE))
def test_whoever_it_is_nothing_shows_its_back(person):
    vertices = pose(identity=people(PEOPLE)[person], mouthSmile_L=0.7, mouthSmile_R=0.7, browInnerUp=0.5)
    assert share_facing(vertices, *FACE)[0] > 0.999
