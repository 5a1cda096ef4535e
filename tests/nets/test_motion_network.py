import pytest
import torch

from samira_warp.nets import Conditions, MotionNetwork, MotionSettings

SIZE, REGIONS = 24, 3
PLAIN = MotionSettings(width=8, region_width=4, condition_width=8, bands=3)
VARIANTS = {
    "full": PLAIN,
    "no-routing": MotionSettings(width=8, region_width=4, condition_width=8, bands=3, routing=False),
    "no-modulation": MotionSettings(width=8, region_width=4, condition_width=8, bands=3, modulation=False),
    "no-displacement": MotionSettings(
        width=8, region_width=4, condition_width=8, bands=3, displacement=False
    ),
}


def network_of(settings, *, speaking=True):
    """A network whose last layer says something unless it is left as it starts."""
    torch.manual_seed(0)
    labels = torch.arange(SIZE) * REGIONS // SIZE
    masks = torch.stack([(labels == k)[:, None].expand(SIZE, SIZE) for k in range(REGIONS)]).float()
    network = MotionNetwork(
        settings,
        reference_positions=torch.rand(3, SIZE, SIZE) * 2 - 1,
        image_features=[torch.randn(1, 5, 32, 32), torch.randn(1, 6, 8, 8), torch.randn(1, 7, 4, 4)],
        masks=masks,
        expression_size=4,
        pose_size=15,
    )
    if speaking:
        torch.nn.init.normal_(network.residual.weight)
        torch.nn.init.normal_(network.residual.bias)
    return network


def conditions(seed):
    generator = torch.Generator().manual_seed(seed)
    return Conditions(*(torch.randn(size, generator=generator) for size in (3, 4, 15)))


def displacement(seed):
    return torch.randn(3, SIZE, SIZE, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("name", VARIANTS)
def test_the_residual_starts_at_exactly_zero(name, device):
    network = network_of(VARIANTS[name], speaking=False).to(device)
    residual = network(displacement(0).to(device), Conditions(*(c.to(device) for c in conditions(0))))
    assert residual.shape == (6, SIZE, SIZE)
    assert (residual == 0).all()


@pytest.mark.parametrize("name", VARIANTS)
def test_gradients_reach_every_parameter(name):
    network = network_of(VARIANTS[name])
    (network(displacement(0), conditions(0)) * torch.randn(6, SIZE, SIZE)).sum().backward()
    norms = {
        parameter: 0.0 if value.grad is None else float(value.grad.norm())
        for parameter, value in network.named_parameters()
    }
    ablated = name == "no-displacement"
    unheard = {parameter for parameter in norms if ablated and parameter.startswith("displacement.")}
    silent = {parameter for parameter, norm in norms.items() if norm < 1e-6 * max(norms.values())}
    assert silent == unheard


def test_a_silent_last_layer_still_gets_a_gradient():
    network = network_of(PLAIN, speaking=False)
    (network(displacement(0), conditions(0)) * torch.randn(6, SIZE, SIZE)).sum().backward()
    assert (network.residual.weight.grad != 0).all()
    assert (network.residual.bias.grad != 0).all()


@pytest.mark.parametrize("name", VARIANTS)
def test_every_condition_changes_the_residual(name):
    network = network_of(VARIANTS[name])
    base, other = conditions(0), conditions(1)
    before = network(displacement(0), base)
    for field in Conditions._fields:
        after = network(displacement(0), base._replace(**{field: getattr(other, field)}))
        assert (after - before).abs().max() > 1e-3, field


@pytest.mark.parametrize(
    ("name", "sees"),
    [("full", True), ("no-routing", True), ("no-modulation", True), ("no-displacement", False)],
)
def test_the_displacement_map_is_seen_unless_it_is_ablated(name, sees):
    network = network_of(VARIANTS[name])
    before, after = (network(displacement(seed), conditions(0)) for seed in (0, 1))
    assert torch.equal(before, after) is not sees


def test_ablations_have_the_modulators_that_they_name():
    full, no_routing, no_modulation = (
        network_of(VARIANTS[name]).modulators for name in ("full", "no-routing", "no-modulation")
    )
    assert (full.regions, full.mix.groups) == (REGIONS, REGIONS)
    assert (no_routing.regions, no_routing.mix.groups) == (1, 1)
    assert (no_routing.masks == 1).all()
    assert (no_modulation.regions, no_modulation.mix.groups) == (REGIONS, 1)
    assert torch.equal(no_modulation.masks, full.masks)


def test_displacement_stays_within_its_region_up_to_the_convolutions_after_it():
    network = network_of(PLAIN)
    before = displacement(0)
    changed = before.clone()
    changed[:, : SIZE // REGIONS] = displacement(1)[:, : SIZE // REGIONS]
    difference = (network(changed, conditions(0)) - network(before, conditions(0))).abs().amax(dim=(0, 2))
    assert difference[: SIZE // REGIONS].min() > 0
    # smoothing and decoding are 3 x 3 each: two texels beyond the region's border, and not one more
    assert (difference[SIZE // REGIONS + 2 :] == 0).all()
