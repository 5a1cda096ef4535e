"""One avatar by several processes: two on this CPU, which talk by gloo."""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys

import pytest
import torch
from subjects import TESTS, small_preset, train_arguments, train_command
from warm_start import warm_python

from samira_warp.data import PixelCache
from samira_warp.support.errors import UserError
from samira_warp.train.config import TrainConfig
from samira_warp.train.losses import TERMS, Known, Target, light_prior, loss_weights, total_loss
from samira_warp.train.optimizer import DECAY, make_optimizer, set_rates
from samira_warp.train.plan import make_plan
from samira_warp.train.ranks import ALONE, Ranks, joined
from samira_warp.train.schedule import learning_rate
from samira_warp.train.settings import resolve
from samira_warp.train.setup import start
from samira_warp.train.tracking import TrackedParameters
from samira_warp.train.trainer import _held_skin

PROGRAM = TESTS / "train" / "rank.py"
STEPS = 6


def environment(**more):
    """torchrun gives each process one thread; runs that are compared to the bit need as many."""
    return {**os.environ, "OMP_NUM_THREADS": "1", **more}


def torchrun(count, told, arguments):
    """Train by so many processes that torchrun starts; each writes what it holds into ``told``."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", count]
    command += [PROGRAM, told, *arguments]
    return subprocess.run(
        [*map(str, command)], env=environment(), capture_output=True, text=True, timeout=600, check=False
    )


def ranks(count, told, arguments, **more):
    """The same without torchrun's own start; what each of them ended with and said."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    started = []
    for rank in range(count):
        place = {"RANK": rank, "WORLD_SIZE": count, "LOCAL_RANK": rank, "LOCAL_WORLD_SIZE": count}
        place |= {"MASTER_ADDR": "localhost", "MASTER_PORT": port}
        started.append(
            subprocess.Popen(
                [*warm_python(), str(PROGRAM), str(told), *map(str, arguments)],
                env=environment(**{name: str(value) for name, value in place.items()}, **more),
                stderr=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                text=True,
            )
        )
    said = [process.communicate(timeout=600)[1] for process in started]
    return [(process.returncode, text) for process, text in zip(started, said, strict=True)]


def held(told, step, rank):
    """What a rank held when so many steps were done."""
    return torch.load(told / f"{step:03d}_{rank}.pt")


def assert_same(first, second):
    assert first.keys() == second.keys()
    different = [name for name in first if not torch.equal(first[name], second[name])]
    assert different == []


def avatar_bits(run):
    return (run / "avatar" / "avatar.safetensors").read_bytes()


def last_state(run):
    return (run / "checkpoints" / f"step_{STEPS:06d}" / "training.safetensors").read_bytes()


@pytest.fixture(scope="module")
def two(made_once, tiny_dataset):
    """A run by two processes: its folder ``run``, and in ``told`` what each of them held after each step."""

    def make(folder):
        ended = torchrun(2, folder / "told", train_arguments(tiny_dataset, folder / "run"))
        assert ended.returncode == 0, ended.stderr
        (folder / "said").write_text(ended.stderr)

    return made_once("two ranks", make)


def test_both_hold_the_same_bits_after_every_step(two):
    steps = sorted(path.name for path in (two / "told").iterdir())
    assert steps == [f"{step:03d}_{rank}.pt" for step in (2, 4, 6) for rank in (0, 1)]
    for step in (2, 4, 6):
        first, second = held(two / "told", step, 0), held(two / "told", step, 1)
        for part in ("before", "after", "gradients", "terms"):
            first[part].pop("rows", None), second[part].pop("rows", None)
            assert_same(first[part], second[part])


def test_the_first_alone_writes(two, tiny_run):
    """The run folder has what that of one process has, and each step's line once."""

    def files(run):
        names = (path.relative_to(run).as_posix() for path in run.rglob("*"))
        return {name for name in names if "events" not in name and "checkpoints/" not in name}

    assert files(two / "run") - files(tiny_run) == {"preview/000004.png"}  # after two more, not one
    lines = [json.loads(line) for line in (two / "run" / "metrics.jsonl").read_text().splitlines()]
    # one more where a preview was due
    assert [line["step"] for line in lines] == [4, STEPS]
    record = json.loads((two / "run" / "config.json").read_text())
    assert (record["ranks"], record["steps"], record["torch_threads"]) == (2, STEPS, 1)
    said = (two / "said").read_text()
    assert said.count("4 training and 2 test frames") == said.count("the avatar is in") == 1


