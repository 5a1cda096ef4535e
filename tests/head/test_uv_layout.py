"""One atlas for every head: what is found wrong, and what xatlas makes of it."""

import builtins
import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from samira_subject.head import build_template
from samira_warp.head import uv_layout
from samira_warp.head.uv_layout import PADDING, SIZE, repacked, uv_fault, with_one_atlas
from samira_warp.support.errors import UserError

TWO = np.array([[0.1, 0.1], [0.4, 0.1], [0.1, 0.4], [0.4, 0.4], [0.6, 0.6], [0.9, 0.6], [0.6, 0.9]])
"""UV coordinates of two triangles that share an edge, and of one apart."""


def doubled_areas(vt, ft):
    a, b, c = np.moveaxis(vt[ft].astype(np.float64), 1, 0)
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def cover(vt, ft, texels):
    """(texels, texels) how many faces hold each texel's centre, one face after the other."""
    count = np.zeros((texels, texels), int)
    y, x = (np.mgrid[:texels, :texels] + 0.5) / texels
    for a, b, c in vt[ft].astype(np.float64):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        inside = np.ones_like(x, bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area > 1e-6
        count += inside
    return count


@pytest.fixture(scope="module")
def ball():
    """The built-in template as a ball of 320 faces without UV coordinates."""
    index = np.arange(162)
    height = 1.0 - (2.0 * index + 1.0) / 162
    turn = np.pi * (1.0 + 5.0**0.5) * index
    ring = np.sqrt(1.0 - height**2)
    points = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    faces = ConvexHull(points).simplices
    a, b, c = np.moveaxis(points[faces], 1, 0)
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return dataclasses.replace(
        build_template(),
        v_template=(0.1 * points).astype(np.float32),
        faces=faces.astype(np.int32),
        vt=np.zeros((1, 2), np.float32),
        ft=np.zeros_like(faces, dtype=np.int32),
    )


def test_a_layout_without_fault():
    assert uv_fault(TWO, np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6]])) is None
    assert uv_fault(build_template().vt, build_template().ft) is None


def test_mirrored_charts_are_no_fault():
    assert uv_fault(TWO, np.array([[0, 1, 2], [1, 3, 2], [4, 6, 5]])) is None


@pytest.mark.parametrize(
    ("vt", "ft", "said"),
    [
        (TWO + np.array([1.0, 0.0]), [[0, 1, 2]], "UV coordinates from 0.10 to 1.40, outside of 0 to 1"),
        (TWO, [[0, 1, 2], [0, 0, 0]], "50% of the faces without an area in UV"),
        (TWO, [[0, 1, 2], [0, 1, 3]], "33% of the texels claimed by more than one face"),
        (TWO, [[0, 1, 2], [1, 3, 2], [0, 1, 2]], "50% of the texels claimed by more than one face"),
        (np.array([[0, 0], [1, 0], [0, 1]]), [[0, 1, 2]] * 7, "faces that cover the map 3.5 times over"),
    ],
)
@pytest.mark.parametrize("pairs", [1, uv_layout.PAIRS])
def test_what_is_no_atlas(vt, ft, said, pairs, monkeypatch):
    monkeypatch.setattr(uv_layout, "PAIRS", pairs)
    assert uv_fault(vt, np.array(ft)) == said


def test_a_head_that_has_an_atlas_keeps_it():
    template = build_template()
    assert with_one_atlas(template) is template


