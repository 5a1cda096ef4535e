"""The one-euro filter against what a first-order low-pass does."""

import math

import numpy as np

from samira_warp.drive.one_euro import LEAST_CUTOFF, OneEuro

RATE = 25.0


def filtered(values, **options):
    smooth = OneEuro(np.ones(1), **options)
    return np.array([smooth(number / RATE, np.array([value]))[0] for number, value in enumerate(values)])


def test_at_rest_nothing_moves_and_off_is_off():
    np.testing.assert_array_equal(filtered([0.3] * 5), 0.3)
    values = np.random.default_rng(0).normal(size=20)
    np.testing.assert_array_equal(filtered(values, smoothing=0.0), values)


def test_a_tiny_step_is_the_low_pass_of_the_least_cutoff():
    """Where speed hardly counts, 1 - (1 - a)^n of a step is there after n values."""
    step = 1e-6
    share = 1.0 / (1.0 + RATE / (2.0 * math.pi * LEAST_CUTOFF))
    steps = 1.0 - (1.0 - share) ** np.arange(1, 9)
    np.testing.assert_allclose(filtered([0.0] + [step] * 8)[1:] / step, steps, rtol=1e-4)


def test_what_is_fast_lags_less():
    slow, fast = (filtered(size * np.minimum(np.arange(20) / 10, 1.0)) / size for size in (1e-6, 10.0))
    assert fast[5] > slow[5] + 0.1


def test_jitter_falls():
    noise = 0.05 * np.random.default_rng(1).normal(size=400)
    assert filtered(noise).std() < 0.7 * noise.std()


def test_a_value_of_no_later_time_is_taken_as_it_is():
    smooth = OneEuro(np.ones(2))
    smooth(1.0, np.zeros(2))
    np.testing.assert_array_equal(smooth(1.0, np.array([3.0, 4.0])), [3.0, 4.0])
