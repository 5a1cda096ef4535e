"""The ray caster against closed forms, a sum over the whole sky, and itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from samira_subject import raycaster
from samira_subject.raycaster import Effort, PosedSkin, Skin
from samira_subject.raycaster_sampling import SkyTables
from samira_subject.sky import CAPTURE, SKIES, paint_sky
from samira_warp.geometry.camera import Camera
from samira_warp.light import DirectionalLight, LightRig
from samira_warp.light.equirect import equirect_directions, row_solid_angles

EVEN = Effort(samples=8, lights=4, lobes=3, rounds=0)


def uniform_sky(radiance=1.0):
    return SkyTables.build(torch.full((64, 128, 3), radiance))


def skin(vertices, faces, *, albedo=0.5, roughness=0.5, specular=0.0, texel_columns=None):
    """A surface of one stuff, or, with one albedo a column of texels, of each triangle's own: its corners lie
    in that column."""
    columns = torch.tensor(texel_columns or [albedo])
    count = len(columns)
    size = 4 * count
    maps = columns.repeat_interleave(4)[None, :, None].expand(size, size, 3).contiguous()
    column_of = torch.arange(len(faces)) * count // len(faces)
    uv = torch.stack([(column_of + 0.5) / count, torch.full((len(faces),), 0.5)], dim=1)
    return Skin(
        faces=torch.tensor(faces, dtype=torch.int32),
        corner_uv=uv[:, None].expand(-1, 3, -1).contiguous(),
        albedo=maps,
        finish=torch.tensor([roughness, specular, 0.0]).expand(size, size, 3).contiguous(),
        rest=torch.tensor(vertices, dtype=torch.float32),
    )


def posed(surface, slopes=None):
    size = surface.albedo.shape[0]
    return PosedSkin(surface, surface.rest, torch.zeros(size, size, 3) if slopes is None else slopes)


def square(**stuff):
    """A large square at z = 0 that faces +z."""
    corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
    return posed(skin(corners, [[0, 1, 2], [0, 2, 3]], **stuff))


def sphere(rings=24, **stuff):
    """A sphere of radius 0.1 about the origin."""
    polar, around = np.meshgrid(
        np.linspace(0.0, np.pi, rings + 1), np.arange(2 * rings) * np.pi / rings, indexing="ij"
    )
    points = 0.1 * np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1
    ).reshape(-1, 3)
    ring, column = (
        grid.ravel() for grid in np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    )
    a, b = ring * 2 * rings + column, ring * 2 * rings + (column + 1) % (2 * rings)
    faces = np.concatenate(
        [np.stack([a, a + 2 * rings, b + 2 * rings], 1), np.stack([a, b + 2 * rings, b], 1)]
    )
    points = np.round(points, 9)
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    faces = same.reshape(-1)[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return posed(skin(points[first].tolist(), faces.tolist(), **stuff))


def camera(size=16, *, field=0.1, center=(0.0, 0.0, 1.0)):
    """A camera that looks along -z at so many metres' width one metre ahead."""
    world_to_camera = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ torch.tensor(center)
    return Camera(world_to_camera, size / field, size / field, size / 2, size / 2, size, size)


def test_a_diffuse_sphere_under_an_even_sky_shows_its_albedo():
    picture = sphere(albedo=0.6).render(camera(field=0.25), uniform_sky(2.0), effort=EVEN, seed=1)
    inside = picture.coverage == 1
    assert 40 < int(inside.sum()) < 256
    # a convex body under an even sky leaves nothing to chance; a table of cosines is good to some 1e-4
    assert picture.radiance[inside] == pytest.approx(1.2, rel=1e-3)
    assert picture.albedo[inside] == pytest.approx(0.6)
    assert not picture.radiance[picture.coverage == 0].any()


@pytest.mark.parametrize(
    ("roughness", "least", "most"), [(0.2, 0.988, 0.999), (0.5, 0.838, 0.917), (0.8, 0.554, 0.693)]
)
def test_a_mirror_sphere_reflects_no_more_than_it_receives(roughness, least, most):
    """The bounds are what GGX reflects at cosines of 0.3 to 1, of a single scattering, by the trapezoid
    rule."""
    sphere_of_metal = sphere(albedo=0.0, specular=1.0, roughness=roughness)
    picture = sphere_of_metal.render(
        camera(field=0.15), uniform_sky(), effort=replace(EVEN, samples=64), seed=1
    )
    inside = picture.coverage == 1
    mean, error = picture.radiance[inside].mean(), picture.error[inside].square().sum().sqrt() / inside.sum()
    assert least - 4 * error < mean < most + 4 * error


