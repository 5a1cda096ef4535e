import pytest
import torch

from samira_warp.nets import AdaptiveInstanceNorm, Conditions, ConditionStatistics
from samira_warp.nets.conditioning import CONDITION_LIMIT, STANDARD_DEVIATION_FLOOR


def frames(generator, count=50):
    """A batch of translations that barely move, expressions of which one is constant, poses."""
    constant = torch.tensor([0.0, 1.0, 1.0, 1.0])
    rows = [
        (
            0.01 * torch.randn(3, generator=generator) + 2.0,
            torch.randn(4, generator=generator) * constant + 5.0,
            torch.randn(15, generator=generator),
        )
        for _ in range(count)
    ]
    return Conditions(*(torch.stack(values) for values in zip(*rows, strict=True)))


def row_of(conditions, row):
    return Conditions(*(values[row] for values in conditions))


def test_training_frames_get_mean_zero_and_deviation_one_and_none_is_clamped(generator):
    conditions = frames(generator)
    statistics = ConditionStatistics.of(conditions)
    for name in Conditions._fields:
        stacked = getattr(statistics(conditions), name)
        raw = getattr(conditions, name).double()
        expected = (raw - raw.mean(0)) / raw.std(0, correction=0).clamp(min=STANDARD_DEVIATION_FLOOR)
        # float32 differences of values about 2 with a deviation of 0.01: 2^-23 * 2 / 0.01 = 2e-5
        torch.testing.assert_close(stacked.double(), expected, atol=1e-4, rtol=0)
    # the sample holds values beyond three deviations, or the test would not show that they pass
    assert stacked.abs().max() > CONDITION_LIMIT


def test_what_is_constant_or_varies_below_the_floor_becomes_zero(generator):
    below = 0.5 * STANDARD_DEVIATION_FLOOR
    translations = torch.tensor([[0.0, sign * below, sign] for sign in (-1.0, 1.0)])
    conditions = Conditions(translations, torch.zeros(2, 2), torch.zeros(2, 15))
    statistics = ConditionStatistics.of(conditions)
    driven = statistics(
        Conditions(torch.tensor([9.0, 9.0, 0.5]), torch.full((2,), 9.0), torch.full((15,), -9.0))
    )
    torch.testing.assert_close(driven.translation, torch.tensor([0.0, 0.0, 0.5]))
    assert (driven.expression == 0).all()
    assert (driven.pose == 0).all()


def test_other_sequences_are_held_to_three_deviations_or_to_the_training_frames_extremes(generator):
    conditions = frames(generator)
    statistics = ConditionStatistics.of(conditions)
    driven = statistics(
        Conditions(torch.full((3,), 100.0), torch.full((4,), -100.0), torch.full((15,), 100.0))
    )
    assert CONDITION_LIMIT == 3.0
    assert driven.expression[0] == 0.0
    for name, sign in (("translation", 1.0), ("expression", -1.0), ("pose", 1.0)):
        seen = getattr(statistics(conditions), name).abs().amax(0)
        limit = torch.where(seen > 0, seen.clamp(min=CONDITION_LIMIT), 0.0)
        torch.testing.assert_close(getattr(driven, name), sign * limit)


def test_statistics_are_part_of_the_state(generator):
    statistics = ConditionStatistics.of(frames(generator))
    other = ConditionStatistics(expression_size=4, pose_size=15)
    other.load_state_dict(statistics.state_dict())
    condition = row_of(frames(generator, 1), 0)
    assert all(torch.equal(a, b) for a, b in zip(statistics(condition), other(condition), strict=True))


def test_frames_are_standardised_one_by_one_or_together(generator):
    conditions = frames(generator)
    statistics = ConditionStatistics.of(conditions)
    together = statistics(conditions)
    for row in (0, 7, 49):
        alone = statistics(row_of(conditions, row))
        assert all(torch.equal(a, b[row]) for a, b in zip(alone, together, strict=True))


@pytest.mark.parametrize("hidden", [0, 8])
def test_adain_gives_each_channel_the_mean_and_deviation_that_the_condition_asks_for(
    hidden, device, generator
):
    torch.manual_seed(0)
    layer = AdaptiveInstanceNorm(5, 3, hidden=hidden).double().to(device)
    for parameter in layer.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    features = (3.0 + 2.0 * torch.randn(1, 5, 16, 16, generator=generator, dtype=torch.float64)).to(device)
    condition = torch.randn(3, generator=generator, dtype=torch.float64).to(device)
    scale, shift = layer.affine(condition).view(2, 5)
    adapted = layer(features, condition)[0].flatten(1)
    torch.testing.assert_close(adapted.mean(1), shift)
    # instance_norm divides by sqrt(variance + 1e-5): with a variance of 4 the deviation falls short by
    # 1.25e-6
    torch.testing.assert_close(adapted.std(1, correction=0), (1.0 + scale).abs(), rtol=2e-6, atol=0)
    mean, deviation = (
        features.mean((2, 3), keepdim=True),
        features.var((2, 3), correction=0, keepdim=True).add(1e-5).sqrt(),
    )
    expected = (features - mean) / deviation * (1.0 + scale.view(1, 5, 1, 1)) + shift.view(1, 5, 1, 1)
    torch.testing.assert_close(layer(features, condition), expected)


def test_an_affine_adain_starts_without_a_condition_and_goes_as_far_as_it_goes(generator):
    torch.manual_seed(0)
    layer = AdaptiveInstanceNorm(5, 3).double()
    features = torch.randn(1, 5, 8, 8, generator=generator, dtype=torch.float64)
    one, other = torch.randn(2, 3, generator=generator, dtype=torch.float64)
    assert torch.equal(layer(features, one), layer(features, other))
    torch.nn.init.normal_(layer.affine.weight)
    nothing = layer(features, torch.zeros(3, dtype=torch.float64))
    together = layer(features, one) + layer(features, other) - nothing
    torch.testing.assert_close(layer(features, one + other), together)
