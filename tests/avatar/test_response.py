import torch

from samira_warp.avatar.response import response_factors, response_map

REGIONS, SIZE = 4, 6


def test_factors_lie_between_a_half_and_three_halves(device, generator):
    logits = (5.0 * torch.randn(REGIONS, 2, generator=generator)).to(device)
    factors = response_factors(logits)
    torch.testing.assert_close(factors, 0.5 + 1.0 / (1.0 + torch.exp(-logits)))
    extreme = response_factors(torch.tensor([[-1e4, 1e4]], device=device))
    assert extreme.tolist() == [[0.5, 1.5]]


def test_neutral_logits_are_exactly_one_everywhere(device, generator):
    masks = torch.rand(REGIONS, SIZE, SIZE, generator=generator).to(device)
    assert (response_map(response_factors(torch.zeros(REGIONS, 2, device=device)), masks) == 1.0).all()


def test_uncovered_texels_are_exactly_neutral(device, generator):
    masks = torch.rand(REGIONS, SIZE, SIZE, generator=generator).to(device)
    masks[:, :2] = 0.0
    mapped = response_map(response_factors(torch.full((REGIONS, 2), 4.0, device=device)), masks)
    assert (mapped[:2] == 1.0).all()
    assert (mapped[2:] > 1.4).all()


def test_overlapping_masks_average_their_factors_by_weight(device, generator):
    masks = torch.rand(REGIONS, SIZE, SIZE, generator=generator, dtype=torch.float64).to(device)
    factors = response_factors(torch.randn(REGIONS, 2, generator=generator, dtype=torch.float64).to(device))
    expected = torch.zeros(SIZE, SIZE, 2, dtype=torch.float64, device=device)
    for k in range(REGIONS):
        expected += masks[k, ..., None] * factors[k]
    expected /= masks.sum(0)[..., None]
    # epsilon = 1e-6 pulls a texel by |tau - 1| epsilon / sum S <= 0.5e-6 / 0.3
    assert masks.sum(0).min() > 0.3
    torch.testing.assert_close(response_map(factors, masks), expected, atol=2e-6, rtol=0)


def test_texels_of_one_region_have_its_factors(generator):
    labels = torch.randint(0, REGIONS, (SIZE, SIZE), generator=generator)
    masks = torch.stack([labels == k for k in range(REGIONS)]).float()
    factors = response_factors(torch.randn(REGIONS, 2, generator=generator))
    torch.testing.assert_close(response_map(factors, masks), factors[labels], atol=1e-6, rtol=0)


def test_gradients_reach_only_the_regions_that_a_texel_is_in(generator):
    masks = torch.zeros(REGIONS, SIZE, SIZE)
    masks[1, 2, 3] = masks[3, 2, 3] = 0.5
    logits = torch.zeros(REGIONS, 2, requires_grad=True)
    response_map(response_factors(logits), masks)[..., 0].sum().backward()
    # d tau / d logit is 1/4 at zero, and each of the two has half of the texel
    torch.testing.assert_close(
        logits.grad, torch.tensor([[0.0, 0.0], [0.125, 0.0], [0.0, 0.0], [0.125, 0.0]]), atol=1e-6, rtol=0
    )
