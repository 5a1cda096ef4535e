"""Shaded spheres against answers that this package did not make: closed forms, and Monte Carlo straight from
the panorama."""

import math

import numpy as np
import pytest
import torch

from samira_warp.bench.light_truth import Panorama, brdf_terms, seen_light
from samira_warp.io.images import write_exr
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light import Environment, shade
from samira_warp.surface import Surface

LAMP = torch.tensor([0.48, 0.6, 0.64])


def unit(values):
    return torch.nn.functional.normalize(values, dim=-1)


def sphere(count, generator):
    """Normals all around and views up to some 60 degrees from them."""
    normal = unit(torch.randn(count, 3, generator=generator))
    return normal, unit(normal + 0.5 * torch.randn(count, 3, generator=generator))


def shade_sphere(light, normal, view, *, albedo=0.0, roughness=0.5, specular=0.04, responses=(1.0, 1.0)):
    """The public path for one material; the result on the CPU, in float64."""
    device, count = light.irradiance.device, len(normal)
    roughness, specular, diffuse, shine = (
        torch.as_tensor(value).expand(count, 1).contiguous() for value in (roughness, specular, *responses)
    )
    surface = Surface.of(
        albedo=torch.full((count, 3), albedo),
        normal=normal,
        roughness=roughness,
        specular=specular,
        response_diffuse=diffuse,
        response_specular=shine,
    ).map(lambda values: values.to(device))
    shaded = shade(surface, view.to(device), light, color_space="raw")
    return type(shaded)(*(values.cpu().double() for values in shaded))


def sky(function, device, size=64):
    radiance = (
        function(texel_directions(size)).float()[..., None].expand(-1, -1, -1, 3).contiguous().to(device)
    )
    return Environment(radiance, radiance)


def test_diffuse_sphere_under_a_uniform_sky_shows_its_albedo(device, generator):
    light = sky(lambda d: torch.full_like(d[..., 0], 3.0), device, size=32).filtered()
    shaded = shade_sphere(light, *sphere(200, generator), albedo=0.7, specular=0.0, responses=(1.0, 0.0))
    # Not normalised: the cosine's midpoints at 32 texels along a face, 1e-3 of the light at most.
    assert (shaded.image - 3 * 0.7).abs().max() < 1e-3 * 3


def test_diffuse_sphere_under_half_a_sky(device, generator):
    normal, view = sphere(500, generator)
    light = sky(lambda d: (d[..., 1] > 0).float(), device).filtered()
    shaded = shade_sphere(light, normal, view, albedo=0.5, specular=0.0, responses=(1.0, 0.0))
    # The part of the cosine lobe above the horizon; the error is the lookup's, h^2 / 4 for texels h = 0.12
    # rad apart.
    assert (shaded.color - 0.5 * (1 + normal[:, 1:2]) / 2).abs().max() < 0.5 * 4e-3


def test_diffuse_sphere_under_a_distant_lamp(device, generator):
    normal, view = sphere(500, generator)
    environment = sky(lambda d: 500.0 * (d @ LAMP > 0.999).float(), device)
    shaded = shade_sphere(
        environment.filtered(), normal, view, albedo=0.5, specular=0.0, responses=(1.0, 0.0)
    )
    flux = (environment.diffuse.cpu()[..., 0].double() * texel_solid_angles(64, dtype=torch.float64)).sum()
    difference = shaded.color[:, 0] - 0.5 * flux / math.pi * (normal @ LAMP).clamp(min=0)
    # At the terminator, where the slope jumps by 1, texels h = 0.12 rad apart are h / 4 off; elsewhere h^2 /
    # 8.
    assert difference.abs().max() < 0.5 * 0.03 * flux / math.pi
    assert difference.square().mean().sqrt() < 0.5 * 3e-3 * flux / math.pi


def test_mirror_sphere_reflects_the_light_by_schlick(device, generator):
    normal, view = sphere(300, generator)
    light = sky(lambda d: 1 + 0.5 * d[..., 0] + 0.3 * d[..., 1] ** 2, device, size=128).filtered()
    shaded = shade_sphere(light, normal, view, roughness=0.0, specular=0.04)
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = 2 * cosine * normal - view
    wanted = 1 + 0.5 * reflected[:, :1] + 0.3 * reflected[:, 1:2] ** 2
    # Bilinear between texels h = 0.012 rad apart, over curvatures below 1: h^2 / 4.
    assert (shaded.specular_light - wanted).abs().max() < 1e-4
    fresnel = 0.04 + 0.96 * (1 - cosine.clamp(min=0)) ** 5
    seen = (cosine > 0.05)[:, 0]
    assert seen.sum() > 250
    assert ((shaded.color - fresnel * wanted)[seen]).abs().max() < 2e-3


