"""What each term adds to the normal equations against finite differences of what it costs."""

from dataclasses import replace

import pytest
import torch
from tracked_heads import FOCAL, VIEW, head, model, performed, pixels_of, seen_landmarks

from samira_warp.head.rig import Rig
from samira_warp.tracker.landmark_terms import GapTerm, LandmarkTerm
from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.photometric import PhotometricTerm
from samira_warp.tracker.priors import frame_terms, subject_term
from samira_warp.tracker.samples import Samples
from samira_warp.tracker.surface_points import SurfacePoints
from samira_warp.tracker.terms import FramePrior, minimise

FRAMES = 4
EXACT = 1e-5
"""Step of central differences in float64: truncation is of its square, 1e-10, rounding 1e-16 / 1e-5 = 1e-11
of the cost, which is some thousand times a gradient's smaller entries."""


class Everywhere(LandmarkTerm):
    """With trust that does not change as the head turns, as each step of the fit takes it to be."""

    def facing(self, unknowns, rows, placed):
        return torch.ones(placed.shape[:2], dtype=placed.dtype)


def exact_points():
    """Every tenth landmark, in float64."""
    chosen = slice(None, None, 10)
    rig = Rig.build(head().template).to(dtype=torch.float64)
    basis, moving = head().basis.double(), head().layout.moving
    corners, weights = model().corners[chosen], model().barycentrics[chosen].double()
    return SurfacePoints.build(rig, corners, weights, basis=basis, moving=moving)


def landmark_term(truth):
    points = exact_points()
    found, _ = pixels_of(points, truth)
    generator = torch.Generator().manual_seed(3)
    landmarks = seen_landmarks(truth)
    # up to some standard deviations away, so that the robust weights are felt
    off = 4.0 * torch.randn(found.shape, generator=generator, dtype=torch.float64)
    count = found.shape[1]
    return Everywhere(
        points,
        torch.zeros(count, 3, dtype=torch.float64),
        replace(landmarks, points=found + off, seen=torch.ones(FRAMES, count, dtype=torch.float64)),
        VIEW,
        torch.linspace(0.5, 1.0, count, dtype=torch.float64),
        torch.full((FRAMES, 1), 0.5, dtype=torch.float64),
    )


def gap_term(truth):
    term = landmark_term(truth)
    generator = torch.Generator().manual_seed(4)
    upper, lower = torch.tensor([0, 5, 9]), torch.tensor([1, 7, 30])
    gaps = torch.randn(FRAMES, 3, 2, generator=generator, dtype=torch.float64)
    return GapTerm(term, upper, lower, gaps, torch.ones(FRAMES, 3, dtype=torch.float64), 0.001)


def gradients(term, unknowns, *, subject=True):
    equations = NormalEquations.zero(*unknowns.frames.shape, len(unknowns.subject), with_subject=subject)
    term.add(unknowns, equations)
    return equations


def slope(term, unknowns, frames, subject, step):
    """Central difference of the cost along a direction."""
    ahead, behind = (
        term.cost(unknowns.moved(sign * step * frames, sign * step * subject)) for sign in (1.0, -1.0)
    )
    return (ahead - behind) / (2 * step)


def check(term, unknowns, *, step=EXACT, rtol=1e-6, directions=8):
    equations = gradients(term, unknowns)
    generator = torch.Generator().manual_seed(7)
    for number in range(directions):
        frames = torch.randn(unknowns.frames.shape, generator=generator, dtype=torch.float64)
        subject = torch.randn(unknowns.subject.shape, generator=generator, dtype=torch.float64)
        frames, subject = frames * (number % 3 != 1), subject * (number % 3 != 2)
        expected = float(
            (equations.frames_gradient * frames).sum() + (equations.subject_gradient * subject).sum()
        )
        size = float(
            (equations.frames_gradient * frames).norm() + (equations.subject_gradient * subject).norm()
        )
        assert slope(term, unknowns, frames, subject, step) == pytest.approx(expected, abs=rtol * size)