def test_mirrored_light_is_apart():
    """Of a black body it is all of the light, of a matte one none, of both what it is of the first."""
    sky = SkyTables.build(paint_sky(SKIES["stage"], height=32))
    stuff = [(0.0, 0.2), (0.4, 0.0), (0.4, 0.2)]
    black, matte, both = (
        sphere(albedo=albedo, specular=specular).render(camera(field=0.15), sky, effort=EVEN, seed=1)
        for albedo, specular in stuff
    )
    # the same float32 sums, and one product more
    torch.testing.assert_close(black.specular, black.radiance, rtol=1e-5, atol=1e-6)
    assert black.specular.max() > 0.1
    assert not matte.specular.any()
    assert matte.radiance.max() > 0.1
    # a convex body sends itself no light, and draws depend on its shape and roughness alone
    torch.testing.assert_close(both.specular, black.specular, rtol=1e-5, atol=1e-6)
    inside = both.coverage > 0
    for picture, (_, specular) in zip((black, matte, both), stuff, strict=True):
        expected = torch.tensor([0.5, specular, 0.0]).expand(int(inside.sum()), 3)
        torch.testing.assert_close(picture.finish[inside], expected, rtol=1e-5, atol=1e-6)


def brute_force(radiance, *, albedo, roughness, specular, finer=8):
    """(3,) float64 radiance towards +z of a surface that faces +z: the sum over a sky whose texels are each
    cut into many."""
    fine = radiance.double().repeat_interleave(finer, dim=0).repeat_interleave(finer, dim=1)
    height, width = fine.shape[:2]
    light = equirect_directions(height).double()
    edges = torch.cos(torch.linspace(0.0, math.pi, height + 1, dtype=torch.float64))
    angles = ((edges[:-1] - edges[1:]) * 2 * math.pi / width)[:, None, None]
    cosine = light[..., 2:].clamp(min=0.0)
    half = torch.nn.functional.normalize(light + torch.tensor([0.0, 0.0, 1.0]), dim=-1)[..., 2:]
    alpha2 = roughness**4
    facets = alpha2 / (math.pi * (half**2 * (alpha2 - 1) + 1) ** 2)
    # Smith's height-correlated masking over 4 cos cos, for a view along the normal
    masking = 0.5 / (torch.sqrt(alpha2 + (1 - alpha2) * cosine**2) + cosine)
    fresnel = specular + (1 - specular) * (1 - half) ** 5
    return (fine * angles * cosine * (albedo / math.pi + facets * masking * fresnel)).sum(dim=(0, 1))


@pytest.mark.parametrize("name", ["studio", "stage"])
@pytest.mark.parametrize("drawn", [(4, 1), (1, 4), (6, 0)])
@pytest.mark.parametrize("evenly", [0.0, 0.5])
def test_every_way_of_drawing_gives_the_sum_over_the_sky(name, drawn, evenly):
    radiance = paint_sky(SKIES[name], height=32)
    stuff = {"albedo": 0.3, "roughness": 0.4, "specular": 0.05}
    effort = Effort(samples=64, lights=drawn[0], lobes=drawn[1], rounds=0)
    # a narrow field: every pixel looks along -z to half a degree
    sky = SkyTables.build(radiance, evenly=evenly)
    picture = square(**stuff).render(camera(field=0.01), sky, effort=effort, seed=5)
    expected = brute_force(radiance, **stuff)
    found = picture.radiance.double().mean(dim=(0, 1))
    spread = picture.radiance.double().flatten(0, 1).std(dim=0) / 16
    # 4 standard errors of the mean of 256 pixels, and 1e-3 for the table of irradiance
    assert ((found - expected).abs() < 4 * spread + 1e-3 * expected).all(), (found, expected, spread)