def test_white_furnace(device, generator):
    """Under a uniform light of 1 a white metal gives back what single scattering leaves: B_x + B_y, by Monte
    Carlo."""
    normal = unit(torch.randn(100, 3, generator=generator))
    view = unit(normal + 0.3 * torch.randn(100, 3, generator=generator))
    roughness = 0.1 + 0.9 * torch.rand(100, 1, generator=generator)
    light = sky(lambda d: torch.ones_like(d[..., 0]), device, size=32).filtered()
    shaded = shade_sphere(light, normal, view, roughness=roughness, specular=1.0)
    assert (shaded.specular_light - 1).abs().max() < 1e-5
    cosine = (normal * view).sum(dim=-1).double().numpy()
    truth = brdf_terms(
        roughness[:, 0].double().numpy(), cosine, samples=20000, generator=np.random.default_rng(0)
    )
    allowed = 4 * truth.error.sum(axis=-1) + 1e-3
    assert (np.abs(shaded.color[:, 0].numpy() - truth.mean.sum(axis=-1)) < allowed).all()


@pytest.fixture
def panorama():
    """A coloured sky with a soft lamp of some 30 degrees, as an artist would paint it, and a dark floor."""
    polar, azimuth = np.meshgrid(
        (np.arange(64) + 0.5) / 64 * np.pi, ((np.arange(128) + 0.5) / 128 - 0.5) * 2 * np.pi, indexing="ij"
    )
    directions = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], axis=-1
    )
    lamp = 12 * np.exp(25 * (directions @ LAMP.double().numpy() - 1))
    return Panorama(
        0.2
        + 0.3 * (1 + directions) * np.array([0.6, 0.8, 1.0]) * (directions[..., 1:2] > -0.3)
        + lamp[..., None]
    )


@pytest.mark.parametrize("roughness", [0.25, 0.5, 0.75, 1.0])
def test_rough_sphere_matches_monte_carlo(device, generator, panorama, tmp_path, roughness):
    """The whole way: a file, a cubemap, its mips, a lookup; against samples of the panorama alone."""
    write_exr(tmp_path / "light.exr", panorama.pixels.astype(np.float32))
    light = Environment.load(tmp_path / "light.exr", size=128).to(device).filtered()
    normal, view = sphere(40, generator)
    shaded = shade_sphere(light, normal, view, roughness=roughness)
    reflected = unit(2 * (normal * view).sum(dim=-1, keepdim=True) * normal - view).double().numpy()
    truth = seen_light(
        panorama, reflected, np.full(40, roughness), samples=4000, generator=np.random.default_rng(0)
    )
    # Four standard errors, and the lookup between texels: h^2 / 8 of a lobe's curvature, under 1 % of the
    # lamp.
    assert (
        np.abs(shaded.specular_light.numpy() - truth.mean) < 4 * truth.error + 1e-2 * truth.mean.max()
    ).all()


def test_colour_of_a_painted_sphere_matches_monte_carlo(device, generator, panorama, tmp_path):
    """Every term of Eq. pbr_color at once."""
    write_exr(tmp_path / "light.exr", panorama.pixels.astype(np.float32))
    light = Environment.load(tmp_path / "light.exr", size=128).to(device).filtered()
    normal, view = sphere(60, generator)
    visible = (normal * view).sum(dim=-1) > 0.1
    normal, view = normal[visible], view[visible]
    count, random = len(normal), np.random.default_rng(0)
    shaded = shade_sphere(light, normal, view, albedo=0.6, roughness=0.5, specular=0.3, responses=(0.8, 1.2))
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = unit(2 * cosine * normal - view).double().numpy()
    diffuse = seen_light(panorama, normal.double().numpy(), np.ones(count), samples=4000, generator=random)
    shine = seen_light(panorama, reflected, np.full(count, 0.5), samples=4000, generator=random)
    terms = brdf_terms(np.full(count, 0.5), cosine[:, 0].double().numpy(), samples=20000, generator=random)
    factor, factor_error = (0.3 * part[:, :1] + part[:, 1:] for part in terms)
    truth = 0.6 * 0.7 * 0.8 * diffuse.mean + 1.2 * shine.mean * factor
    error = 0.6 * 0.7 * 0.8 * diffuse.error + 1.2 * (shine.error * factor + shine.mean * factor_error)
    assert (np.abs(shaded.color.numpy() - truth) < 4 * error + 1e-2 * truth.max()).all()


def test_the_estimates_of_truth_are_right_themselves():
    """A uniform light gives 1, a lamp of one pixel its energy, and the errors say how far off they are."""
    random = np.random.default_rng(0)
    directions = unit(torch.randn(60, 3, generator=torch.Generator().manual_seed(0))).double().numpy()
    for roughness in (0.1, 0.5, 1.0):
        estimate = seen_light(
            Panorama(np.ones((32, 64, 3))), directions, np.full(60, roughness), samples=500, generator=random
        )
        assert (np.abs(estimate.mean - 1) < 4 * estimate.error).all()
    pixels = np.zeros((64, 128, 3))
    pixels[20, 30] = 1000.0
    lamp = Panorama(pixels)
    polar, azimuth = 20.5 / 64 * np.pi, (30.5 / 128 - 0.5) * 2 * np.pi
    towards = np.array([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)])
    estimate = seen_light(lamp, directions, np.ones(60), samples=20000, generator=random)
    wanted = 1000 * np.sin(polar) * (np.pi / 64) ** 2 / np.pi * np.maximum(directions @ towards, 0)
    # The lamp is a bilinear tent of two pixels, 0.1 rad: one per cent.
    assert (np.abs(estimate.mean[:, 0] - wanted) < 4 * estimate.error[:, 0] + 1e-2 * wanted.max()).all()
