"""Metrics against numpy's closed forms, scikit-image, and what is known of the inputs."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from samira_warp.evaluate import metrics

RADIUS = 5
"""Of SSIM's window: where it leaves the image, ours mirrors about the last pixel and scikit-image about the
image's edge."""


@pytest.fixture
def pair(device, generator):
    truth = torch.rand(24, 31, 3, generator=generator)
    return (truth + 0.1 * torch.randn(truth.shape, generator=generator)).clamp(0, 1).to(device), truth.to(
        device
    )


@pytest.fixture
def mask(device, generator):
    return torch.rand(24, 31, generator=generator).to(device)


def array(tensor):
    return tensor.cpu().double().numpy()


def test_psnr(pair):
    ours, theirs = map(array, pair)
    # the mean of 2232 squares in float32 is good to 1e-6 of itself, 4.3e-6 dB
    expected = pytest.approx(-10 * math.log10(((ours - theirs) ** 2).mean()), abs=2e-5)
    assert metrics.psnr(*pair).item() == expected
    assert peak_signal_noise_ratio(theirs, ours, data_range=1.0) == expected


def test_a_known_error(device):
    truth = torch.full((8, 8, 3), 0.5, device=device)
    assert metrics.psnr(truth + 0.1, truth).item() == pytest.approx(20.0, abs=1e-4)
    assert metrics.l1(truth + 0.1, truth).item() == pytest.approx(10.0, abs=1e-4)


def test_equal_images_have_the_cap(pair):
    assert metrics.psnr(pair[1], pair[1]).item() == pytest.approx(metrics.PSNR_CAP)
    assert metrics.ssim(pair[1], pair[1]).item() == pytest.approx(1.0, abs=1e-6)
    assert metrics.l1(pair[1], pair[1]).item() == 0


def test_psnr_over_some_pixels(pair, mask):
    ours, theirs = map(array, pair)
    where = array(mask) > metrics.FOREGROUND
    expected = -10 * math.log10(((ours[where] - theirs[where]) ** 2).mean())
    assert metrics.psnr_where(*pair, mask > metrics.FOREGROUND).item() == pytest.approx(expected, abs=2e-5)


def test_psnr_over_no_pixels_is_nan(pair, mask):
    assert metrics.psnr_where(*pair, mask > 2).isnan()


def test_l1(pair):
    ours, theirs = map(array, pair)
    assert metrics.l1(*pair).item() == pytest.approx(100 * np.abs(ours - theirs).mean(), rel=1e-6)


def test_ssim_is_scikit_images_inside_the_borders(pair):
    ours, theirs = map(array, pair)
    options = {
        "gaussian_weights": True,
        "sigma": 1.5,
        "use_sample_covariance": False,
        "data_range": 1.0,
        "channel_axis": 2,
    }
    _, full = structural_similarity(ours, theirs, full=True, **options)
    inside = (slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
    # variances are differences of float32 means near 1/3
    np.testing.assert_allclose(array(metrics.ssim_map(*pair))[inside], full.mean(axis=2)[inside], atol=2e-5)


def test_ssim_mirrors_the_image_about_its_border_pixels(pair):
    padded = [
        torch.from_numpy(np.pad(array(image), ((RADIUS, RADIUS), (RADIUS, RADIUS), (0, 0)), mode="reflect"))
        for image in pair
    ]
    expected = metrics.ssim_map(*padded)[RADIUS:-RADIUS, RADIUS:-RADIUS]
    np.testing.assert_allclose(array(metrics.ssim_map(*pair)), expected.numpy(), atol=2e-5)
    assert metrics.ssim(*pair).item() == pytest.approx(metrics.ssim_map(*pair).mean().item(), rel=1e-6)


def test_ssim_of_constant_images(device):
    """Without variance only the luminance term is left."""
    a, b, c1 = 0.3, 0.5, 0.01**2
    image = torch.ones(16, 16, 3, device=device)
    assert metrics.ssim(a * image, b * image).item() == pytest.approx(
        (2 * a * b + c1) / (a * a + b * b + c1), abs=1e-4
    )


def test_ssim_is_differentiable(device, generator):
    truth = torch.rand(7, 6, 1, generator=generator, dtype=torch.float64).to(device)
    prediction = torch.rand(7, 6, 1, generator=generator, dtype=torch.float64).to(device).requires_grad_()
    assert torch.autograd.gradcheck(lambda image: metrics.ssim(image, truth), prediction)


def test_a_gain_per_channel_is_forgiven(pair, mask):
    truth = pair[1]
    gains = torch.tensor([0.5, 1.25, 2.0], device=truth.device)
    prediction = truth / gains
    prediction[mask <= metrics.FOREGROUND] = 7.0  # neither fitted nor scored
    # what is left are two roundings of numbers below 1: more than 120 dB, so the cap
    assert metrics.psnr_gain(prediction, truth, mask).item() == pytest.approx(metrics.PSNR_CAP)
    assert metrics.psnr_where(prediction, truth, mask > metrics.FOREGROUND).item() < 20


def test_the_gain_is_the_least_squares_one(pair, mask):
    inside = array(mask) > metrics.FOREGROUND
    ours, theirs = (array(image)[inside] for image in pair)
    fitted = np.stack(
        [ours[:, c] * np.linalg.lstsq(ours[:, c : c + 1], theirs[:, c], rcond=None)[0] for c in range(3)],
        axis=1,
    )
    expected = -10 * math.log10(((fitted - theirs) ** 2).mean())
    assert metrics.psnr_gain(*pair, mask).item() == pytest.approx(expected, abs=2e-5)
    assert expected >= metrics.psnr_where(*pair, mask > metrics.FOREGROUND).item()


def test_a_black_channel_has_no_gain(pair, mask):
    black = torch.zeros_like(pair[0])
    expected = metrics.psnr_where(black, pair[1], mask > metrics.FOREGROUND).item()
    assert metrics.psnr_gain(black, pair[1], mask).item() == pytest.approx(expected)


@pytest.mark.parametrize("degrees", [0.0, 1e-3, 0.5, 30.0, 90.0, 179.0, 180.0])
def test_the_angle_of_a_known_rotation(device, generator, degrees):
    """Turned about an axis at right angles, a normal of any length moves by the rotation's angle."""
    normals, others = torch.nn.functional.normalize(
        torch.randn(2, 5, 7, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    across = torch.nn.functional.normalize(torch.linalg.cross(normals, others), dim=-1)
    angle = math.radians(degrees)
    turned = (math.cos(angle) * normals + math.sin(angle) * across) * 3.0
    angles = metrics.normal_angle_map(turned.float().to(device), normals.float().to(device))
    # float32 directions are good to 1e-7 radians, 6e-6 degrees, at each of three roundings
    np.testing.assert_allclose(array(angles), degrees, atol=3e-5)


def test_the_mean_angle_is_over_the_foreground(device):
    truth = torch.tensor([0.0, 0.0, 1.0], device=device).expand(1, 4, 3)
    prediction = torch.tensor(
        [[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 1.0]]], device=device
    )
    mask = torch.tensor([[1.0, 0.6, 0.5, 0.9]], device=device)
    # 0.5 is not above 0.5
    assert metrics.normal_angle(prediction, truth, mask).item() == pytest.approx((0 + 90 + 45) / 3, abs=1e-4)
