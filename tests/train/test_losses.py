from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity
from subjects import SMALL_LIGHT, camera, parameters, small_avatar

from samira_warp.avatar.residual import LimitedResidual, limit_residual
from samira_warp.kernels.gathering.gather import GatherTable
from samira_warp.light import decode_srgb
from samira_warp.train.losses import (
    Known,
    LossWeights,
    Target,
    albedo_loss,
    linear_albedo,
    normal_prior,
    normal_smoothness,
    total_loss,
)
from samira_warp.train.materials import ROUGHNESS_UNIT, SPECULAR_UNIT, MaterialPrior
from samira_warp.train.neighbours import Neighbourhood

SIZE = 24
COUNT = 10
WEIGHTS = LossWeights(
    wrinkles=0.05,
    ssim=0.2,
    lpips=0.05,
    normal_smoothness=0.15,
    normal_prior=0.1,
    albedo=0.1,
    mask=0.1,
    response=1e-3,
    light=2e-3,
    materials=0.02,
    materials_contrast=0.1,
)


def neighbours_of(device):
    """Two neighbours each, of other weights."""
    indices = (torch.arange(COUNT)[:, None] + torch.tensor([1, 4])) % COUNT
    weights = torch.tensor([0.3, 0.7]).expand(COUNT, 2).contiguous()
    table = GatherTable.build(indices.int().to(device), weights.to(device), sources=COUNT)
    return Neighbourhood(table, np.zeros((COUNT, 7)))


@pytest.fixture
def scene(device, generator):
    def draw(*shape):
        return torch.rand(*shape, generator=generator).to(device)

    gbuffer = SimpleNamespace(
        albedo=draw(SIZE, SIZE, 3),
        normal=torch.nn.functional.normalize(draw(SIZE, SIZE, 3), dim=-1),
        alpha=draw(SIZE, SIZE, 1),
    )
    limited = LimitedResidual(0.02 * (draw(4, 4, 3) - 0.5), draw(4, 4, 3) - 0.5, draw(4, 4, 2) - 0.5)
    motion = SimpleNamespace(
        limited=limited,
        slopes=limited.slopes,
        normals=2 * draw(COUNT, 3) + 0.1,
    )
    rendering = SimpleNamespace(image=draw(SIZE, SIZE, 3), gbuffer=gbuffer, motion=motion)
    initial = torch.nn.functional.normalize(draw(COUNT, 3), dim=1)
    maps = 0.1 + draw(6, 4, 4, 3), 0.1 + draw(6, 8, 8, 3)
    avatar = SimpleNamespace(
        gaussians=SimpleNamespace(
            normals=2 * draw(COUNT, 3) + 0.1,
            initial_normals=initial,
            roughness=draw(COUNT),
            specular=0.1 * draw(COUNT),
            faces=torch.arange(COUNT, device=device, dtype=torch.int32) // 2,
            means=draw(COUNT, 3) - 0.5,
        ),
        response_logits=draw(10, 2) - 0.5,
        light=SimpleNamespace(radiance=lambda: maps),
        settings=SimpleNamespace(residual=True, motion=SimpleNamespace(wrinkles=True)),
        canonical=SimpleNamespace(
            atlas=SimpleNamespace(valid=torch.arange(16).view(4, 4).to(device) % 3 > 0)
        ),
    )
    target = Target(draw(SIZE, SIZE, 3), draw(SIZE, SIZE), draw(SIZE, SIZE, 3), draw(3))
    materials = MaterialPrior(draw(5), 0.1 * draw(5), torch.zeros(5, dtype=torch.bool, device=device))
    return rendering, target, avatar, Known(materials, neighbours_of(device), 0.01 * draw(5), None)


def numpy_of(tensor):
    return tensor.double().cpu().numpy()


def contrast_of(values):
    """(N, C) less what the neighbours of `neighbours_of` have."""
    return values - 0.3 * np.roll(values, -1, axis=0) - 0.7 * np.roll(values, -4, axis=0)


