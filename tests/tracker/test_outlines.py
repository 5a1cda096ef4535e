"""Outlines: where coverage ends, what a term adds, and how far away a head is."""

import torch
from test_tracker_terms import FRAMES, beside, check, exact_points
from tracked_heads import VIEW, head, performed, pixels_of

from samira_warp.tracker.outlines import (
    OutlineFinder,
    Outlines,
    OutlineTerm,
    crossing,
    usual_distances,
)
from samira_warp.tracker.pixel_fit import posed_vertices
from samira_warp.tracker.samples import Samples
from samira_warp.tracker.terms import FramePrior, minimise

SIDE = 192


def finder(count=600):
    return OutlineFinder(head(), VIEW, Samples.build(head(), count=count))


def mattes_of(unknowns):
    """What a perfect matte of the heads would be."""
    vertices = posed_vertices(head(), unknowns, slice(None))
    blank = torch.zeros(len(vertices), SIDE, SIDE, dtype=torch.uint8)
    return (finder()._coverage(vertices, blank, unknowns.focal) * 255).round().to(torch.uint8)


def found(unknowns, mattes):
    return finder().find(posed_vertices(head(), unknowns, slice(None)), mattes, focal=unknowns.focal)


def test_a_disc_ends_at_its_radius():
    """Coverage of a soft disc is linear about its edge over four pixels, so that bilinear lookup of it is
    exact but for the edge's curvature: a pixel squared over twice the radius, 0.02 of 192."""
    x, y = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="xy")
    centre, radius = torch.tensor([90.0, 100.0]), 30.0
    away = ((x - centre[0]).square() + (y - centre[1]).square()).sqrt()
    coverage = (0.5 + (radius - away) / 4.0).clamp(0.0, 1.0)[None]
    scale = VIEW.width / SIDE
    angles = torch.linspace(0.0, 6.0, 50)
    normals = torch.stack([angles.cos(), angles.sin()], dim=-1)
    for begin in (24.0, 30.0, 35.0):
        pixels = (centre + begin * normals) * scale
        at = crossing(coverage, pixels[None], normals[None], VIEW, reach=10.0 * scale)[0]
        assert (at / scale - (radius - begin)).abs().max() < 0.05
    beyond = (centre + 45.0 * normals) * scale
    assert crossing(coverage, beyond[None], normals[None], VIEW, reach=10.0 * scale).isnan().all()


def test_what_the_term_adds_is_the_slope_of_its_cost():
    truth, generator = performed(FRAMES), torch.Generator().manual_seed(2)
    points = exact_points()
    pixels, _ = pixels_of(points, truth)
    shape = pixels.shape[:2]
    angles = 6.28 * torch.rand(shape, generator=generator, dtype=torch.float64)
    distances = torch.randn(shape, generator=generator, dtype=torch.float64)
    distances[:, ::7] = torch.nan
    outlines = Outlines(pixels, torch.stack([angles.cos(), angles.sin()], dim=-1), distances)
    term = OutlineTerm(points, VIEW, outlines, 0.3 * torch.randn(shape[1], generator=generator).double())
    check(term, beside(truth), step=1e-6)  # a hundredth of the third of a pixel within which costs bend


def test_outlines_of_the_truth_are_where_its_matte_ends():
    """The mesh's own coverage, but for its 256 steps."""
    truth = performed(FRAMES)
    distances = found(truth, mattes_of(truth)).distances
    assert (~distances.isnan()).sum(dim=1).min() > 30
    assert distances[~distances.isnan()].abs().max() < 0.02 * VIEW.width / SIDE


def test_a_head_held_too_far_away_comes_back():
    """By outlines alone: that hair is a constant amount beyond the head is learned from frames at the truth.

    Two parts in a hundred too far are 1.2 pixels of 192 at the outline; it is known to a tenth of that by a
    hundred points that err by a third of a pixel."""
    truth = performed(8)
    mattes = mattes_of(truth)
    known = usual_distances(found(truth, mattes))
    away = torch.zeros_like(truth.frames)
    away[4:, 2] = -0.015
    state = truth.moved(away, torch.zeros_like(truth.subject))
    held = (torch.arange(head().layout.frame_size) >= 3) * 1e8
    for _ in range(3):
        term = OutlineTerm(finder().samples.points, VIEW, found(state, mattes), known)
        state, _ = minimise(state, [term, FramePrior(truth.frames, held)], steps=4, hold_subject=True)
    off = (state.frames - truth.frames)[:, 2]
    assert off[4:].abs().max() < 0.001
    assert off[:4].abs().max() < 0.001


def test_points_that_are_never_at_the_outline_pull_at_nothing():
    truth = performed(FRAMES)
    outlines = found(truth, mattes_of(truth))
    nothing = outlines._replace(distances=torch.full_like(outlines.distances, torch.nan))
    term = OutlineTerm(finder().samples.points, VIEW, nothing, usual_distances(nothing))
    assert term.cost(beside(truth)) == 0.0