class Alone:
    """The start of the same run in one process, and its objective, put together without the trainer."""

    def __init__(self, dataset, out):
        from samira_warp.check.opening import open_checked

        config = TrainConfig(data=dataset, out=out, preset="cpu", device="cpu", encoder="random")
        settings = resolve(config, data=dataset, out=out)
        self.sequence = open_checked(settings.data, split=settings.split, flame=settings.flame)
        self.plan = make_plan(settings, self.sequence, config)
        self.pixels = PixelCache(self.sequence.frames, resolution=settings.resolution, max_bytes=1 << 24)
        self.avatar = start(self.plan, self.sequence, self.pixels).avatar
        self.tracked = TrackedParameters(self.sequence.batch(self.sequence.train))
        self.avatar.gaussians.normals.requires_grad_(False)
        self.avatar.response_logits.requires_grad_(False)
        self.avatar.motion.slopes.requires_grad_(False)
        self.skin = _held_skin(self.plan, self.sequence, torch.device("cpu"))

    def objective(self, row, background):
        frame = self.sequence.frames[self.sequence.train[row]]
        content = self.pixels[self.sequence.train[row]]
        behind = (1.0 - content.mask)[..., None] * (background - 1.0)
        albedo = content.albedo
        if albedo is not None:
            low = albedo <= 0.04045
            albedo = torch.where(low, albedo / 12.92, ((albedo + 0.055) / 1.055) ** 2.4)
        target = Target(content.image + behind, content.mask, albedo, background)
        camera = frame.camera.with_longer_side(self.plan.settings.resolution)
        rendering = self.avatar.render(
            self.tracked.frame(row, frame.parameters), camera, self.avatar.light(), background=background
        )
        known = Known.of(self.avatar, skin=self.skin)
        terms = total_loss(
            rendering, target, self.avatar, loss_weights(), known, stage_two=False, perceptual=None
        )
        held = known.materials.held[self.avatar.gaussians.faces.long()]
        return sum(terms.values()), held


@pytest.fixture
def alone(tiny_dataset, tmp_path):
    with small_preset():
        yield Alone(tiny_dataset, tmp_path / "run")


def shown_first(count=2):
    """The first rows of the first epoch's order, and what is behind the head in the first two steps."""
    seed = 42 * 1_000_003
    rows = torch.randperm(4, generator=torch.Generator().manual_seed(seed))[:count].tolist()
    return rows, [torch.ones(3), torch.rand(3, generator=torch.Generator().manual_seed(seed + 1))]


def asked_of_the_light(alone, asked):
    """The gradients of the light's parameters by name, of what frames ask of its maps and its own prior."""
    light = alone.avatar.light
    filtered = light()
    maps = [filtered.irradiance, *filtered.specular, filtered.radiance]
    parts = asked.split([values.numel() for values in maps])
    answer = sum((part.view_as(values) * values).sum() for part, values in zip(parts, maps, strict=True))
    prior = loss_weights().light * light_prior(*light.radiance())
    found = torch.autograd.grad(answer + prior, list(light.parameters()))
    return {f"light.{index}": gradient for index, gradient in enumerate(found)}


def test_gradients_are_those_of_a_batch_of_two(two, alone):
    rows, backgrounds = shown_first()
    found = held(two / "told", 2, 0)["gradients"]
    assert found.pop("rows") == rows
    objectives = [alone.objective(row, color) for row, color in zip(rows, backgrounds, strict=True)]
    (0.5 * (objectives[0][0] + objectives[1][0])).backward()
    assert not any(name.startswith("light") for name in found)  # it learns from four frames at a time
    found |= asked_of_the_light(alone, held(two / "told", 2, 0)["after"]["light.gradient"] / 2)
    for name in ("roughness_logits", "specular_logits"):
        getattr(alone.avatar.gaussians, name).grad[objectives[0][1]] = 0.0
    optimizer = make_optimizer(alone.avatar, alone.tracked)
    expected = {
        f"{group['name']}.{index}": parameter.grad
        for group in optimizer.param_groups
        for index, parameter in enumerate(group["params"])
        if parameter.grad is not None
    }
    assert expected.keys() == found.keys()
    assert any(values.abs().max() > 0 for name, values in found.items() if name.startswith("network"))
    for name, values in expected.items():
        # halves are exact; what both frames reach is added up in another order: some hundred roundings of
        # 6e-8 of sums whose parts cancel by one in ten at most
        error = (found[name] - values).norm() / values.norm().clamp(min=1e-12)
        assert error < 1e-4, (name, float(error))