@pytest.mark.parametrize("wall_albedo", [0.0, 0.8])
def test_a_wall_takes_half_the_sky_and_sends_a_share_back(wall_albedo):
    """A floor that faces +z and a wall at x = 0 that faces +x, both far larger than the patch at their seam
    that is seen."""
    corners = [[0, -5, 0], [5, -5, 0], [5, 5, 0], [0, 5, 0], [0, -5, 5], [0, 5, 5]]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]]
    # vertices are shared, but their normals must not be: each plane gets its own
    vertices = [corners[index] for face in faces for index in face]
    surface = posed(skin(vertices, np.arange(12).reshape(4, 3).tolist(), texel_columns=[0.5, wall_albedo]))
    effort = Effort(samples=64, lights=4, lobes=4, rounds=0)
    picture = surface.render(
        camera(field=0.002, center=(0.01, 0.0, 1.0)), uniform_sky(), effort=effort, seed=3
    )
    # the wall sees half the sky and half the floor, which sees half the sky; light that goes on from there is
    # not followed
    wall = wall_albedo * (0.5 + 0.5 * 0.5 * 0.5)
    expected = 0.5 * (0.5 + 0.5 * wall)
    spread = float(picture.radiance[..., 0].std()) / 16
    # the wall ends after 5 m and the patch lies 1 cm from it: 1e-3 of the sky
    assert abs(float(picture.radiance[..., 0].mean()) - expected) < 4 * spread + 2e-3


def test_the_same_bits_for_any_number_of_threads(use_threads, monkeypatch):
    """And however many pixels a thread is given at a time."""
    surface = sphere(albedo=0.5, specular=0.04)
    sky = SkyTables.build(paint_sky(SKIES[CAPTURE], height=32))
    pictures = []
    for count, at_once in ((1, 4096), (2, 4096), (2, 4096), (2, 100), (1, 7)):
        use_threads(count)
        monkeypatch.setattr(raycaster, "AT_ONCE", at_once)
        pictures.append(surface.render(camera(32, field=0.25), sky, effort=Effort(more=4, rounds=2), seed=9))
    for picture in pictures[1:]:
        assert all(torch.equal(mine, first) for mine, first in zip(picture, pictures[0], strict=True))
    other = surface.render(camera(32, field=0.25), sky, effort=Effort(more=4, rounds=2), seed=10)
    assert not torch.equal(other.radiance, pictures[0].radiance)


def test_the_error_is_that_of_pictures_with_other_seeds():
    surface = sphere(albedo=0.5, specular=0.04, roughness=0.4)
    sky = SkyTables.build(paint_sky(SKIES[CAPTURE], height=32))
    first, second = (
        surface.render(camera(32, field=0.15), sky, effort=replace(EVEN, samples=16), seed=seed)
        for seed in (1, 2)
    )
    weights = torch.tensor([0.2126, 0.7152, 0.0722])
    apart = ((first.radiance - second.radiance) @ weights).square().mean().sqrt()
    promised = (first.error.square() + second.error.square()).mean().sqrt()
    # samples are stratified: they do better than independent ones, but not by more than a few times
    assert 0.15 * promised < apart < 1.1 * promised


def test_more_rays_go_where_the_error_is_large():
    surface = sphere(albedo=0.5, specular=0.3, roughness=0.3)
    sky = SkyTables.build(paint_sky(SKIES["stage"], height=32))
    few, many = (
        surface.render(camera(32, field=0.15), sky, effort=Effort(rounds=rounds), seed=4) for rounds in (0, 4)
    )
    assert many.error.max() < 0.7 * few.error.max()
    # the rest is left as it was, bit by bit
    left = (few.coverage == 1) & (few.radiance == many.radiance).all(dim=2)
    assert 0 < int(left.sum()) < int((few.coverage == 1).sum())
    assert few.error[left].mean() < 0.5 * few.error[(few.coverage == 1) & ~left].mean()


def test_bumps_turn_the_normal_against_their_slope():
    surface = skin(
        [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]], [[0, 1, 2], [0, 2, 3]]
    )
    slopes = torch.tensor([0.3, 0.0, 0.0]).expand(4, 4, 3)
    picture = posed(surface, slopes.contiguous()).render(camera(8), uniform_sky(), effort=EVEN, seed=0)
    # the normal of z = 0.3 x
    expected = torch.tensor([-0.3, 0.0, 1.0]) / math.sqrt(1.09)
    assert torch.allclose(picture.normal, expected.expand(8, 8, 3), atol=1e-5)


