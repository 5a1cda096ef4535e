"""The banded, bordered solve against dense least squares."""

import pytest
import torch

from samira_warp.tracker.normal_equations import NormalEquations

FRAMES, SIZE, SUBJECT, RESIDUALS = 7, 4, 3, 9
PLACES = FRAMES * SIZE


def uniform(*shape, seed):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.3


@pytest.fixture
def problem():
    """Rows of a dense system, and the same in normal equations."""
    by_frame, by_subject = (
        uniform(FRAMES, RESIDUALS, SIZE, seed=1),
        uniform(FRAMES, RESIDUALS, SUBJECT, seed=2),
    )
    residuals, weights = uniform(FRAMES, RESIDUALS, seed=3), uniform(FRAMES, RESIDUALS, seed=4).abs()
    values, prior, bends = (
        uniform(FRAMES, SIZE, seed=5),
        uniform(FRAMES, SIZE, seed=6).abs(),
        uniform(SIZE, seed=7).abs(),
    )
    rows, right = [], []

    def row(weight, residual, entries):
        full = torch.zeros(PLACES + SUBJECT, dtype=torch.float64)
        for place, value in entries:
            full[place] = value
        rows.append(full * weight.sqrt())
        right.append(-residual * weight.sqrt())

    for frame in range(FRAMES):
        for number in range(RESIDUALS):
            own = [(frame * SIZE + column, by_frame[frame, number, column]) for column in range(SIZE)]
            shared = [(PLACES + column, by_subject[frame, number, column]) for column in range(SUBJECT)]
            row(weights[frame, number], residuals[frame, number], own + shared)
        for column in range(SIZE):
            row(prior[frame, column], values[frame, column], [(frame * SIZE + column, 1.0)])
    for frame in range(FRAMES - 2):
        for column in range(SIZE):
            places = [
                ((frame + step) * SIZE + column, factor) for step, factor in enumerate((1.0, -2.0, 1.0))
            ]
            bend = values[frame, column] - 2 * values[frame + 1, column] + values[frame + 2, column]
            row(bends[column], bend, places)

    def equations(with_subject=True):
        made = NormalEquations.zero(FRAMES, SIZE, SUBJECT, with_subject=with_subject)
        for part in (slice(0, 3), slice(3, FRAMES)):
            made.add(
                part,
                by_frame[part],
                by_subject[part] if with_subject else None,
                residuals[part],
                weights[part],
            )
        made.add_frame_prior(values, prior)
        made.add_smoothness(values, bends)
        return made

    return torch.stack(rows), torch.stack(right), equations


def test_a_step_solves_the_least_squares(problem):
    rows, right, equations = problem
    expected = torch.linalg.lstsq(rows, right[:, None]).solution[:, 0]
    frames, subject = equations().solve(damping=0.0)
    # condition of the normal equations some 1e3: float64's 1e-16 leaves 1e-12
    torch.testing.assert_close(frames.flatten(), expected[:PLACES], rtol=0, atol=1e-11)
    torch.testing.assert_close(subject, expected[PLACES:], rtol=0, atol=1e-11)


def test_a_subject_that_is_held_does_not_move(problem):
    rows, right, equations = problem
    expected = torch.linalg.lstsq(rows[:, :PLACES], right[:, None]).solution[:, 0]
    frames, subject = equations(with_subject=False).solve(damping=0.0)
    torch.testing.assert_close(frames.flatten(), expected, rtol=0, atol=1e-11)
    assert not subject.any()


def test_damping_is_levenberg_and_marquardts(problem):
    rows, right, equations = problem
    matrix = rows.T @ rows
    # smoothness is not damped: it is a band of its own beside the frames' blocks
    bends = equations().smoothness
    bare = torch.diagonal(matrix).clone()
    counts = torch.zeros(FRAMES, dtype=torch.float64)
    for frame in range(FRAMES - 2):
        counts[frame : frame + 3] += torch.tensor([1.0, 4.0, 1.0], dtype=torch.float64)
    bare[:PLACES] -= (counts[:, None] * bends).flatten()
    expected = torch.linalg.solve(matrix + 0.3 * torch.diag(bare), rows.T @ right)
    frames, subject = equations().solve(damping=0.3)
    torch.testing.assert_close(torch.cat([frames.flatten(), subject]), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_films(frames):
    equations = NormalEquations.zero(frames, SIZE, SUBJECT)
    values = uniform(frames, SIZE, seed=8)
    equations.add_frame_prior(values, torch.ones(frames, SIZE, dtype=torch.float64))
    equations.add_subject_prior(uniform(SUBJECT, seed=9), torch.ones(SUBJECT, dtype=torch.float64))
    step, subject = equations.solve(damping=0.0)
    torch.testing.assert_close(step, -values)
    torch.testing.assert_close(subject, -uniform(SUBJECT, seed=9))
