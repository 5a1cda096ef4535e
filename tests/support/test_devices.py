"""Which device a name stands for, on machines with and without GPUs that torch and Warp can use."""

import subprocess
import sys
from types import SimpleNamespace

import pytest
import torch
import warp as wp

from samira_warp.support import devices
from samira_warp.support.device_names import gpu_number
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError


@pytest.fixture
def machine(monkeypatch):
    """A machine with so many GPUs as torch counts them, and the numbers of those that Warp finds."""

    def make(count, *, warp, current=0):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: count > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda: count)
        monkeypatch.setattr(torch.cuda, "current_device", lambda: current)
        found = [SimpleNamespace(alias=f"cuda:{number}") for number in warp]
        monkeypatch.setattr(wp, "get_cuda_devices", lambda: found)

    return make


@pytest.mark.parametrize(
    ("count", "current", "name", "expected"),
    [
        (0, 0, "auto", "cpu"),
        (0, 0, "cpu", "cpu"),
        (2, 0, "auto", "cuda:0"),
        (2, 1, "auto", "cuda:1"),
        (2, 0, "cpu", "cpu"),
        (2, 0, "cuda", "cuda:0"),
        (2, 1, "cuda", "cuda:1"),
        (2, 0, "cuda:1", "cuda:1"),
        (2, 1, "cuda:0", "cuda:0"),
    ],
)
def test_a_name_stands_for_a_device_with_its_number(machine, capsys, count, current, name, expected):
    machine(count, warp=range(count), current=current)
    assert pick_device(name) == torch.device(expected)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("count", "warp", "name", "complaint"),
    [
        (0, [], "cuda", "--device cuda: expected a CUDA device that torch can use, found none"),
        (0, [], "cuda:1", "--device cuda:1: expected a CUDA device that torch can use, found none"),
        (
            2,
            [0, 1],
            "cuda:2",
            "--device cuda:2: expected a CUDA device of this machine: cuda:0, cuda:1, found cuda:2",
        ),
        (1, [], "cuda", "--device cuda: expected a GPU that Warp can use, found cuda:0, for torch alone"),
        (
            2,
            [0],
            "cuda:1",
            "--device cuda:1: expected a GPU that Warp can use, found cuda:1, for torch alone",
        ),
    ],
)
def test_what_is_not_there_is_refused_by_its_name(machine, count, warp, name, complaint):
    machine(count, warp=warp)
    with pytest.raises(UserError) as refusal:
        pick_device(name)
    assert str(refusal.value) == complaint


@pytest.mark.parametrize(
    "name", ["", "gpu", "CUDA", "cuda:", "cuda:-1", "cuda:0 ", "cuda:1.5", "cuda0", "cpu:0", "mps", "cuda:٣"]
)
def test_no_other_name_is_taken(machine, name):
    machine(2, warp=[0, 1])
    with pytest.raises(UserError) as refusal:
        pick_device(name)
    assert str(refusal.value).startswith("--device: expected auto, cpu, cuda or cuda:N, found ")


def test_auto_says_why_it_leaves_a_gpu_to_torch(machine, capsys):
    machine(2, warp=[0], current=1)
    assert pick_device("auto") == torch.device("cpu")
    assert capsys.readouterr().err == "computing on the CPU: torch can use cuda:1, but Warp cannot\n"


def test_warp_is_not_started_where_torch_has_no_gpu(machine, monkeypatch):
    machine(0, warp=[])
    monkeypatch.setattr(devices, "start_warp", lambda: pytest.fail("started Warp for nothing"))
    assert pick_device("auto") == pick_device("cpu") == torch.device("cpu")


def test_names_are_looked_at_without_torch():
    assert [gpu_number(name) for name in ("auto", "cpu", "cuda", "cuda:0", "cuda:12")] == [None] * 3 + [0, 12]
    script = "import sys, samira_warp.support.device_names; assert not {'torch', 'warp'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


@pytest.mark.gpu
def test_the_gpus_of_this_machine_are_taken():
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    assert pick_device("auto") == pick_device("cuda")
    last = torch.cuda.device_count() - 1
    assert pick_device(f"cuda:{last}") == torch.ones(1, device=f"cuda:{last}").device
