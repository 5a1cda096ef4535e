"""Structural similarity against its twin, kornia's and finite differences."""

import kornia
import pytest
import torch

from samira_warp.kernels.image.structural_similarity import RADIUS, structural_similarity
from samira_warp.reference.image.structural_similarity import structural_similarity as reference
from samira_warp.support.errors import UserError

SIZES = [(64, 64, 3), (37, 61, 3), (40, 33, 1), (RADIUS + 1, RADIUS + 4, 3)]
"""Whole vectors of columns, broken ones, one channel, and a picture that is all border."""


def pair(size, generator, device):
    truth = torch.rand(size, generator=generator)
    noise = 0.1 * torch.randn(size, generator=generator)
    return (truth + noise).clamp(0, 1).to(device), truth.to(device)


@pytest.mark.parametrize("size", SIZES)
def test_value_and_gradient_match_the_twin(size, device, generator):
    prediction, truth = pair(size, generator, device)
    prediction.requires_grad_()
    exact = prediction.detach().double().requires_grad_()
    found, expected = structural_similarity(prediction, truth), reference(exact, truth.double())
    (grad,), (exact_grad,) = torch.autograd.grad(found, prediction), torch.autograd.grad(expected, exact)
    # variances of about 0.01 are differences of moments up to 1, sums of 22 terms each rounded by 2^-24: some
    # 1e-6 / 0.01 of a similarity at worst, at random over the pixels
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=2e-6)
    assert (grad.double() - exact_grad).norm() < 1e-4 * exact_grad.norm()


def test_it_is_the_similarity_that_pictures_are_scored_by(device, generator):
    prediction, truth = pair((48, 40, 3), generator, device)
    theirs = kornia.metrics.ssim(*(image.permute(2, 0, 1)[None] for image in (prediction, truth)), 11)
    torch.testing.assert_close(structural_similarity(prediction, truth), theirs.mean(), rtol=0, atol=4e-6)


def test_the_twins_gradient_is_that_of_finite_differences(generator):
    prediction, truth = (image.double() for image in pair((9, 8, 2), generator, "cpu"))
    prediction.requires_grad_()
    assert torch.autograd.gradcheck(lambda image: reference(image, truth), prediction)


def test_a_picture_is_like_itself_and_gains_by_nothing(device, generator):
    picture = pair((32, 32, 3), generator, device)[0].requires_grad_()
    found = structural_similarity(picture, picture.detach())
    (grad,) = torch.autograd.grad(found, picture)
    assert abs(found.item() - 1.0) < 1e-6
    # the similarity of every pixel is at its greatest; what is left is rounding, 2^-24 over C_2 at worst
    assert grad.abs().max() * picture.numel() < 1e-2


def test_the_same_bits_for_any_number_of_threads(generator):
    prediction, truth = pair((64, 96, 3), generator, "cpu")
    prediction.requires_grad_()
    threads, found = torch.get_num_threads(), []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            (grad,) = torch.autograd.grad(structural_similarity(prediction, truth), prediction)
            found.append(grad)
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


@pytest.mark.parametrize("side", [0, 1])
def test_too_small_a_picture_is_named(side):
    size = [12, 12, 3]
    size[side] = RADIUS
    with pytest.raises(UserError, match="prediction: expected more than 5 pixels a side"):
        structural_similarity(torch.rand(size), torch.rand(size))


def test_pictures_of_two_sizes_are_named():
    with pytest.raises(UserError, match="truth"):
        structural_similarity(torch.rand(12, 12, 3), torch.rand(12, 13, 3))
