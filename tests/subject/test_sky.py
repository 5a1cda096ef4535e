"""The skies of the built-in subject and what rays know of them."""

import math

import pytest
import torch

from samira_subject.raycaster_sampling import IRRADIANCE_ROWS, SkyTables
from samira_subject.sky import CAPTURE, SKIES, Sky, Softbox, exposure_of, paint_sky
from samira_warp.io.images import write_exr
from samira_warp.light import Environment
from samira_warp.light.equirect import equirect_directions, turn_directions


def plain(*softboxes, grey=0.1):
    return Sky((grey,) * 3, (grey,) * 3, (grey,) * 3, softboxes)


def solid_angles(height):
    edges = torch.cos(torch.linspace(0.0, math.pi, height + 1, dtype=torch.float64))
    return ((edges[:-1] - edges[1:]) * math.pi / height)[:, None]


def test_an_even_sky_is_exposed_to_the_rule():
    # mean radiance and irradiance / pi are both 0.2
    assert exposure_of(paint_sky(plain(grey=0.2))) == pytest.approx(0.8 / 0.2, rel=1e-4)


@pytest.mark.parametrize(("azimuth", "column"), [(0.0, 0.0), (90.0, 0.75), (-90.0, 0.25), (180.0, 0.5)])
def test_a_softbox_stands_where_it_says(azimuth, column):
    radiance = paint_sky(plain(Softbox(azimuth, 0.0, 20.0, 20.0, (5.0, 5.0, 5.0))), height=64)
    row = radiance[32, :, 0]
    assert row.max() == pytest.approx(5.1)
    lit = (row > 3.0).nonzero().squeeze(1).double() + 0.5
    turn = torch.exp(2j * math.pi * lit / 128).mean().angle() / (2 * math.pi) % 1.0
    assert min(abs(float(turn) - column), 1 - abs(float(turn) - column)) < 1 / 128
    assert (radiance[:10] < 0.2).all()


def test_a_softbox_has_feathered_edges_and_its_size():
    radiance = paint_sky(
        plain(Softbox(0.0, 0.0, 40.0, 20.0, (1.0, 1.0, 1.0), feather=0.5), grey=0.0), height=128
    )[..., 0]
    directions = equirect_directions(128)
    elevation = torch.rad2deg(torch.asin(directions[..., 1]))
    lit = radiance > 0.0
    assert elevation[lit].max() == pytest.approx(10.0, abs=1.5)
    # no step between neighbours: an edge of a quarter of the height is 5 degrees or some 4 texels
    assert radiance.diff(dim=0).abs().max() < 0.55


@pytest.mark.parametrize("name", SKIES)
def test_lights_are_bright_but_no_suns(name):
    radiance = paint_sky(SKIES[name])
    assert radiance.isfinite().all()
    assert radiance.min() > 0.0
    brightness = radiance.double().mean(dim=2)
    surroundings = (brightness * solid_angles(128)).sum() / (4 * math.pi)
    assert 4 < brightness.max() / surroundings < 80
    # the brightest texels together are a lamp of many texels
    assert int((brightness > 0.5 * brightness.max()).sum()) > 50
    assert 0.3 < exposure_of(radiance) < 10


def test_lights_differ():
    """Each pair of lights shades a head by so different patterns that no gain makes one into the other."""
    seen = {
        name: SkyTables.build(paint_sky(sky, height=32)).irradiance[1:-1, 1:-1].flatten()
        for name, sky in SKIES.items()
    }
    names = list(seen)
    for index, one in enumerate(names):
        for other in names[index + 1 :]:
            assert torch.nn.functional.cosine_similarity(seen[one], seen[other], dim=0) < 0.97


def test_the_key_comes_from_the_subjects_left_as_the_package_reads_the_file(tmp_path):
    radiance = paint_sky(SKIES[CAPTURE], height=64)
    write_exr(tmp_path / "sky.exr", radiance.numpy())
    light = Environment.load(tmp_path / "sky.exr", size=32)
    key = SKIES[CAPTURE].softboxes[0]
    towards = turn_directions(
        torch.tensor([[math.sin(math.radians(key.azimuth)), 0.0, math.cos(math.radians(key.azimuth))]]), 0.0
    )
    towards = towards * math.cos(math.radians(key.elevation)) + torch.tensor(
        [0.0, math.sin(math.radians(key.elevation)), 0.0]
    )
    # the lamp and what of the sky is behind it
    assert float(light.visible.look(towards)[0, 0]) == pytest.approx(key.radiance[0], rel=0.1)


def test_irradiance_is_the_sum_over_the_sky():
    radiance = paint_sky(SKIES["stage"], height=64)
    found = SkyTables.build(radiance).irradiance[1:-1, 1:-1].reshape(-1, 3)
    normals = equirect_directions(IRRADIANCE_ROWS).double().view(-1, 3)
    generator = torch.Generator().manual_seed(0)
    some = torch.randint(len(normals), (50,), generator=generator)
    light = equirect_directions(64).double().view(-1, 3)
    weights = (radiance.double() * solid_angles(64)[..., None]).view(-1, 3)
    expected = (normals[some] @ light.T).clamp(min=0.0) @ weights
    assert torch.allclose(found[some].double(), expected, rtol=2e-4)


def test_the_chances_of_texels_are_a_density():
    tables = SkyTables.build(paint_sky(SKIES["dusk"], height=32))
    assert float((tables.density.double() * solid_angles(32)).sum()) == pytest.approx(1.0, abs=1e-6)
    assert (tables.rows.diff() >= 0).all()
    assert (tables.columns.diff(dim=1) >= 0).all()
    assert tables.density.min() > 0.0
