"""Scales of curves and of errors: round numbers that reach round all values."""

import numpy as np
import pytest

from samira_warp.compare.curves import linear_ticks, log_ticks
from samira_warp.compare.sheet import STEPS, end_of_scale, error_picture


@pytest.mark.parametrize(
    "values", [[0.0, 1.0], [23.1, 39.67], [-3.0, 0.2], [5.0], [0.0], [1e-4, 3e-4], [0, 40000]]
)
def test_linear_ticks_are_even_and_reach_round_the_values(values):
    ticks = linear_ticks(values)
    assert 2 <= len(ticks) <= 9
    np.testing.assert_allclose(np.diff(ticks), ticks[1] - ticks[0], rtol=1e-6)
    assert ticks[0] <= min(values) + 1e-9
    assert ticks[-1] >= max(values) - 1e-9


@pytest.mark.parametrize("values", [[0.053, 0.0109], [1.0], [0.02, 0.02], [3e-5, 7.0]])
def test_log_ticks_are_one_two_and_five(values):
    ticks = log_ticks(values)
    assert ticks[0] <= min(values) * (1 + 1e-6)
    assert ticks[-1] >= max(values) * (1 - 1e-6)
    assert {f"{tick:.0e}"[0] for tick in ticks} <= {"1", "2", "5"}
    assert ticks == sorted(set(ticks))
    assert len(ticks) > 1


def test_one_scale_reaches_nearly_all_errors():
    maps = [np.full((10, 10), 0.01, np.float32), np.full((10, 10), 0.04, np.float32)]
    assert end_of_scale(maps) == 0.05
    assert end_of_scale([np.zeros((4, 4), np.float32)]) == STEPS[0]
    maps[0][0, 0] = 0.9  # one pixel of two hundred is left beyond it
    assert end_of_scale(maps) == 0.05


def test_colours_of_errors_begin_dark_and_end_light():
    error = np.array([[0.0, 0.05, 0.1, 0.7]], np.float32)
    picture = error_picture(error, end=0.1)
    np.testing.assert_allclose(picture[0, 0] * 255, (0, 0, 4), atol=1e-3)
    np.testing.assert_array_equal(picture[0, 2], picture[0, 3])
    assert (np.diff(picture[0, :3].sum(axis=-1)) > 0.5).all()
