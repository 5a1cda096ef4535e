"""Mattes: the coarse one of the built-in subject before a garden, and what sharpens and steadies it."""

import builtins
import importlib

import numpy as np
import pytest
import torch
from portraits import OPEN
from scipy import ndimage

from samira_warp.support.errors import UserError
from samira_warp.vision import follow_faces
from samira_warp.vision.mattes import CoarseMatte, above_line, refine, segment
from samira_warp.vision.mesh import square_about


def garden(portrait):
    """A head before plants, as bytes."""
    noise = np.random.default_rng(0).normal(0.0, 1.0, (*portrait.coverage.shape, 1))
    leaves = ndimage.gaussian_filter(noise, (5, 5, 0)) * 4.0
    behind = np.clip(np.array([60, 110, 50]) + 40 * leaves, 0, 255)
    alpha = portrait.coverage[..., None]
    head = portrait.picture - 255.0 * (1.0 - alpha)
    return np.rint(np.clip(head + (1.0 - alpha) * behind, 0, 255)).astype(np.uint8)


def disc(size=96, *, radius=30.0, blur=0.0):
    """(H, W) coverage of a disc, by its distance field, or blurred by a few pixels."""
    rows, columns = np.indices((size, size)) + 0.5
    distance = radius - np.hypot(columns - size / 2, rows - size / 2)
    return np.clip(distance / max(blur, 1.0) + 0.5, 0.0, 1.0).astype(np.float32)


def painted(coverage):
    """A picture of it: skin before a wall, smooth both."""
    rows, columns = np.indices(coverage.shape)
    skin = np.stack([200 - 0.3 * rows, 150 - 0.2 * columns, 120 + 0 * rows], axis=2)
    wall = np.stack([60 + 0.3 * columns, 80 + 0 * rows, 110 - 0.2 * rows], axis=2)
    return np.rint(coverage[..., None] * skin + (1 - coverage[..., None]) * wall).astype(np.uint8)


def coarse_of(coverage, *, cell=2.0):
    return CoarseMatte(coverage, np.zeros((8, 8, 3), np.float32), cell)


def test_heads_are_cut_out_sharper_than_the_network_sees_them(networks, segmentation, portraits):
    for frame in OPEN:
        portrait = portraits[frame]
        picture, truth = garden(portrait), portrait.coverage
        face = square_about(follow_faces([picture], networks).landmarks[0].astype(float))
        coarse = segment(segmentation, picture, face)
        fine = refine(picture, coarse)
        assert fine.dtype == coarse.coverage.dtype == np.float32
        assert fine.shape == truth.shape
        both = ((fine > 0.5) & (truth > 0.5)).sum() / ((fine > 0.5) | (truth > 0.5)).sum()
        assert both > 0.95
        inside = truth > 0.5
        edge = ndimage.distance_transform_edt(inside) + ndimage.distance_transform_edt(~inside) < 5
        assert np.abs(fine - truth)[edge].mean() < 0.7 * np.abs(coarse.coverage - truth)[edge].mean()


def test_a_blurred_edge_becomes_the_pictures():
    """A coarse edge five pixels wide and two too far out; the picture's is one pixel wide.

    Rounding to bytes is noise of 0.3 levels on a contrast of 100, which the affine model amplifies little.
    """
    truth = disc()
    coarse = disc(radius=32.0, blur=5.0)
    fine = refine(painted(truth), coarse_of(coarse))
    band = np.abs(np.hypot(*(np.indices(truth.shape) + 0.5 - 48)) - 31) < 6
    assert np.abs(coarse - truth)[band].mean() > 0.15
    assert np.abs(fine - truth)[band].mean() < 0.02


def test_what_is_certain_stays():
    truth = disc()
    hole = truth.copy()
    hole[40:56, 40:56] = 0.0
    certain = np.zeros(truth.shape, bool)
    certain[36:60, 36:60] = True
    fine = refine(painted(truth), coarse_of(hole), certain)
    assert (fine[36:60, 36:60] == 1.0).all()


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_where_nothing_is_uncertain_nothing_is_asked(value):
    coarse = np.full((20, 30), value, np.float32)
    assert (refine(np.zeros((20, 30, 3), np.uint8), coarse_of(coarse)) == value).all()


def test_memory_steadies_what_does_not_move(segmentation, portraits):
    """A picture of the same thing with another noise: the coarse matte changes less than it would."""
    picture = garden(portraits[0])
    noise = np.random.default_rng(1).normal(0, 2, (2, *picture.shape))
    one, two = (np.clip(picture + part, 0, 255).astype(np.uint8) for part in noise)
    first = segment(segmentation, one, None)
    fresh, steadied = segment(segmentation, two, None), segment(segmentation, two, None, first)
    change = [np.abs(matte.coverage - first.coverage).mean() for matte in (fresh, steadied)]
    assert change[1] < 0.6 * change[0]


def test_memory_forgets_what_moves(segmentation, portraits):
    still, moved = garden(portraits[47]), garden(portraits[70])
    first = segment(segmentation, still, None)
    fresh, steadied = segment(segmentation, moved, None), segment(segmentation, moved, None, first)
    where = np.abs(fresh.coverage - first.coverage) > 0.9
    assert where.any()
    assert np.abs(fresh.coverage - steadied.coverage)[where].mean() < 0.05


def test_another_size_has_no_memory(segmentation, portraits):
    picture = garden(portraits[0])
    before = segment(segmentation, picture[:200], None)
    assert np.array_equal(
        segment(segmentation, picture, None, before).coverage, segment(segmentation, picture, None).coverage
    )


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.7])
def test_nothing_is_left_below_the_line(angle):
    matte = np.ones((60, 80), np.float32)
    start = np.array([40.0, 30.0])
    along = np.array([np.cos(angle), np.sin(angle)])
    cut = above_line(matte, start, start + 7 * along)
    rows, columns = np.indices(matte.shape) + 0.5
    above = (columns - 40.0) * along[1] - (rows - 30.0) * along[0]
    assert (cut[above > 0.51] == 1).all()
    assert (cut[above < -0.51] == 0).all()
    assert above_line(matte, start, start + np.array([1.0, 0.0]))[:30].min() == 1.0
    assert cut.dtype == np.float32


def test_a_missing_library_is_named_with_the_extra(monkeypatch):
    really = builtins.__import__

    def without(name, *rest):
        if name.startswith("pymatting"):
            raise ImportError(f"No module named {name!r}")
        return really(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"pymatting: expected .*pip install 'samira-warp\[track\]'"):
        refine(painted(disc()), coarse_of(disc(blur=4.0)))


def test_torch_keeps_its_threads(monkeypatch, use_threads):
    """Pymatting's compiler sets their number when it is loaded, which a process does but once."""
    module = importlib.import_module("pymatting.laplacian.cf_laplacian")
    laplacian = module.cf_laplacian

    def first(*arguments, **options):
        torch.set_num_threads(2)
        return laplacian(*arguments, **options)

    monkeypatch.setattr(module, "cf_laplacian", first)
    use_threads(3)
    refine(painted(disc()), coarse_of(disc(blur=4.0)))
    assert torch.get_num_threads() == 3
