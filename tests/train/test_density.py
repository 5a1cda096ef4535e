import pytest
import torch
from subjects import SMALL_LIGHT, parameters, small_avatar, small_canonical

from samira_warp.avatar import Gaussians
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.train.density import (
    GRADIENT_THRESHOLD,
    OPACITY_MIN,
    OPACITY_RESET,
    SPLIT_SHRINK,
    DensityStatistics,
    control_density,
    reset_opacity,
)
from samira_warp.train.optimizer import make_optimizer, replace_gaussians, reset_moments, set_rates
from samira_warp.train.schedule import RATES
from samira_warp.train.tracking import TrackedParameters

COUNT = 200


@pytest.fixture
def gaussians(device):
    """Gaussians of which every tensor tells them apart, several on most of their faces."""
    found = small_avatar(gaussians=COUNT).gaussians
    with torch.no_grad():
        found.faces //= 5
        found.albedo_logits.normal_(generator=torch.Generator().manual_seed(1))
        found.quaternions.normal_(generator=torch.Generator().manual_seed(2))
    return found.to(device)


def statistics_of(count, wanted, device, *, low=0.0):
    """Every Gaussian was seen twice; those ``wanted`` lie above the threshold, the later the further."""
    statistics = DensityStatistics(count, torch.device(device))
    statistics.gradient += low
    statistics.gradient[wanted] = (
        4 * GRADIENT_THRESHOLD * (1 + torch.arange(len(wanted), device=device) / len(wanted))
    )
    statistics.views += 2
    return statistics


def control(gaussians, statistics, *, cap=10_000, seed=0):
    canonical = small_canonical().to(gaussians.means.device)
    return control_density(
        gaussians,
        statistics,
        face_scales=triangle_frames(canonical.vertices, canonical.topology).scale,
        face_areas=face_areas(canonical.vertices, canonical.topology.faces),
        cap=cap,
        generator=torch.Generator().manual_seed(seed),
    )


def sized(gaussians, factor, chosen):
    with torch.no_grad():
        gaussians.log_scales[chosen] += torch.log(torch.tensor(factor))


def test_nothing_wanted_changes_nothing(gaussians):
    change = control(
        gaussians, statistics_of(COUNT, torch.tensor([], dtype=torch.long), gaussians.means.device)
    )
    assert change.kept.tolist() == list(range(COUNT))
    assert all(
        torch.equal(a, b)
        for a, b in zip(gaussians.tensors().values(), change.gaussians.tensors().values(), strict=True)
    )


def test_small_ones_are_cloned_as_they_are(gaussians):
    device = gaussians.means.device
    chosen = torch.tensor([3, 70, 150], device=device)
    sized(gaussians, 0.01, slice(None))
    change = control(gaussians, statistics_of(COUNT, chosen, device))
    after = change.gaussians
    assert len(after) == COUNT + 3
    assert change.kept.tolist() == list(range(COUNT))
    for name, value in gaussians.tensors().items():
        assert torch.equal(getattr(after, name)[:COUNT], value), name
        assert torch.equal(getattr(after, name)[COUNT:], value[chosen]), name


def test_large_ones_are_split_into_two_smaller_ones_on_their_face(gaussians):
    device = gaussians.means.device
    chosen = torch.tensor([5, 80], device=device)
    sized(gaussians, 0.01, slice(None))
    sized(gaussians, 1e4, chosen)
    change = control(gaussians, statistics_of(COUNT, chosen, device))
    after = change.gaussians
    assert len(after) == COUNT + 2
    assert change.kept.tolist() == [index for index in range(COUNT) if index not in (5, 80)]
    parents = torch.tensor([5, 80, 5, 80], device=device)
    children = {name: value[COUNT - 2 :] for name, value in after.tensors().items()}
    shrink = torch.log(torch.tensor(SPLIT_SHRINK))
    for name, value in gaussians.tensors().items():
        if name == "log_scales":
            torch.testing.assert_close(children[name], value[parents] - shrink.to(device))
        elif name == "means":
            assert (children[name] != value[parents]).all()
        else:
            assert torch.equal(children[name], value[parents]), name