def check_atlas(template, *, texels=256):
    """Every texel one face's, no chart mirrored, none closer than the padding to another."""
    vt, ft = template.vt, template.ft
    assert vt.dtype == np.float32
    assert ft.shape == template.faces.shape
    assert uv_fault(vt, ft) is None
    assert (doubled_areas(vt, ft) > 0.0).all()
    assert vt.min() >= 0.0
    assert vt.max() <= 1.0
    count = cover(vt, ft, texels)
    assert count.max() == 1
    # charts, by the coordinates that faces share; a chart grown by half the padding meets no other
    chart = np.arange(len(vt))
    for _ in range(len(vt)):
        lowest = chart[ft].min(axis=1)
        joined = chart.copy()
        np.minimum.at(joined, ft.ravel(), np.repeat(lowest, 3))
        if np.array_equal(joined, chart):
            break
        chart = joined
    places = vt.astype(np.float64)
    for label in np.unique(chart[ft[:, 0]]):
        own = np.unique(ft[chart[ft[:, 0]] == label])
        other = np.unique(ft[chart[ft[:, 0]] != label])
        if len(other):
            gaps = np.linalg.norm(places[own][:, None] - places[other][None], axis=2)
            # xatlas packs whole texels, and its charts are up to a tenth smaller than the square they end in
            assert gaps.min() > 0.75 * PADDING / SIZE


def test_a_head_without_coordinates_gets_some(ball):
    assert uv_fault(ball.vt, ball.ft) is not None
    found = with_one_atlas(ball)
    check_atlas(found)
    assert np.array_equal(found.faces, ball.faces)


def test_charts_have_their_size_on_the_head(ball):
    found = with_one_atlas(ball)
    a, b, c = np.moveaxis(ball.v_template[ball.faces].astype(np.float64), 1, 0)
    on_head = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    share = doubled_areas(found.vt, found.ft) / on_head
    # charts of a ball are cut where they would stretch; u and v alike, or one of them would be half as long
    assert np.percentile(share, 90) / np.percentile(share, 10) < 2.0
    corners = found.vt[found.ft].astype(np.float64)
    for axis, other in ((0, 1), (1, 0)):
        edges = np.abs(corners[:, 1] - corners[:, 0])
        assert edges[:, axis].sum() / edges[:, other].sum() > 0.6


def test_charts_that_lie_over_each_other_are_kept_and_moved_apart():
    """Tiles of a sheet are stacked: eyes over skin; the charts stay, turned over where they were mirrored."""
    template = build_template()
    a = template.masks["left_eyeball"]
    eye = np.isin(template.faces, a).all(axis=1)
    vt = template.vt.astype(np.float64).copy()
    ids = np.unique(template.ft[eye])
    low, high = vt[ids].min(axis=0), vt[ids].max(axis=0)
    vt[ids] = (vt[ids] - low) / (high - low).max()
    vt[ids, 0] = 1.0 - vt[ids, 0]
    stacked = dataclasses.replace(template, vt=vt.astype(np.float32))
    assert "times over" in uv_fault(stacked.vt, stacked.ft)
    found = with_one_atlas(stacked)
    assert uv_fault(found.vt, found.ft) is None
    assert (doubled_areas(found.vt, found.ft) > 0.0).all()

    def seams(head):
        """Edges of the mesh whose two faces have other coordinates there."""
        return len(np.unique(np.column_stack([head.faces.ravel(), head.ft.ravel()]), axis=0))

    # a few more where a chart of the head's own folds over
    assert seams(found) < 1.02 * seams(template)


def test_small_faces_are_not_left_out(ball):
    """xatlas leaves out faces below 1.2e-7 of the unit squared: in metres, a third of a millimetre wide."""
    tiny = dataclasses.replace(ball, v_template=ball.v_template * np.float32(0.01))
    check_atlas(repacked(tiny))


def test_the_same_atlas_every_time(ball):
    one, other = repacked(ball), repacked(ball)
    assert np.array_equal(one.vt, other.vt)
    assert np.array_equal(one.ft, other.ft)


def test_without_xatlas_it_says_what_to_install(ball, monkeypatch):
    imported = builtins.__import__

    def without(name, *rest, **named):
        if name == "xatlas":
            raise ImportError("No module named 'xatlas'")
        return imported(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"xatlas: expected .*pip install 'samira-warp\[track\]'"):
        with_one_atlas(ball)
    assert with_one_atlas(build_template()) is build_template()
