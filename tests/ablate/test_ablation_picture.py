"""The picture of differences by region."""

import numpy as np
import pytest

from samira_warp.ablate.config import PAPER
from samira_warp.ablate.picture import COLORS, _groups, _ticks, draw_regions
from samira_warp.ablate.table import Difference, Score, tabulate


def color(number):
    return [int(COLORS[number][place : place + 2], 16) for place in (1, 3, 5)]


def runs(*values):
    return [{Score("psnr"): value, Score("psnr", "eye"): value} for value in values]


def rows_of(picture, number):
    """Rows of a picture that show a variant's colour below the legend; dots are averaged at their edges."""
    return np.flatnonzero((picture[64:] == color(number)).all(axis=2).any(axis=1)) + 64


def test_dots_are_where_the_numbers_are():
    table = tabulate({"full": runs(30.0), "no-residual": runs(30.5), "no-routing": runs(29.0)})
    picture = draw_regions(table)
    above, below = rows_of(picture, 0).mean(), rows_of(picture, 1).mean()
    # the line at 0, dark from end to end
    lines = np.flatnonzero((picture[:, 100:-100] < 90).all(axis=(1, 2)))
    zero = lines.mean()
    assert above < zero < below
    # heights are of a grid of thirds of pixels, and rows counted whole
    assert (zero - above) / (below - zero) == pytest.approx(0.5, abs=0.03)


def test_bars_are_as_long_as_the_spread():
    # one variant of means 1 below: a spread of sqrt(2 * (0.5 + 0) / 2); the other has none of its own
    table = tabulate({"full": runs(30.0, 30.0), "no-residual": runs(28.5, 29.5)})
    (difference,) = {one.spread for one in table.differences["no-residual"].values()}
    assert difference == pytest.approx(np.sqrt(0.5))
    alone = draw_regions(tabulate({"full": runs(30.0), "no-residual": runs(29.0)}))
    with_bars = draw_regions(table)
    assert np.ptp(rows_of(alone, 0)) < 12
    assert np.ptp(rows_of(with_bars, 0)) > 100


def test_all_variants_and_many_regions_fit():
    scores = {Score("psnr", f"region with a long name {number}"): 30.0 + number for number in range(8)}
    variants = (*PAPER, "no-mask", "no-visibility")
    table = tabulate({variant: [{Score("psnr"): 30.0, **scores}] for variant in variants})
    picture = draw_regions(table)
    # nothing is cut off at the edges
    assert (picture[:, :4] == 255).all()
    assert (picture[:, -4:] == 255).all()
    for number in range(len(variants) - 1):
        assert len(rows_of(picture, number))


def test_a_region_that_is_called_as_the_frame_is_has_a_group_of_its_own():
    run = {Score("psnr"): 30.0, Score("psnr", "whole frame"): 29.0, Score("psnr", "eye"): 28.0}
    groups = _groups(tabulate({"full": [run], "no-residual": [run]}))
    assert list(groups) == ["whole frame", "whole frame (region)", "eye"]


@pytest.mark.parametrize("scale", [1e-3, 0.04, 1.0, 7.0, 300.0])
def test_ticks_are_round_span_everything_and_have_a_zero(scale):
    differences = [Difference(-0.9 * scale, 0.4 * scale), Difference(0.1 * scale, None)]
    ticks = _ticks(differences)
    assert 0.0 in ticks
    assert ticks[0] < -1.3 * scale
    assert ticks[-1] > 0.1 * scale
    steps = np.diff(ticks)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert f"{steps[0]:e}"[0] in "125"
    assert 2 <= len(ticks) <= 10
    assert _ticks([Difference(0.0, None)])[-1] > 0.0