def test_every_term_has_its_closed_form(scene):
    rendering, target, avatar, known = scene
    terms = total_loss(
        rendering,
        target,
        avatar,
        WEIGHTS,
        known,
        stage_two=True,
        perceptual=lambda a, b: (a - b).square().mean(),
    )
    image, truth = numpy_of(rendering.image), numpy_of(target.image)
    g = rendering.gbuffer
    alpha, normal = numpy_of(g.alpha)[..., 0], numpy_of(g.normal)
    surface = alpha > 0.5
    pairs = []
    for first, second, both in (
        (normal[:, 1:], normal[:, :-1], surface[:, 1:] & surface[:, :-1]),
        (normal[1:], normal[:-1], surface[1:] & surface[:-1]),
    ):
        pairs.append(1 - (first * second).sum(-1)[both])
    canonical, initial = numpy_of(rendering.motion.normals), numpy_of(avatar.gaussians.initial_normals)
    cosine = (canonical * initial).sum(-1) / np.linalg.norm(canonical, axis=-1)
    inside = numpy_of(target.mask) > 0.95
    valid = avatar.canonical.atlas.valid.cpu().numpy()
    finish = [(avatar.gaussians.roughness, known.materials.roughness, ROUGHNESS_UNIT)]
    finish += [(avatar.gaussians.specular, known.materials.specular, SPECULAR_UNIT)]
    off = np.stack([(numpy_of(f) - numpy_of(k).repeat(2)) / unit for f, k, unit in finish], axis=1)
    expected = {
        "l1": 0.8 * np.abs(image - truth).mean(),
        "mask": 0.1 * np.abs(alpha - numpy_of(target.mask)).mean(),
        "lpips": 0.05 * ((image - truth) ** 2).mean(),
        "albedo": 0.1 * np.abs(numpy_of(g.albedo) - numpy_of(target.albedo))[inside].mean(),
        "normal_smoothness": 0.15 * np.concatenate(pairs).mean(),
        "normal_prior": 0.1 * (1 - cosine).mean(),
        "light": 2e-3 * np.mean([np.log(values).var() for values in map(numpy_of, avatar.light.radiance())]),
        "materials": 0.02 * (off**2).mean() + 0.1 * (contrast_of(off) ** 2).mean(),
        "residual": 0.1 * (numpy_of(rendering.motion.limited.position / 0.02)[valid] ** 2).mean()
        + 0.1 * (numpy_of(rendering.motion.limited.rotation / np.pi)[valid] ** 2).mean(),
        "wrinkles": 0.05 * (numpy_of(rendering.motion.slopes)[valid] ** 2).mean(),
        "response": 1e-3 * (numpy_of(avatar.response_logits) ** 2).mean(),
    }
    assert inside.any()
    assert set(terms) == {*expected, "ssim"}
    for name, value in expected.items():
        # float32 means of some hundred numbers of about one
        assert float(terms[name]) == pytest.approx(value, rel=2e-5), name


def test_ssim_is_its_definition_with_mirrored_borders_and_scikit_images_inside(scene, generator):
    rendering, target, avatar, known = scene
    noise = 0.2 * torch.randn(SIZE, SIZE, 3, generator=generator).to(target.image.device)
    rendering.image = (target.image + noise).clamp(0, 1)
    term = total_loss(rendering, target, avatar, WEIGHTS, known, stage_two=False, perceptual=None)["ssim"]
    truth, image = numpy_of(target.image), numpy_of(rendering.image)

    def blurred(values):
        # 3.5 sigma is a radius of 5: a window of 11
        return gaussian_filter(values, (1.5, 1.5, 0), mode="mirror", truncate=3.5)

    mean_x, mean_y = blurred(truth), blurred(image)
    variance_x, variance_y = blurred(truth**2) - mean_x**2, blurred(image**2) - mean_y**2
    covariance = blurred(truth * image) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    similarity = (
        (2 * mean_x * mean_y + c1)
        * (2 * covariance + c2)
        / ((mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2))
    )
    # float32 differences of squares of about one, over variances of 0.08
    assert float(term) == pytest.approx(0.2 * (1 - similarity.mean()), rel=1e-4)
    assert 0.1 < similarity.mean() < 0.95
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "full": True}
    theirs = structural_similarity(truth, image, channel_axis=2, data_range=1.0, **options)[1]
    inside = (slice(5, -5), slice(5, -5))
    np.testing.assert_allclose(similarity[inside], theirs[inside], atol=1e-10)


