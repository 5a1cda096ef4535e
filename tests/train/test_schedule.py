import itertools
import math

import pytest

from samira_warp.train.config import LONG_RUN, RATES, SHORT_RUN, WARM_UP, Schedule, learning_rate


@pytest.mark.parametrize("group", RATES)
@pytest.mark.parametrize(
    ("steps", "length"), [(3_000, "short"), (SHORT_RUN, "short"), (LONG_RUN, "long"), (90_000, "long")]
)
def test_rates_start_at_their_first_value_and_end_at_their_last(group, steps, length):
    first, last = getattr(RATES[group], length)
    warm = round(WARM_UP * steps)
    cosine = 0.5 * (1 + math.cos(math.pi * warm / steps))
    assert learning_rate(group, step=warm, steps=steps) == pytest.approx(last + (first - last) * cosine)
    assert first * 0.99 < learning_rate(group, step=warm, steps=steps) <= first
    assert learning_rate(group, step=steps, steps=steps) == pytest.approx(last)
    # the cosine is flat at its end: one step before it, 2.5 / steps^2 of the way are left
    assert learning_rate(group, step=steps - 1, steps=steps) == pytest.approx(
        last + (first - last) * (math.pi / (2 * steps)) ** 2
    )


def test_warm_up_rises_linearly_over_two_per_cent():
    steps = 5_000
    rates = [learning_rate("opacity_logits", step=step, steps=steps) for step in range(200)]
    # a constant group: what is left is the warm-up
    assert rates[0] == pytest.approx(0.05 / 100)
    assert rates[49] == pytest.approx(0.05 / 2)
    assert rates[99:] == pytest.approx([0.05] * 101)


def test_rates_fall_after_the_warm_up():
    rates = [learning_rate("means", step=step, steps=1_000) for step in range(20, 1_001)]
    assert all(later < earlier for earlier, later in itertools.pairwise(rates))


def test_between_short_and_long_runs_rates_are_log_interpolated():
    middle = round(math.sqrt(SHORT_RUN * LONG_RUN))
    for group in ("network", "light", "expression"):
        (_, short), (_, long) = RATES[group].short, RATES[group].long
        assert learning_rate(group, step=middle, steps=middle) == pytest.approx(
            math.sqrt(short * long), rel=1e-3
        )
    ends = [
        learning_rate("light", step=steps, steps=steps) for steps in (10_000, 14_000, 20_000, 28_000, 30_000)
    ]
    assert ends == sorted(ends, reverse=True)


def test_the_papers_rates_and_the_designs():
    assert RATES["network"].long == (1e-4, 1e-5)
    assert RATES["light"].short == (1e-2, 1e-3)
    assert RATES["means"].short == (5e-3, 5e-5)
    assert [RATES[name].short[0] for name in ("log_scales", "quaternions", "opacity_logits")] == [
        0.017,
        1e-3,
        0.05,
    ]
    assert [RATES[name].long[0] for name in ("expression", "pose", "translation")] == [1e-3, 1e-5, 1e-6]


def test_a_run_of_one_step_has_a_rate():
    assert learning_rate("means", step=0, steps=1) > 0


def test_stages_and_perceptual_term_begin_at_their_share():
    schedule = Schedule(3_000)
    assert [schedule.in_stage_two(step) for step in (0, 899, 900, 2_999)] == [False, False, True, True]
    assert [schedule.perceptual_on(step) for step in (1_499, 1_500)] == [False, True]


def test_density_events():
    schedule = Schedule(3_000)
    events = [step for step in range(3_000) if schedule.density_event(step)]
    # every 75 steps from 300 to 1800, none in the 150 steps after stage two begins at 900
    expected = [
        75 * k - 1 for k in range(1, 41) if 300 <= 75 * k - 1 < 1_800 and not 900 <= 75 * k - 1 < 1_050
    ]
    assert events == expected
    assert len(events) == 18
    assert [step for step in range(3_000) if schedule.density_window(step)] == list(range(300, 1_800))
    assert [step for step in range(3_000) if schedule.density_ends(step)] == [1_799]


@pytest.mark.parametrize("steps", [1, 2, 6, 17, 100])
def test_short_runs_have_one_end_of_density_control_at_most(steps):
    schedule = Schedule(steps)
    assert sum(schedule.density_ends(step) for step in range(steps)) <= 1
    assert all(schedule.density_window(step) for step in range(steps) if schedule.density_event(step))


def test_opacity_is_reset_in_long_runs_only():
    assert not any(Schedule(20_000).opacity_reset(step) for step in range(20_000))
    resets = [step for step in range(30_000) if Schedule(30_000).opacity_reset(step)]
    assert resets == [3_000 * k - 1 for k in range(2, 7)]
