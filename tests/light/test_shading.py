import math

import numpy as np
import pytest
import torch

from samira_warp.errors import UserError
from samira_warp.kernels.cubemap import texel_directions, texel_solid_angles
from samira_warp.light import Environment, FilteredLight, compose, decode_srgb, encode_srgb, shade
from samira_warp.light.brdf import brdf_table, integrate_brdf
from samira_warp.reference import shading as reference

NAMES = ("albedo", "normal", "roughness", "specular", "response_diffuse", "response_specular", "view")


def surface(count, generator, dtype=torch.float64):
    """G-buffer values in their ranges, n . v from about 0.1 to 1."""
    options = {"generator": generator, "dtype": dtype}
    normal = torch.nn.functional.normalize(torch.randn(count, 3, **options), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.4 * torch.randn(count, 3, **options), dim=-1)
    scalar = [torch.rand(count, 1, **options) for _ in range(4)]
    roughness, specular, diffuse, shine = scalar
    return torch.rand(count, 3, **options), normal, 0.08 + 0.9 * roughness, 0.02 + 0.1 * specular, 0.5 + diffuse, 0.5 + shine, view


def quadrature(roughness, cosine, polar=800, turns=400):
    """(B_x, B_y) summed over half vectors at midpoints, from the microfacet model as it is written in books."""
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
    terms = np.where(light > 0, distribution * masking / cosine * view_half * np.sin(theta) * step * (2 * math.pi / turns), 0.0)
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
    corners = look_up(torch.tensor([0.0, 1.0, 1.0], device=device), torch.tensor([1.0, 1.0, 0.0], device=device))
    # At n . v = 0 the lookup stops at 1e-6, a tenth of a node away.
    assert torch.allclose(corners, brdf_table(device)[[0, -1, -1], [-1, -1, 0]], atol=5e-3)


