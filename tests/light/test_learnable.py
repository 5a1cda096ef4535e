import pytest
import torch

from samira_warp.kernels.cubemap.filter import irradiance
from samira_warp.light import LearnableLight


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
