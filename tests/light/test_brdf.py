import math

import numpy as np
import pytest
import torch

from samira_warp.light.brdf import brdf_table, integrate_brdf
from samira_warp.reference.shading import deferred as reference


def quadrature(roughness, cosine, polar=800, turns=400):
    """(B_x, B_y) summed over half vectors at midpoints, from the microfacet model as it is written in
    books."""
    alpha = roughness**2
    psi = (np.arange(polar) + 0.5) / polar * (math.pi / 2)
    theta = np.arctan(alpha * np.tan(psi))[:, None]
    step = (alpha / np.cos(psi) ** 2 / (1 + (alpha * np.tan(psi)) ** 2) * (math.pi / 2 / polar))[:, None]
    turn = (np.arange(turns) + 0.5) / turns * 2 * math.pi
    view_half = math.sqrt(1 - cosine**2) * np.sin(theta) * np.cos(turn) + cosine * np.cos(theta)
    light = 2 * view_half * np.cos(theta) - cosine
    distribution = alpha**2 / (math.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)
    smith = [np.sqrt(1 + alpha**2 * (1 / x**2 - 1)) for x in (cosine, np.where(light > 0, light, 1.0))]
    masking = 2 / (smith[0] + smith[1])
    # f n.l dOmega_l = D G / (4 n.l n.v) n.l 4 (v.h) dOmega_h
    terms = np.where(
        light > 0,
        distribution * masking / cosine * view_half * np.sin(theta) * step * (2 * math.pi / turns),
        0.0,
    )
    schlick = (1 - view_half) ** 5
    return (terms * (1 - schlick)).sum(), (terms * schlick).sum()


def look_up(roughness, cosine):
    table = brdf_table(roughness.device)
    return torch.cat(reference.lookup_brdf(table, roughness[:, None], cosine[:, None]), dim=-1)


def test_brdf_table_matches_quadrature(generator):
    options = {"generator": generator, "dtype": torch.float64}
    roughness = 0.08 + 0.92 * torch.rand(50, **options)
    cosine = 0.02 + 0.98 * torch.rand(50, **options) ** 2
    expected = np.array([quadrature(r, c) for r, c in zip(roughness.tolist(), cosine.tolist(), strict=True)])
    assert np.abs(integrate_brdf(roughness.numpy(), cosine.numpy()) - expected).max() < 5e-4
    assert np.abs(look_up(roughness, cosine).numpy() - expected).max() < 1e-3


def test_brdf_table_is_bounded_and_right_for_a_mirror(device):
    table = brdf_table(device)
    assert table.isfinite().all()
    assert table.min() >= 0
    # A white metal reflects at most what it gets: B_x + B_y <= 1.
    assert table.sum(dim=-1).max() <= 1 + 1e-4
    cosine = torch.tensor([0.1, 0.5, 0.9], device=device)
    schlick = (1 - cosine) ** 5
    terms = look_up(torch.zeros_like(cosine), cosine)
    # The bilinear error of (1 - c)^5 between 96 nodes.
    assert torch.allclose(terms, torch.stack([1 - schlick, schlick], dim=-1), atol=1e-3)


def test_brdf_lookup_hits_the_corner_nodes(device):
    corners = look_up(
        torch.tensor([0.0, 1.0, 1.0], device=device), torch.tensor([1.0, 1.0, 0.0], device=device)
    )
    # At n . v = 0 the lookup stops at 1e-6, a tenth of a node away.
    assert torch.allclose(corners, brdf_table(device)[[0, -1, -1], [-1, -1, 0]], atol=5e-3)


def test_brdf_gradients(generator):
    roughness = (0.1 + 0.85 * torch.rand(20, generator=generator, dtype=torch.float64)).requires_grad_()
    cosine = (0.05 + 0.9 * torch.rand(20, generator=generator, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(look_up, (roughness, cosine), eps=1e-7)


def slope(function, at, step):
    """One-sided difference quotient, from ``at`` towards ``at + step``."""
    return (function(at + step) - function(at)) / step


@pytest.mark.parametrize(("at", "step"), [(0.08, 1e-3), (1.0, -1e-3)])
def test_roughness_slope_at_the_borders(at, step):
    cosine = np.array([0.05, 0.2, 0.6, 1.0])
    roughness = torch.full((4,), at, dtype=torch.float64, requires_grad=True)
    terms = look_up(roughness, torch.from_numpy(cosine))
    grads = torch.stack(
        [torch.autograd.grad(term.sum(), roughness, retain_graph=True)[0] for term in terms.T], dim=1
    )
    wanted = slope(lambda r: integrate_brdf(r, cosine), at, step)
    # Between nodes 1 / 95 apart a slope is that of the middle: off by half a node times a curvature of up to
    # 8.
    assert np.abs(grads.numpy() - wanted).max() < 0.045


@pytest.mark.parametrize(("at", "step"), [(0.02, 1e-4), (1.0, -1e-4)])
def test_view_slope_at_the_borders(at, step):
    roughness = torch.tensor([0.1, 0.3, 0.6, 1.0], dtype=torch.float64)
    cosine = torch.full((4,), at, dtype=torch.float64, requires_grad=True)
    terms = look_up(roughness, cosine)
    grads = torch.stack(
        [torch.autograd.grad(term.sum(), cosine, retain_graph=True)[0] for term in terms.T], dim=1
    ).numpy()
    wanted = slope(lambda c: integrate_brdf(roughness.numpy(), np.full(4, c)), at, step)
    # The same, by the root of n . v: half a node of 1 / 95, times curvatures in proportion to the slopes.
    assert np.abs(grads - wanted).max() < 0.06 * np.abs(wanted).max() + 0.01


def test_no_slope_beyond_the_borders():
    roughness = torch.tensor([-0.1, 1.1, 0.5, 0.5], dtype=torch.float64, requires_grad=True)
    cosine = torch.tensor([0.5, 0.5, -0.1, 1.1], dtype=torch.float64, requires_grad=True)
    by_roughness, by_cosine = torch.autograd.grad(look_up(roughness, cosine).sum(), (roughness, cosine))
    assert (by_roughness != 0).tolist() == [False, False, True, True]
    assert (by_cosine != 0).tolist() == [True, True, False, False]


def test_the_table_is_made_once(device):
    assert brdf_table(device) is brdf_table(device)
