from dataclasses import replace

import pytest
import torch
from subjects import camera

from samira_warp.avatar.gbuffer import render_gbuffer
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, LIGHT_CHANNELS, SURFACE_CHANNELS, Surface

VALUES = {"roughness": 0.3, "specular": 0.04, "response_diffuse": 1.2, "response_specular": 0.7}


def gaussians_on_a_plane(count, generator, *, depth, device):
    """Flat discs of random size facing a camera at one metre from the origin, at one depth."""
    means = torch.rand(count, 3, generator=generator) * 0.24 - 0.12
    means[:, 2] = 1.0 - depth
    quaternions = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    scales = 0.005 + 0.01 * torch.rand(count, 3, generator=generator)
    opacities = 0.02 + 0.9 * torch.rand(count, generator=generator)
    return tuple(tensor.to(device) for tensor in (means, quaternions, scales, opacities))


def constant_surface(count, device):
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8]), dim=0)
    columns = {
        "albedo": torch.tensor([0.2, 0.5, 0.9]),
        "normal": normal,
        **{name: torch.tensor([value]) for name, value in VALUES.items()},
    }
    return Surface.of(
        **{name: value.to(device).expand(count, -1).contiguous() for name, value in columns.items()}
    )


def test_constant_surface_come_back_whatever_the_coverage(device, generator):
    count = 60
    surface = constant_surface(count, device)
    g = render_gbuffer(
        *gaussians_on_a_plane(count, generator, depth=1.0, device=device),
        surface,
        camera(40, device=device),
    )
    covered = g.alpha[..., 0] >= COVERED_ALPHA
    alphas = g.alpha[covered]
    assert alphas.min() < 0.05
    assert alphas.max() > 0.9
    assert not covered.all()
    for name in CHANNELS:
        found = getattr(g, name)[covered]
        # alpha and channels are float32 sums of the same weights: some roundings apart relative to the
        # channel
        torch.testing.assert_close(found, getattr(surface, name)[0].expand_as(found), atol=0, rtol=1e-5)
    torch.testing.assert_close(
        g.normal[covered].norm(dim=-1), torch.ones_like(alphas[:, 0]), atol=1e-6, rtol=0
    )


def test_depth_of_a_plane_is_its_distance_along_the_axis(device, generator):
    placed = gaussians_on_a_plane(60, generator, depth=0.8, device=device)
    g = render_gbuffer(*placed, constant_surface(60, device), camera(40, device=device))
    depth = g.depth[g.alpha >= COVERED_ALPHA]
    torch.testing.assert_close(depth, torch.full_like(depth, 0.8), atol=0, rtol=1e-5)


def test_nothing_is_where_nothing_is(device, generator):
    placed = gaussians_on_a_plane(3, generator, depth=-1.0, device=device)
    g = render_gbuffer(*placed, constant_surface(3, device), camera(16, device=device))
    for name in (*SURFACE_CHANNELS, "depth", "alpha"):
        assert (getattr(g, name) == 0).all()
    for name in LIGHT_CHANNELS:
        assert (getattr(g, name) == 1).all()
    assert not g.screen.visible.any()


def test_the_gradient_of_projected_means_is_kept_for_density_control(device, generator):
    means, *rest = gaussians_on_a_plane(20, generator, depth=1.0, device=device)
    g = render_gbuffer(means.requires_grad_(), *rest, constant_surface(20, device), camera(32, device=device))
    # straight channels of a constant do not move with the means; coverage does
    (g.alpha * torch.rand(32, 32, 1, generator=generator).to(device)).sum().backward()
    assert g.screen.means2d.grad.shape == (20, 2)
    seen = g.screen.visible
    assert (g.screen.means2d.grad[seen] != 0).any(dim=1).all()
    assert (g.screen.means2d.grad[~seen] == 0).all()


@pytest.mark.parametrize("name", CHANNELS)
def test_a_channel_of_another_width_is_refused(generator, name):
    placed = gaussians_on_a_plane(20, generator, depth=1.0, device=torch.device("cpu"))
    surface = constant_surface(20, torch.device("cpu"))
    values = getattr(surface, name)
    for wrong in (torch.cat([values, values], dim=1), values[:-1], values[:, 0]):
        with pytest.raises(UserError, match=rf"^{name}: expected float32 tensor of shape \(20, "):
            render_gbuffer(*placed, replace(surface, **{name: wrong}), camera(16))