def beside(truth):
    """A state near the truth, with parameters on either side of their walls."""
    generator = torch.Generator().manual_seed(9)
    return truth.moved(
        0.02 * torch.randn(truth.frames.shape, generator=generator, dtype=torch.float64),
        1e-3 * torch.randn(truth.subject.shape, generator=generator, dtype=torch.float64),
    )


def test_landmarks():
    truth = performed(FRAMES)
    check(landmark_term(truth), beside(truth))


def test_gaps():
    truth = performed(FRAMES)
    check(gap_term(truth), beside(truth))


def test_gaps_do_not_see_what_both_ends_share():
    """Lids that are both found too high are as far apart as before."""
    truth = performed(FRAMES)
    term = gap_term(truth)
    raised = term.term.landmarks.points + torch.tensor([0.0, 5.0])
    moved = replace(term, term=replace(term.term, landmarks=replace(term.term.landmarks, points=raised)))
    assert moved.cost(truth) == term.cost(truth)


def test_colors():
    """Pictures whose colours are linear in the place have slopes that are exact.

    In float32 a cost of some hundreds is known to 1e-5, slopes by steps of 5e-5 to a tenth.
    """
    truth = performed(FRAMES)
    side = 64
    down, across = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    ramp = torch.stack([20 + 3 * across, 220 - 3 * down, 10 + across + 2 * down], dim=-1).to(torch.uint8)
    samples = Samples.build(head(), count=200)
    generator = torch.Generator().manual_seed(5)
    pixels, _ = pixels_of(samples.points, truth)
    shown = pixels * side / VIEW.width - 0.5
    x, y = shown.unbind(dim=-1)
    seen = torch.stack([20 + 3 * x, 220 - 3 * y, 10 + x + 2 * y], dim=-1) / 255.0
    # slopes at the picture's edge are halved, and beyond it there is nothing
    inside = ((shown > 1.5) & (shown < side - 2.5)).all(dim=-1)
    assert inside.float().mean() > 0.9
    term = PhotometricTerm(
        samples.points,
        ramp.expand(FRAMES, side, side, 3).contiguous(),
        VIEW,
        seen + 0.05 * torch.randn(seen.shape, generator=generator),
        torch.rand(x.shape, generator=generator) * inside,
        torch.linspace(0.02, 0.05, len(x[0])),
    )
    check(term, truth, step=5e-5, rtol=1e-3)
    exact = replace(term, predicted=seen)
    assert exact.cost(truth) < 1e-4 * term.cost(truth)
    found, _ = minimise(beside(truth), [exact, *frame_terms(head(), rate=None)], steps=6, hold_subject=True)
    off = (pixels_of(samples.points, found)[0] - pixels).norm(dim=-1)
    began = (pixels_of(samples.points, beside(truth))[0] - pixels).norm(dim=-1)
    assert began.median() > 10.0
    assert off.median() < 3.0  # the subject is held where it began, beside the truth


def test_what_is_known_of_heads():
    state = beside(performed(FRAMES))
    for term in frame_terms(head(), rate=25.0):
        check(term, state)
    check(subject_term(head(), focal=FOCAL, frames=FRAMES), state)


def test_what_is_known_alone_is_the_mean_head():
    """Without anything seen, all but the place goes to rest; the focal length to what is known of it."""
    start, layout = beside(performed(FRAMES)), head().layout
    rigid = (torch.arange(layout.frame_size) < 6).double()
    terms = [
        *frame_terms(head(), rate=25.0),
        subject_term(head(), focal=300.0, frames=FRAMES),
        FramePrior(torch.zeros_like(rigid), rigid),  # nothing is known of where heads are
    ]
    found, cost = minimise(start, terms, steps=12)
    assert cost < 1e-6
    assert found.frames[:, layout.expression].abs().max() < 1e-3
    assert found.subject[layout.identity].abs().max() < 1e-3
    assert found.focal == pytest.approx(300.0, rel=1e-3)


def test_slower_films_may_move_more_from_frame_to_frame():
    state = beside(performed(FRAMES))
    fast, slow = (
        next(term for term in frame_terms(head(), rate=rate) if type(term).__name__ == "Smoothness")
        for rate in (25.0, 12.5)
    )
    assert slow.cost(state) == pytest.approx(fast.cost(state) / 4)