def test_half_a_pixel_is_half_covered():
    surface = skin(
        [[0.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2], [0, 2, 3]]
    )
    picture = posed(surface).render(camera(5), uniform_sky(), effort=replace(EVEN, samples=16), seed=2)
    assert not picture.coverage[:, :2].any()
    assert (picture.coverage[:, 3:] == 1).all()
    # stratified samples: of 16, 8 lie in the right half
    assert picture.coverage[:, 2] == pytest.approx(0.5, abs=1 / 16)
    # what is seen of it is as bright as elsewhere
    assert picture.radiance[:, 2] == pytest.approx(0.5, rel=1e-3)


def test_a_small_lamp_casts_a_hard_shadow_where_geometry_puts_it():
    """A plate 30 mm before a wall, half a degree of sun from the right: its shadow lies 22.5 mm to the left.

    The lamp's edge blurs by 0.5 degrees to either side over 37.5 mm, and its panorama's texels by as much
    again: by 1 mm along the wall.
    """
    direction, irradiance = (0.6, 0.0, 0.8), 2.0
    lamp = LightRig((DirectionalLight(direction, (irradiance,) * 3),))
    corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
    plate = [[0.01 * x, 0.01 * y, 0.03] for x, y, _ in corners]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    scene = posed(skin(corners + plate, faces, albedo=0.1))
    sky = SkyTables.build(lamp.to_panorama(512))
    picture = scene.render(camera(size=100, field=0.1), sky, effort=EVEN, seed=1)
    across = 1000.0 * (torch.arange(100) + 0.5 - 50.0) * 0.001
    wall = across.abs() > 11.0  # 10 / 0.97 mm, where the plate hides it
    dark = (across > -31.5) & (across < -13.5) & wall
    lit = ((across < -33.5) | (across > 11.5)) & wall
    row = picture.radiance[50, :, 0]
    # table of irradiance: a lamp at the edge of no block's horizon, to 1e-3
    assert row[lit].numpy() == pytest.approx(0.1 / math.pi * 0.8 * irradiance, rel=5e-3)
    # what the plate's back sends on: its albedo times the wall's light, at most
    assert float(row[dark].max()) < 0.1 * 0.1 / math.pi * 0.8 * irradiance


def sun_and_fill():
    """A sun on the right (+x), and a fill a hundred times as weak on the left: next to no draw goes to it."""
    sun = DirectionalLight((1.0, 0.0, 0.2), (10.0,) * 3)
    fill = DirectionalLight((-1.0, 0.0, 0.4), (0.1,) * 3, radius=30.0)
    return LightRig((sun, fill)).to_panorama(256)


@pytest.mark.parametrize("evenly", [0.0, 0.5])
def test_no_pixel_is_black_for_want_of_a_draw(evenly):
    """On a convex body nothing is left to chance, however few rays there are."""
    sky, few = SkyTables.build(sun_and_fill(), evenly=evenly), Effort(samples=2, lights=1, lobes=1, rounds=0)
    view = camera(field=0.25, size=32)
    picture = sphere(albedo=0.5).render(view, sky, effort=few, seed=1)
    shaded = (picture.coverage == 1) & (picture.normal[..., 0] < -0.3) & (picture.normal[..., 2] > 0.3)
    cosines = (picture.normal @ torch.tensor([-1.0, 0.0, 0.4]) / math.hypot(1.0, 0.4))[shaded]
    assert len(cosines) > 40
    # normals are means over a pixel of 8 mm on a sphere of 100, cosines of a 30 degree lamp at its horizon
    assert picture.radiance[shaded][:, 0].numpy() == pytest.approx(
        (0.5 / math.pi * 0.1 * cosines).numpy(), rel=0.05, abs=2e-4
    )


def test_draws_that_go_evenly_are_still_chances():
    radiance = sun_and_fill()
    by_brightness, evenly = (SkyTables.build(radiance, evenly=share) for share in (0.0, 0.5))
    directions = equirect_directions(len(radiance))
    angles = row_solid_angles(*radiance.shape[:2])[:, None]
    shares = []
    for tables in (by_brightness, evenly):
        chances = tables.density.double() * angles
        assert float(chances.sum()) == pytest.approx(1.0, rel=1e-5)
        shares.append(float(chances[directions[..., 0] < 0].sum()))
    # the fill's radiance and the sky's mean are of one size: it gets most of the even half
    assert shares[0] < 0.03
    assert shares[1] > 0.3