def test_the_first_step_goes_as_far_as_the_rule_says(two):
    """Adam's first step is its rate along the gradient's sign: times root two where frames share, once where
    a frame has a row of its own, and not at all in the other rows."""
    told = held(two / "told", 2, 0)
    rows = told["gradients"]["rows"]
    rate = learning_rate("network", step=0, steps=STEPS) * math.sqrt(2)
    network = [name for name in told["before"] if name.startswith("motion.") and "image" not in name]
    name = "motion.residual.weight"  # the last layer alone has a gradient before it has a weight
    gradient = told["gradients"][f"network.{network.index(name)}"]
    step = told["after"][name] - told["before"][name]
    strong = gradient.abs() > 1e-9  # far above Adam's epsilon
    assert strong.sum() > 10
    # float32 of values of order 1
    torch.testing.assert_close(step[strong], -rate * gradient.sign()[strong], rtol=1e-3, atol=3e-7)
    rate = learning_rate("expression", step=0, steps=STEPS)
    step = told["after"]["tracked.expression"] - told["before"]["tracked.expression"]
    gradient = told["gradients"]["expression.0"]
    strong = gradient.abs() > 1e-9
    assert strong[rows].any()
    torch.testing.assert_close(step[strong], -rate * gradient.sign()[strong], rtol=1e-3, atol=3e-7)
    others = [row for row in range(4) if row not in rows]
    assert not step[others].any()


def test_the_light_takes_one_step_for_four_frames(two):
    """It rests at first, then its first step is the rate times root four, along the gradient's sign."""
    first, second = held(two / "told", 2, 0), held(two / "told", 4, 0)
    names = [name for name in first["before"] if name in ("light.diffuse", "light.specular")]
    assert names
    rate = learning_rate("light", step=2, steps=STEPS) * math.sqrt(4)
    for index, name in enumerate(names):
        assert torch.equal(first["before"][name], first["after"][name])
        gradient = second["gradients"][f"light.{index}"]
        step = second["after"][name] - second["before"][name]
        strong = gradient.abs() > 1e-9
        assert strong.sum() > 100
        torch.testing.assert_close(step[strong], -rate * gradient.sign()[strong], rtol=1e-3, atol=3e-7)


def test_rates_are_as_before_for_one_frame(alone):
    optimizer = make_optimizer(alone.avatar, alone.tracked)
    set_rates(optimizer, step=2, steps=STEPS, frames=3, light_frames=4)
    shared = {group["name"]: group for group in optimizer.param_groups if "rows" not in group}
    assert shared["network"]["betas"] == pytest.approx((0.9**3, 0.999**3))
    assert shared["light"]["betas"] == pytest.approx((0.9**4, 0.999**4))
    set_rates(optimizer, step=2, steps=STEPS)
    for group in optimizer.param_groups:
        assert group["lr"] == learning_rate(group["name"], step=2, steps=STEPS)
        assert group["betas"] == DECAY == (0.9, 0.999)


def test_logged_terms_are_sums_over_both_frames(two, alone):
    rows, backgrounds = shown_first()
    terms = held(two / "told", 2, 0)["terms"]
    total = sum(
        float(alone.objective(row, color)[0].detach()) for row, color in zip(rows, backgrounds, strict=True)
    )
    assert sum(float(value) for name, value in terms.items() if name != "mse") == pytest.approx(
        total, rel=1e-5
    )
    assert list(terms) == [name for name in TERMS if name in terms]
    for step in (4, 6):
        assert set(held(two / "told", step, 0)["terms"]) <= set(TERMS)