def test_brdf_gradients(generator):
    roughness = (0.1 + 0.85 * torch.rand(20, generator=generator, dtype=torch.float64)).requires_grad_()
    cosine = (0.05 + 0.9 * torch.rand(20, generator=generator, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(look_up, (roughness, cosine), eps=1e-7)


def test_roughness_gradient_at_and_beyond_the_borders(device, generator):
    values = [value.float().to(device) for value in surface(4, generator)]
    values[2] = torch.tensor([[-0.1], [0.0], [1.0], [1.1]], device=device, requires_grad=True)
    maps = [torch.rand(6, size, size, 3, generator=generator).to(device) for size in (4, 8, 4, 4, 4, 4)]
    shaded = shade(*values, FilteredLight(maps[0], tuple(maps[1:])))
    grads = torch.autograd.grad(shaded.color.sum(), values[2])[0].flatten() != 0
    assert grads.tolist() == [False, True, True, False]


def test_shade_matches_the_reference(device, generator):
    values = [value.requires_grad_() for value in surface(1000, generator)]
    sizes = (16, 8, 4, 4, 2)
    options = {"generator": generator, "dtype": torch.float64}
    maps = [torch.rand(6, size, size, 3, **options).requires_grad_() for size in (16, *sizes)]
    upstream = [torch.randn(1000, 3, **options) for _ in range(4)]
    expected = reference.shade_gbuffer(*values, irradiance=maps[0], mips=tuple(maps[1:]), brdf=brdf_table(torch.device("cpu")))
    expected_grads = torch.autograd.grad(expected, [*values, *maps], upstream)
    inner = [tensor.detach().float().to(device).requires_grad_() for tensor in [*values, *maps]]
    result = shade(*inner[:7], FilteredLight(inner[7], tuple(inner[8:])))
    grads = torch.autograd.grad(result, inner, [grad.float().to(device) for grad in upstream])
    for value, wanted in zip(result, expected, strict=True):
        assert torch.allclose(value.cpu().double(), wanted, atol=1e-5)
    for name, grad, wanted in zip((*NAMES, "irradiance", *("specular",) * 5), grads, expected_grads, strict=True):
        grad = grad.cpu().double()
        # Single precision moves a few lookups to the next cell, where the slope is another one.
        assert (grad - wanted).norm() <= 2e-3 * wanted.norm(), name
        assert torch.nn.functional.cosine_similarity(grad.flatten(), wanted.flatten(), dim=0) > 0.99999, name


def test_reference_gradients_are_those_of_finite_differences(generator):
    values = [value.requires_grad_() for value in surface(3, generator)]
    maps = [torch.rand(6, size, size, 3, generator=generator, dtype=torch.float64) for size in (2, 4, 2)]
    brdf = brdf_table(torch.device("cpu"))

    def run(*values):
        return tuple(reference.shade_gbuffer(*values, irradiance=maps[0], mips=tuple(maps[1:]), brdf=brdf))

    assert torch.autograd.gradcheck(run, values, eps=1e-7, atol=1e-4)


def test_same_bits_for_any_number_of_threads(device, generator):
    values = [value.float().to(device).requires_grad_() for value in surface(9000, generator)]
    maps = [torch.rand(6, size, size, 3, generator=generator).to(device).requires_grad_() for size in (16, 32, 16, 8, 4, 4)]

    def run():
        result = shade(*values, FilteredLight(maps[0], tuple(maps[1:])))
        return *result, *torch.autograd.grad(result.color.square().sum(), [*values, *maps])

    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = run()
        torch.set_num_threads(2)
        two = run()
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def constant_surface(normal, device, roughness=0.5, specular=0.0):
    count = normal.shape[0]
    ones = torch.ones(count, 1, device=device)
    return torch.ones(count, 3, device=device), normal, roughness * ones, specular * ones, ones, ones, normal


def sky(function, size=64):
    radiance = function(texel_directions(size)).float()[..., None].expand(-1, -1, -1, 3).contiguous()
    return Environment(radiance, radiance)


def test_diffuse_sphere_under_half_a_sky(device, generator):
    normal = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=-1)
    light = sky(lambda d: (d[..., 1] > 0).float()).to(device).filtered()
    seen = shade(*constant_surface(normal.to(device), device), light).irradiance.cpu()
    # The part of the cosine lobe above the horizon; the error is the lookup's, h^2 / 4 for texels h = 0.12 rad apart.
    assert (seen - (1 + normal[:, 1:2]) / 2).abs().max() < 4e-3


def test_diffuse_sphere_under_a_lamp(device, generator):
    normal = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=-1)
    lamp = torch.tensor([0.6, 0.0, 0.8])
    environment = sky(lambda d: 500.0 * (d @ lamp > 0.999).float()).to(device)
    seen = shade(*constant_surface(normal.to(device), device), environment.filtered()).irradiance[:, 0].cpu()
    area = (environment.diffuse.cpu()[..., 0].double() * texel_solid_angles(64, dtype=torch.float64)).sum() / math.pi
    difference = seen - area * (normal @ lamp).clamp(min=0)
    # At the terminator, where the slope jumps by 1, texels h = 0.12 rad apart are h / 4 off; elsewhere h^2 / 8.
    assert difference.abs().max() < 0.03 * area
    assert difference.square().mean().sqrt() < 3e-3 * area


def test_mirror_sphere_sees_the_reflected_light(device, generator):
    normal = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * torch.randn(300, 3, generator=generator), dim=-1)
    environment = sky(lambda d: 1 + 0.5 * d[..., 0] + 0.3 * d[..., 1] ** 2, size=128).to(device)
    values = list(constant_surface(normal.to(device), device, roughness=0.0))
    values[6] = view.to(device)
    seen = shade(*values, environment.filtered()).specular_light[:, 0].cpu()
    reflected = 2 * (normal * view).sum(dim=-1, keepdim=True) * normal - view
    wanted = 1 + 0.5 * reflected[:, 0] + 0.3 * reflected[:, 1] ** 2
    assert (seen - wanted).abs().max() < 1e-3