def test_a_perfect_image_costs_nothing(scene):
    rendering, target, avatar, known = scene
    rendering.image, rendering.gbuffer.alpha = target.image, target.mask[..., None]
    rendering.gbuffer.albedo = target.albedo
    avatar.light.radiance = lambda: (torch.full((6, 4, 4, 3), 0.7),)
    avatar.gaussians.roughness = known.materials.roughness.repeat_interleave(2)
    avatar.gaussians.specular = known.materials.specular.repeat_interleave(2)
    rendering.motion.limited = limit_residual(torch.zeros(4, 4, 8))
    terms = total_loss(rendering, target, avatar, WEIGHTS, known, stage_two=False, perceptual=None)
    assert set(terms) == {"l1", "ssim", "mask", "albedo", "residual", "materials", "light"}
    assert float(sum(terms.values())) == pytest.approx(0.0, abs=1e-6)


def test_albedo_is_compared_only_inside_the_matte_and_only_where_there_is_one(scene):
    rendering, target, avatar, known = scene
    mask = torch.zeros_like(target.mask)
    mask[3, 4] = 1.0
    mask[5, 6] = 0.95
    albedo = target.albedo.clone()
    albedo[3, 4] += torch.tensor([0.1, -0.2, 0.3], device=albedo.device)
    value = albedo_loss(albedo, target.albedo, mask)
    assert float(value) == pytest.approx(0.2, rel=1e-5)
    assert float(albedo_loss(albedo, target.albedo, torch.zeros_like(mask))) == 0.0
    absent = target._replace(albedo=None)
    terms = total_loss(rendering, absent, avatar, WEIGHTS, known, stage_two=True, perceptual=None)
    assert "albedo" not in terms


def test_smoothness_of_known_normals(device):
    normal = torch.zeros(4, 4, 3, device=device)
    normal[..., 2] = 1.0
    normal[:, 2:] = torch.tensor([1.0, 0.0, 0.0], device=device)
    alpha = torch.ones(4, 4, 1, device=device)
    # of 12 horizontal and 12 vertical pairs, the four across the middle are perpendicular
    assert float(normal_smoothness(normal, alpha)) == pytest.approx(4 / 24)
    alpha[:, 2:] = 0.5
    assert float(normal_smoothness(normal, alpha)) == 0.0
    assert float(normal_smoothness(normal, torch.zeros_like(alpha))) == 0.0


def test_normal_prior_does_not_depend_on_length(device, generator):
    initial = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator), dim=1).to(device)
    assert float(normal_prior(7.0 * initial, initial)) == pytest.approx(0.0, abs=1e-6)
    assert float(normal_prior(-0.1 * initial, initial)) == pytest.approx(2.0, abs=1e-6)


def test_pseudo_albedo_is_decoded_before_it_is_compared(generator):
    albedo = torch.rand(5, 5, 3, generator=generator)
    assert torch.equal(linear_albedo(albedo, color_space="srgb"), decode_srgb(albedo))
    assert torch.equal(linear_albedo(albedo, color_space="raw"), albedo)


def test_gradients_of_all_terms_reach_the_avatar(generator):
    avatar = small_avatar(light_sizes=SMALL_LIGHT)
    with torch.no_grad():
        avatar.response_logits.normal_(generator=generator)
        avatar.gaussians.roughness_logits.add_(0.3)
        avatar.gaussians.means.add_(0.1)
        avatar.gaussians.normals.add_(0.3 * torch.randn(avatar.gaussians.normals.shape, generator=generator))
    rendering = avatar.render(parameters(0), camera(32))
    target = Target(
        torch.rand(32, 32, 3, generator=generator),
        torch.ones(32, 32),
        torch.rand(32, 32, 3, generator=generator),
        torch.rand(3, generator=generator),
    )
    known = Known.of(avatar)
    terms = total_loss(rendering, target, avatar, WEIGHTS, known, stage_two=True, perceptual=None)
    reached = {
        "l1": avatar.gaussians.albedo_logits,
        "ssim": avatar.light.diffuse,
        "mask": avatar.gaussians.opacity_logits,
        "albedo": avatar.gaussians.albedo_logits,
        "normal_smoothness": avatar.gaussians.normals,
        "normal_prior": avatar.gaussians.normals,
        "light": avatar.light.diffuse,
        "materials": avatar.gaussians.roughness_logits,
        "response": avatar.response_logits,
    }
    for name, parameter in reached.items():
        (gradient,) = torch.autograd.grad(terms[name], parameter, retain_graph=True)
        assert gradient.isfinite().all(), name
        assert (gradient != 0).any(), name
