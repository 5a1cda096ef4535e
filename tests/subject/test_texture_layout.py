"""Where the built-in head's parts lie in its texture."""

import numpy as np
import pytest
from heads import anatomy

from samira_subject.anatomy.assembly import PARTS
from samira_subject.head import build_head

SIZE = 1024


def corners():
    """(F, 3, 2) places."""
    template = build_head().template
    return template.vt[template.ft].astype(np.float64)


def areas():
    """(F,) twice the area, positive where seen from outside."""
    a, b, c = np.moveaxis(corners(), 1, 0)
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def cover():
    """(SIZE, SIZE) how many faces hold the centre of each texel, edges left out."""
    count = np.zeros((SIZE, SIZE), np.int32)
    for (a, b, c), twice in zip(SIZE * corners() - 0.5, SIZE**2 * areas(), strict=True):
        low, high = (
            np.ceil(np.minimum(np.minimum(a, b), c)).astype(int),
            np.floor(np.maximum(np.maximum(a, b), c)).astype(int) + 1,
        )
        x, y = np.arange(low[0], high[0]), np.arange(low[1], high[1])[:, None]
        s = ((x - a[0]) * (c - a)[1] - (y - a[1]) * (c - a)[0]) / twice
        t = ((b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0])) / twice
        count[low[1] : high[1], low[0] : high[0]] += (s > 1e-6) & (t > 1e-6) & (s + t < 1 - 1e-6)
    return count


def test_faces_are_seen_from_outside_within_the_square():
    assert corners().min() > 0
    assert corners().max() < 1
    # a hundredth of a texel of 1024 squared, at the least
    assert areas().min() / 2 > 0.01 / SIZE**2
    assert np.array_equal(np.unique(build_head().template.ft), np.arange(len(build_head().template.vt)))


def test_no_texel_has_two_owners():
    count = cover()
    assert count.max() == 1
    # most of the square is used
    assert (count > 0).mean() > 0.75


def test_every_part_gets_texels_by_its_size():
    """None is painted with less than a texel for two square millimetres where it can be seen."""
    a = anatomy()
    points = a.points[build_head().template.faces]
    surface = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1)
    part = a.part[build_head().template.faces[:, 0]]
    for number, name in enumerate(PARTS):
        texels = SIZE**2 * areas()[part == number].sum() / surface[part == number].sum()
        assert texels > 0.5, name
    face = np.isin(build_head().template.faces, build_head().template.masks["face"]).all(axis=1)
    assert SIZE**2 * areas()[face].sum() / surface[face].sum() > 3.0


@pytest.mark.parametrize("name", ["skin", "mouth", "left_eyeball", "left_ear"])
def test_the_other_side_is_mirrored(name):
    """Faces whose mirror images are faces: theirs lie mirrored, so that what is painted on one side can be
    copied to the other."""
    a, faces = anatomy(), build_head().template.faces
    by_vertices = {tuple(sorted(face)): number for number, face in enumerate(faces.tolist())}
    mine = np.flatnonzero(a.is_part(name)[faces].all(axis=1))
    theirs = np.array([by_vertices[tuple(sorted(a.mirror[face].tolist()))] for face in faces[mine]])
    # the corner of the other face at which the mirror image of each corner is
    order = (faces[theirs][:, None, :] == a.mirror[faces[mine]][:, :, None]).argmax(axis=2)
    here, there = corners()[mine], np.take_along_axis(corners()[theirs], order[..., None], axis=1)
    sums, heights = (here + there)[..., 0], (here - there)[..., 1]
    # float32 places
    assert np.ptp(sums) < 1e-6
    assert np.abs(heights).max() < 1e-6
    if name == "skin":
        np.testing.assert_allclose(sums, 1.0, atol=1e-6)