def test_rough_sphere_matches_monte_carlo(device, generator):
    """E_s is the mean of the light over GGX half vectors about the normal, weighted by n . l."""
    environment = sky(lambda d: torch.exp(4 * (d @ torch.tensor([0.48, 0.6, 0.64]) - 1)), size=64).to(device)
    normal = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator, dtype=torch.float64), dim=-1)
    for roughness in (0.5, 1.0):
        values = constant_surface(normal.float().to(device), device, roughness=roughness)
        seen = shade(*values, environment.filtered()).specular_light[:, 0].cpu()
        count = 20000
        u, turn = torch.rand(count, generator=generator, dtype=torch.float64), 2 * math.pi * torch.rand(count, generator=generator)
        cosine = torch.sqrt((1 - u) / (1 + (roughness**4 - 1) * u))
        sine = torch.sqrt(1 - cosine**2)
        half = torch.stack([sine * torch.cos(turn), sine * torch.sin(turn), cosine], dim=-1)
        local = 2 * cosine[:, None] * half - torch.tensor([0.0, 0.0, 1.0])
        weight = local[:, 2].clamp(min=0)
        for n, value in zip(normal, seen, strict=True):
            tangent = torch.nn.functional.normalize(torch.linalg.cross(n, n.roll(1)), dim=0)
            frame = torch.stack([tangent, torch.linalg.cross(n, tangent), n])
            light = torch.exp(4 * (local @ frame @ torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64) - 1))
            mean = (weight * light).sum() / weight.sum()
            error = (weight * (light - mean)).std() / weight.mean() / math.sqrt(count)
            # Four standard errors, and the bilinear lookup between texels 0.2 rad apart: h^2 / 8 of a curvature of 4.
            assert abs(value - mean) < 4 * error + 2e-2 * seen.max()


def test_white_furnace(device, generator):
    """A uniform light of 1: diffuse gives the albedo, the mirror part f B_x + B_y, whatever the direction."""
    values = [value.float().to(device) for value in surface(200, generator)]
    values[4:6] = [torch.ones_like(values[4])] * 2
    shaded = shade(*values, sky(lambda d: torch.ones_like(d[..., 0]), size=32).to(device).filtered())
    assert torch.allclose(shaded.irradiance, torch.ones_like(shaded.irradiance), atol=1e-3)
    assert torch.allclose(shaded.specular_light, torch.ones_like(shaded.irradiance), atol=1e-4)


def test_zero_normals_see_nothing_and_send_no_nan(device):
    values = [torch.zeros(2, n, device=device, requires_grad=True) for n in (3, 3, 1, 1, 1, 1, 3)]
    maps = [torch.rand(6, 4, 4, 3, device=device, requires_grad=True) for _ in range(6)]
    shaded = shade(*values, FilteredLight(maps[0], tuple(maps[1:])))
    grads = torch.autograd.grad(shaded.color.sum(), [*values, *maps])
    assert not shaded.color.any()
    assert all(grad.isfinite().all() for grad in grads)


def test_no_points(device):
    light = FilteredLight(torch.ones(6, 2, 2, 3, device=device), (torch.ones(6, 2, 2, 3, device=device),) * 5)
    assert shade(*(torch.empty(0, n, device=device) for n in (3, 3, 1, 1, 1, 1, 3)), light).color.shape == (0, 3)


def test_wrong_shapes_are_refused():
    light = FilteredLight(torch.ones(6, 2, 2, 3), (torch.ones(6, 2, 2, 3),) * 5)
    with pytest.raises(UserError, match="roughness"):
        shade(torch.ones(4, 3), torch.ones(4, 3), torch.ones(4), *(torch.ones(4, 1),) * 3, torch.ones(4, 3), light)


def test_srgb_is_the_standard_and_inverts():
    # IEC 61966-2-1: 18 % grey is 0.4614, the line joins the curve to 1e-5.
    assert encode_srgb(torch.tensor([0.0, 0.18, 1.0], dtype=torch.float64)).tolist() == pytest.approx([0, 0.46135, 1], abs=1e-5)
    values = torch.tensor([-0.5, 0.0, 0.001, 0.0031308, 0.01, 0.5, 1.0, 40.0], dtype=torch.float64, requires_grad=True)
    encoded = encode_srgb(values)
    assert torch.allclose(decode_srgb(encoded), values, rtol=1e-6)
    assert (torch.autograd.grad(encoded.sum(), values)[0] > 0).all()
    smooth = torch.tensor([-0.5, 0.001, 0.01, 0.5, 40.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(encode_srgb, smooth)
    assert torch.autograd.gradcheck(decode_srgb, smooth)


def test_compose():
    foreground, alpha = torch.tensor([[0.18, 2.0, 0.0]]), torch.tensor([[0.25]])
    assert torch.allclose(compose(foreground, alpha, torch.ones(3), color_space="raw"), 0.25 * foreground + 0.75)
    expected = 0.25 * encode_srgb(0.5 * foreground) + 0.75
    assert torch.allclose(compose(foreground, alpha, torch.ones(3), exposure=0.5), expected)
