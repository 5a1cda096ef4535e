import itertools
import math

import pytest

from samira_warp.train.schedule import LONG_RUN, RATES, SHORT_RUN, WARM_UP, Earlier, Schedule, learning_rate


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
    assert RATES["light"].short == (6e-2, 6e-3)
    assert RATES["means"].short == (5e-3, 5e-5)
    assert [RATES[name].short[0] for name in ("log_scales", "quaternions", "opacity_logits")] == [
        0.017,
        1e-3,
        0.05,
    ]
    # GaussianAvatars' 1e-3, 1e-5 and 1e-6, times ten: its Adam moves a frame's row at every step
    assert [RATES[name].long[0] for name in ("expression", "pose", "translation")] == [1e-2, 1e-4, 1e-5]


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


def test_a_finished_run_that_is_extended_keeps_what_had_begun_and_follows_the_new_length():
    schedule = Schedule(3_000).extended(6_000, at=3_000)
    assert (schedule.steps, schedule.earlier) == (6_000, (Earlier(3_000, 3_000),))
    # a run of 6,000 steps would begin stage two at 1,800 and LPIPS at 3,000: both have begun, and stay on
    assert [schedule.in_stage_two(step) for step in (899, 900, 1_500, 3_000, 5_999)] == [False] + 4 * [True]
    assert [schedule.perceptual_on(step) for step in (1_499, 1_500, 2_999, 3_000)] == [False] + 3 * [True]
    # density control goes on in what is left of the new length's window, and has no pause to make
    events = [step for step in range(3_000, 6_000) if schedule.density_event(step)]
    assert events == [150 * k - 1 for k in range(21, 25)]
    assert [step for step in range(3_000, 6_000) if schedule.density_ends(step)] == [3_599]


def test_a_finished_run_that_is_extended_by_little_has_no_more_density_control():
    schedule = Schedule(3_000).extended(4_000, at=3_000)
    later = range(3_000, 4_000)
    assert not any(schedule.density_window(step) or schedule.density_event(step) for step in later)
    # rates rise to those of a run of the new length, and fall to the same ends
    for group, first in (("network", 2e-3), ("light", 6e-2)):
        rates = [learning_rate(group, step=step, steps=schedule.steps) for step in (3_000, 4_000)]
        assert rates[1] < rates[0] < 0.25 * first
        assert rates[1] == pytest.approx(RATES[group].short[1])


def test_what_had_not_begun_begins_with_the_new_length():
    schedule = Schedule(3_000).extended(9_000, at=500)
    assert next(step for step in range(9_000) if schedule.in_stage_two(step)) == 2_700
    assert next(step for step in range(9_000) if schedule.perceptual_on(step)) == 4_500
    paused = [step for step in range(2_700, 3_150) if schedule.density_event(step)]
    assert paused == []


def test_of_several_lengths_the_one_that_held_decides_what_began():
    """0.3 of the first length was not reached under it, 0.3 of the second was, and the third changes that no
    more."""
    schedule = Schedule(10_000).extended(11_000, at=2_000).extended(40_000, at=3_500)
    assert next(step for step in range(12_000) if schedule.in_stage_two(step)) == 3_300


def test_an_extension_before_a_step_was_done_is_forgotten():
    assert Schedule(3_000).extended(6_000, at=0) == Schedule(6_000)
    assert Schedule(3).extended(6, at=3).extended(9, at=3) == Schedule(3).extended(9, at=3)


def test_where_a_run_was_extended_is_known():
    schedule = Schedule(3).extended(6, at=3).extended(9, at=6)
    assert [step for step in range(10) if schedule.extended_at(step)] == [3, 6]
