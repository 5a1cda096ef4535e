import pytest
import torch
from safetensors.torch import load_file, save_file
from subjects import parameters, small_avatar

from samira_warp import Avatar, UserError
from samira_warp.head import FrameParameters
from samira_warp.train.checkpoint import KEPT, TrainingState, last_checkpoint, load_training, save_checkpoint
from samira_warp.train.density import DensityStatistics
from samira_warp.train.occlusions import FrameOcclusions
from samira_warp.train.optimizer import make_optimizer, set_rates
from samira_warp.train.shared_light import SharedLight
from samira_warp.train.tracking import TrackedParameters


def tracked_frames():
    return TrackedParameters(FrameParameters.stack([parameters(seed) for seed in range(3)]))


@pytest.fixture
def state():
    """A state in which nothing is as it starts: two steps with random gradients, and gathered statistics."""
    torch.manual_seed(0)
    avatar, tracked = small_avatar(perturb=0.1), tracked_frames()
    optimizer = make_optimizer(avatar, tracked)
    set_rates(optimizer, step=5, steps=10)
    avatar.gaussians.normals.requires_grad_(False)  # as in stage one: no moments yet
    for _ in range(2):
        for parameter in [*avatar.parameters(), *tracked.parameters()]:
            parameter.grad = torch.randn_like(parameter) if parameter.requires_grad else None
        optimizer.step(rows=range(3))
    density = DensityStatistics(len(avatar.gaussians), torch.device("cpu"))
    density.gradient.uniform_()
    density.views.random_(1, 9)
    occlusions = FrameOcclusions(avatar.canonical, avatar.occluder, tracked)
    for row in (0, 2):
        frame = tracked.frame(row, parameters(row))
        occlusions.of(row, frame, avatar.canonical.pose(frame))
    light = SharedLight(avatar.light)
    light.gradient.uniform_()
    light.frames = 3
    return TrainingState(7, avatar, tracked, light, occlusions, optimizer, density)


def fresh_state(avatar):
    """A state at its start, for an avatar."""
    tracked = tracked_frames()
    density = DensityStatistics(len(avatar.gaussians), torch.device("cpu"))
    occlusions = FrameOcclusions(avatar.canonical, avatar.occluder, tracked)
    light, optimizer = SharedLight(avatar.light), make_optimizer(avatar, tracked)
    return TrainingState(0, avatar, tracked, light, occlusions, optimizer, density)


def test_everything_that_changes_comes_back(state, tmp_path):
    path = save_checkpoint(tmp_path, state, record={"subject": "tiny"})
    assert path == last_checkpoint(tmp_path) == tmp_path / "step_000007"
    fresh = fresh_state(Avatar.load(path))
    _, avatar, tracked, light, occlusions, optimizer, density = fresh
    assert load_training(path, fresh) == 7
    assert light.frames == 3
    assert torch.equal(light.gradient, state.light.gradient)
    assert occlusions.traced.tolist() == [True, False, True]
    assert all(
        torch.equal(values, occlusions.state()[name]) for name, values in state.occlusions.state().items()
    )
    assert torch.equal(density.gradient, state.density.gradient)
    assert torch.equal(density.views, state.density.views)
    for before, after in ((state.avatar, avatar), (state.tracked, tracked)):
        assert all(
            torch.equal(value, after.state_dict()[name]) for name, value in before.state_dict().items()
        )
    for before, after in zip(state.optimizer.param_groups, optimizer.param_groups, strict=True):
        for old, new in zip(before["params"], after["params"], strict=True):
            moments = state.optimizer.state.get(old, {})
            assert set(moments) == set(optimizer.state.get(new, {})), before["name"]
            assert all(torch.equal(value, optimizer.state[new][key]) for key, value in moments.items()), (
                before["name"]
            )
            assert bool(moments) is (before["name"] != "normals")


def as_before_joints_had_names(path):
    """Rewrite a checkpoint's training state as it was when FLAME's poses were four tensors.

    The light learned at every step then.
    """
    file = path / "training.safetensors"
    tensors = {name: value for name, value in load_file(file).items() if not name.startswith("light.")}
    parts = {"rotation": slice(0, 1), "neck": slice(1, 2), "jaw": slice(2, 3), "eyes": slice(3, 5)}
    rotations = tensors.pop("tracked.rotations")
    moments = {name: tensors.pop(f"adam.pose.0.{name}") for name in ("exp_avg", "exp_avg_sq", "step")}
    for index, (part, joints) in enumerate(parts.items()):
        tensors[f"tracked.{part}"] = rotations[:, joints].flatten(1).clone()
        tensors[f"adam.pose.{index}.step"] = moments["step"][0].clone()  # all rows stepped together
        for name in ("exp_avg", "exp_avg_sq"):
            tensors[f"adam.pose.{index}.{name}"] = moments[name][:, joints].flatten(1).clone()
    save_file(tensors, file)
    return file


def test_an_older_checkpoint_is_gone_on_from(state, tmp_path):
    path = save_checkpoint(tmp_path, state, record={})
    as_before_joints_had_names(path)
    fresh = fresh_state(Avatar.load(path))
    tracked, optimizer = fresh.tracked, fresh.optimizer
    assert load_training(path, fresh) == 7
    assert fresh.light.frames == 0
    assert torch.equal(tracked.rotations, state.tracked.rotations)
    assert torch.equal(tracked.expression, state.tracked.expression)
    moments, expected = (
        optimizer.state[tracked.rotations],
        state.optimizer.state[state.tracked.rotations],
    )
    assert set(moments) == set(expected) == {"step", "exp_avg", "exp_avg_sq"}
    assert all(torch.equal(moments[name], expected[name]) for name in expected)


def test_an_older_checkpoint_without_a_part_is_named(state, tmp_path):
    path = save_checkpoint(tmp_path, state, record={})
    file = as_before_joints_had_names(path)
    whole = load_file(file)
    fresh = fresh_state(state.avatar)
    for name in ("tracked.jaw", "adam.pose.3.exp_avg"):
        save_file({key: value for key, value in whole.items() if key != name}, file)
        with pytest.raises(UserError, match=rf"training\.safetensors: .* found '{name}'"):
            load_training(path, fresh)


def test_the_rotations_of_all_joints_are_one_group(state):
    groups = {group["name"]: group["params"] for group in state.optimizer.param_groups}
    assert [value is state.tracked.rotations for value in groups["pose"]] == [True]


def test_only_the_newest_checkpoints_are_kept(state, tmp_path):
    for step in (2, 9, 10, 100):
        save_checkpoint(tmp_path, state._replace(step=step), record={})
    assert KEPT == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step_000010", "step_000100"]


def test_a_folder_without_a_whole_checkpoint_is_named(state, tmp_path):
    with pytest.raises(UserError, match="checkpoint"):
        last_checkpoint(tmp_path)
    path = save_checkpoint(tmp_path, state, record={})
    (path / "training.json").unlink()
    with pytest.raises(UserError, match=str(tmp_path)):
        last_checkpoint(tmp_path)


def test_what_a_killed_process_left_goes_with_the_next_checkpoint(state, tmp_path):
    for name in (".step_000003.new", ".step_000005.old", ".step_000007.new"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "avatar.json").write_text("{")
    save_checkpoint(tmp_path, state, record={})
    assert [path.name for path in tmp_path.iterdir()] == ["step_000007"]