@pytest.fixture(scope="module")
def killed(made_once, tiny_dataset):
    """The same run, both of whose processes were killed when four steps were done."""

    def make(folder):
        arguments = train_arguments(tiny_dataset, folder / "run")
        ended = ranks(2, folder / "told", arguments, END="all,SIGKILL,4")
        assert [status for status, _ in ended] == [-signal.SIGKILL] * 2

    return made_once("two killed ranks", make)


@pytest.mark.parametrize("count", [2, 3])
def test_a_killed_run_goes_on_to_the_same_bits(two, killed, tmp_path, count):
    """By three processes as well: two frames are left, and the third takes part without one."""
    run = shutil.copytree(killed / "run", tmp_path / "run")
    assert [path.name for path in (run / "checkpoints").iterdir()] == ["step_000004"]
    ended = ranks(count, tmp_path / "told", ["--out", run, "--resume"])
    assert [status for status, _ in ended] == [0] * count, ended
    assert avatar_bits(run) == avatar_bits(two / "run")
    assert last_state(run) == last_state(two / "run")
    said = "".join(text for _, text in ended)
    assert said.count("the bits will differ") == (count == 3)
    assert_same(held(tmp_path / "told", 6, 0)["after"], held(tmp_path / "told", 6, count - 1)["after"])


def test_one_process_goes_on_with_what_two_began(killed, tmp_path, capsys):
    run = shutil.copytree(killed / "run", tmp_path / "run")
    assert train_command("--out", run, "--resume") == 0
    assert "begun by 2 processes, now by 1: the bits will differ" in capsys.readouterr().err
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert lines[-1]["step"] == STEPS
    assert json.loads((run / "config.json").read_text())["ranks"] == 2


def test_ctrl_c_in_one_of_them_ends_both_after_the_step(tiny_dataset, tmp_path):
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    ended = ranks(2, tmp_path / "told", arguments, END="1,SIGINT,2")
    assert [status for status, _ in ended] == [130, 130], ended
    assert "stopped at step 4 of 6" in ended[0][1]
    assert sorted(path.name for path in (tmp_path / "run" / "checkpoints").iterdir()) == ["step_000004"]


def test_a_mistake_is_every_ranks_and_no_traceback(two, tiny_dataset, tmp_path):
    """What the first finds in the run folder, the others hear of."""
    before = sorted(path.relative_to(two) for path in (two / "run").rglob("*"))
    for status, text in ranks(2, tmp_path / "told", train_arguments(tiny_dataset, two / "run")):
        assert status == 2
        assert "Traceback" not in text
        assert text.strip().splitlines()[-1].startswith(f"error: {two / 'run'}: expected")
    assert sorted(path.relative_to(two) for path in (two / "run").rglob("*")) == before


@pytest.mark.parametrize(
    ("variables", "named"), [({"WORLD_SIZE": "2"}, "RANK"), ({"WORLD_SIZE": "two"}, "WORLD_SIZE")]
)
def test_half_an_environment_is_refused(monkeypatch, variables, named):
    for name in ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(UserError, match=f"^{named}: expected"), joined():
        pass


def test_one_process_exchanges_nothing(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "1")
    with joined() as only:
        assert only is ALONE
        assert not torch.distributed.is_initialized()
    values = torch.arange(3.0)
    assert ALONE.summed([values])[0] is values
    assert ALONE.summed_where_any([None, values], [values.shape] * 2) == [None, values]
    assert torch.equal(ALONE.gathered(values), values[None])
    assert ALONE.by_first(lambda: 7) == 7


def test_each_process_has_a_gpu_of_its_own(monkeypatch):
    third = Ranks(index=6, count=8, local=2, here=4)
    assert third.device_name("cuda") == "cuda"  # where there is none, which is said elsewhere
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    assert [third.device_name(name) for name in ("cpu", "cuda", "auto", None)] == ["cpu", *["cuda:2"] * 3]
    with pytest.raises(UserError, match="a GPU of its own, found cuda:1"):
        third.device_name("cuda:1")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 3)
    with pytest.raises(UserError, match="a GPU for each of the 4 processes on this machine"):
        third.device_name("cuda")
    assert ALONE.device_name("cuda:1") == "cuda:1"