def test_split_positions_follow_the_parents_own_distribution(gaussians):
    """Moved back into the parent's axes and by its scales, offsets are standard normal."""
    device = gaussians.means.device
    sized(gaussians, 1e3, slice(None))
    offsets, scales = [], gaussians.log_scales.detach().exp()
    q = torch.nn.functional.normalize(gaussians.quaternions.detach(), dim=1)
    w, v = q[:, :1], q[:, 1:]
    for seed in range(10):
        change = control(
            gaussians, statistics_of(COUNT, torch.arange(COUNT, device=device), device), seed=seed
        )
        for half in (slice(0, COUNT), slice(COUNT, 2 * COUNT)):
            offset = change.gaussians.means.detach()[half] - gaussians.means.detach()
            # turned by the conjugate quaternion: p + 2 w (p x v) + 2 v x (v x p)
            back = (
                offset
                - 2 * w * torch.linalg.cross(v, offset)
                + 2 * torch.linalg.cross(v, torch.linalg.cross(v, offset))
            )
            offsets.append(back / scales)
    standard = torch.cat(offsets)
    # 4000 draws an axis: standard errors of mean and deviation are 0.016 and 0.011; four of them
    assert standard.mean(0).abs().max() < 0.064
    assert (standard.std(0) - 1).abs().max() < 0.045
    # the two children are drawn apart
    assert not torch.equal(offsets[0], offsets[1])


def test_the_cap_serves_the_largest_gradients_first(gaussians):
    device = gaussians.means.device
    sized(gaussians, 0.01, slice(None))
    chosen = torch.arange(0, 100, 5, device=device)
    after = control(gaussians, statistics_of(COUNT, chosen, device), cap=COUNT + 4).gaussians
    assert len(after) == COUNT + 4
    assert torch.equal(after.albedo_logits[COUNT:], gaussians.albedo_logits[chosen[-4:]])


@pytest.mark.parametrize("cap", [COUNT, COUNT - 50, 1])
def test_a_full_cap_adds_and_removes_nothing(gaussians, cap):
    statistics = statistics_of(
        COUNT, torch.arange(COUNT, device=gaussians.means.device), gaussians.means.device
    )
    assert len(control(gaussians, statistics, cap=cap).gaussians) == COUNT


def test_faint_ones_go_but_each_face_keeps_its_most_opaque(gaussians):
    device = gaussians.means.device
    with torch.no_grad():
        gaussians.opacity_logits.copy_(torch.logit(torch.linspace(0.1, 0.9, COUNT) * OPACITY_MIN))
        gaussians.opacity_logits[:10] = 2.0
    change = control(gaussians, statistics_of(COUNT, torch.tensor([], dtype=torch.long), device))
    faces = gaussians.faces.cpu()
    opacities = gaussians.opacities.detach().cpu()
    expected = {
        max((index for index in range(COUNT) if faces[index] == face), key=lambda index: opacities[index])
        for face in faces.unique()
    }
    expected |= set(range(10))
    assert len(expected) < COUNT
    assert set(change.kept.tolist()) == expected
    assert set(change.gaussians.faces.tolist()) == set(faces.tolist())


def test_equally_faint_ones_on_a_face_keep_one(gaussians):
    with torch.no_grad():
        gaussians.opacity_logits.fill_(-20.0)
    change = control(
        gaussians, statistics_of(COUNT, torch.tensor([], dtype=torch.long), gaussians.means.device)
    )
    assert sorted(change.gaussians.faces.tolist()) == gaussians.faces.unique().tolist()


def test_the_faint_are_removed_rather_than_multiplied(gaussians):
    device = gaussians.means.device
    with torch.no_grad():
        gaussians.opacity_logits.fill_(-20.0)
    sized(gaussians, 0.01, slice(None))
    change = control(gaussians, statistics_of(COUNT, torch.arange(COUNT, device=device), device))
    faces = len(gaussians.faces.unique())
    # the one that each face keeps is not faint for this purpose: it is cloned
    assert len(change.gaussians) == 2 * faces


