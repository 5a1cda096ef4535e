import pytest
import torch

from samira_warp.kernels.cubemap.filter import irradiance
from samira_warp.kernels.cubemap.layout import texel_directions
from samira_warp.light import LearnableLight
from samira_warp.light.harmonics import harmonics, irradiance_functions, mean_radiance


def test_learnable_light_starts_uniform_and_learns(device):
    light = LearnableLight(torch.tensor([0.25, 1.0, 30.0])).to(device)
    start = light()
    for mip in (start.irradiance, *start.specular):
        assert torch.allclose(mip, torch.tensor([0.25, 1.0, 30.0], device=device), rtol=1e-3)
    (start.irradiance.sum() + sum(mip.sum() for mip in start.specular)).backward()
    assert (light.diffuse.grad > 0).all()
    assert (light.specular.grad > 0).all()
    environment = light.environment()
    assert not environment.specular.requires_grad
    assert torch.allclose(environment.filtered().specular[1], start.specular[1])


def test_learnable_light_survives_black_and_extreme_radiance():
    for value in (0.0, 1e-6, 1e4):
        diffuse, _ = LearnableLight(torch.full((3,), value)).radiance()
        assert torch.allclose(diffuse, torch.tensor(max(value, 1e-4)), rtol=1e-3)


def test_a_tied_light_is_one_map(device, generator):
    light = LearnableLight(torch.tensor([0.25, 1.0, 4.0]), tied=True).to(device)
    assert [name for name, _ in light.named_parameters()] == ["specular"]
    with torch.no_grad():
        light.specular += torch.randn(light.specular.shape, generator=generator).to(device)
    filtered = light()
    diffuse, specular = light.radiance()
    assert torch.equal(diffuse, specular)
    assert torch.equal(filtered.irradiance, irradiance(specular))
    filtered.irradiance.sum().backward()
    assert (light.specular.grad > 0).all()


@pytest.mark.parametrize("tied", [False, True])
def test_a_light_is_restored_from_its_tensors(tied, generator):
    light, other = (LearnableLight(torch.ones(3), tied=tied) for _ in range(2))
    with torch.no_grad():
        light.specular += torch.randn(light.specular.shape, generator=generator)
    other.load_state_dict(light.state_dict())
    assert torch.equal(other.environment().specular, light.environment().specular)


def lamp():
    """(9, 3) harmonics of a soft light from above and before, bluer from the left, positive everywhere."""
    light = torch.zeros(9, 3)
    light[0] = torch.tensor([3.0, 2.5, 2.0])
    light[1], light[2] = 0.6, 0.8
    light[3] = torch.tensor([0.1, 0.0, -0.2])
    light[5] = 0.2
    return light


@pytest.mark.parametrize("tied", [False, True])
def test_a_light_starts_from_harmonics(tied):
    light = LearnableLight.from_harmonics(lamp(), tied=tied)
    diffuse, specular = light.radiance()
    for radiance in (diffuse, specular):
        expected = harmonics(texel_directions(radiance.shape[1])) @ lamp()
        assert expected.min() > 0.1  # above the floor
        torch.testing.assert_close(radiance, expected, rtol=1e-4, atol=1e-5)
    expected = irradiance_functions(texel_directions(16)) @ lamp()
    # the diffuse map's 16 x 16 texels a face, whose midpoint rule errs by some (1/8)^2 / 4 of what varies
    filtered = light()
    torch.testing.assert_close(filtered.irradiance, expected, rtol=0.01, atol=0)
    (filtered.irradiance.sum() + filtered.specular[1].sum()).backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in light.parameters())


def test_harmonics_that_ring_below_zero_start_at_a_share_of_their_mean():
    light = lamp()
    light[2] = 8.0
    diffuse, _ = LearnableLight.from_harmonics(light).radiance()
    assert (harmonics(texel_directions(16)) @ light).min() < 0
    torch.testing.assert_close(diffuse.amin(dim=(0, 1, 2)), 0.05 * mean_radiance(light), rtol=1e-4, atol=0)