def test_the_threshold_is_on_the_mean_over_the_frames_that_saw_it(device):
    statistics = DensityStatistics(3, device)
    gradient = torch.tensor([[3.0, 4.0], [1.0, 0.0], [9.0, 9.0]], device=device)
    seen = torch.tensor([True, True, False], device=device)
    statistics.add(gradient, seen, width=10, height=20)
    statistics.add(gradient, torch.tensor([False, True, False], device=device), width=10, height=20)
    # per pixel times half the size: (3 x 5, 4 x 10) and (1 x 5, 0)
    torch.testing.assert_close(
        statistics.mean, torch.tensor([(15.0**2 + 40.0**2) ** 0.5, 5.0, 0.0], device=device)
    )


def test_the_same_seed_gives_the_same_children(gaussians):
    device = gaussians.means.device
    sized(gaussians, 1e3, slice(None))
    first, second, other = (
        control(gaussians, statistics_of(COUNT, torch.arange(40, device=device), device), seed=seed)
        for seed in (1, 1, 2)
    )
    assert torch.equal(first.gaussians.means, second.gaussians.means)
    assert not torch.equal(first.gaussians.means, other.gaussians.means)


def test_opacity_reset_only_lowers(gaussians):
    with torch.no_grad():
        gaussians.opacity_logits[:5] = -8.0
    before = gaussians.opacities.detach().clone()
    reset_opacity(gaussians)
    torch.testing.assert_close(gaussians.opacities, before.clamp(max=OPACITY_RESET))


def test_moments_follow_the_gaussians_that_stay():
    avatar = small_avatar(light_sizes=SMALL_LIGHT)
    tracked = TrackedParameters(FrameParameters.stack([avatar.canonical.rig.rest()]))
    optimizer = make_optimizer(avatar, tracked)
    assert {group["name"] for group in optimizer.param_groups} == set(RATES)
    held = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    learned = [*avatar.parameters(), *tracked.parameters()]
    assert {id(parameter) for parameter in held} == {id(parameter) for parameter in learned}
    set_rates(optimizer, step=50, steps=100)
    for parameter in learned:
        parameter.grad = torch.randn_like(parameter)
    optimizer.step()
    old = avatar.gaussians
    kept = torch.tensor([0, 2, 199])
    new = Gaussians({name: torch.cat([value[kept], value[:2]]) for name, value in old.tensors().items()})
    before = {
        name: {key: value.clone() for key, value in optimizer.state[getattr(old, name)].items()}
        for name in Gaussians.PARAMETERS
    }
    replace_gaussians(optimizer, old, new, kept)
    groups = {group["name"]: group["params"] for group in optimizer.param_groups}
    for name in Gaussians.PARAMETERS:
        parameter = getattr(new, name)
        assert groups[name] == [parameter]
        assert getattr(old, name) not in optimizer.state
        state = optimizer.state[parameter]
        assert state["step"] == before[name]["step"]
        for moment in ("exp_avg", "exp_avg_sq"):
            assert torch.equal(state[moment][:3], before[name][moment][kept])
            assert (state[moment][3:] == 0).all()
    for parameter in new.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()


def test_one_groups_moments_can_be_forgotten():
    avatar = small_avatar(gaussians=20, light_sizes=SMALL_LIGHT)
    tracked = TrackedParameters(FrameParameters.stack([parameters(0)]))
    optimizer = make_optimizer(avatar, tracked)
    reset_moments(optimizer, "opacity_logits")  # before the first step there is nothing to forget
    assert not any(optimizer.state.values())
    set_rates(optimizer, step=50, steps=100)
    for group in optimizer.param_groups:
        for parameter in group["params"]:
            parameter.grad = torch.ones_like(parameter)
    optimizer.step(rows=[0])
    reset_moments(optimizer, "opacity_logits")
    for group in optimizer.param_groups:
        for parameter in group["params"]:
            for moment in ("exp_avg", "exp_avg_sq"):
                assert bool(optimizer.state[parameter][moment].any()) is (
                    group["name"] != "opacity_logits"
                ), group["name"]
    before = avatar.gaussians.opacity_logits.detach().clone()
    avatar.gaussians.opacity_logits.grad.zero_()
    optimizer.step()
    assert torch.equal(avatar.gaussians.opacity_logits, before)
