"""A training step asks torch for nothing that `torch.use_deterministic_algorithms` refuses on a GPU.

What it refuses is torch's own list, by the operators behind it; a GPU has the last word where there is one.
"""

import pytest
import torch
from subjects import train_arguments, train_command, write_lpips_weights
from torch.utils._python_dispatch import TorchDispatchMode

from samira_warp.nets import RegionModulators
from samira_warp.train.trainer import Trainer

REFUSED = {
    "adaptive_avg_pool2d": "_adaptive_avg_pool2d_backward",
    "adaptive_max_pool2d": "adaptive_max_pool2d_backward",
    "interpolate": "upsample_linear1d_backward upsample_bilinear2d_backward upsample_bicubic2d_backward",
    "reflection": "reflection_pad1d_backward reflection_pad2d_backward reflection_pad3d_backward",
    "grid_sample": "grid_sampler_2d_backward grid_sampler_3d_backward",
    "loss": "nll_loss_forward nll_loss2d_forward _ctc_loss_backward",
    "unpool": "max_unpool2d max_unpool3d",
    "put": "put_ put",
    "counts": "histc",
    "median": "median.dim nanmedian.dim",
}
"""Operators by what they are behind; `cumsum` and weighted `bincount` are looked at below."""


class Asked(TorchDispatchMode):
    """Names of all operators that run, and of those that are refused for some arguments alone."""

    def __init__(self):
        super().__init__()
        self.names, self.refused = set(), []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.name().removeprefix("aten::")
        self.names.add(name)
        of_floats = args and isinstance(args[0], torch.Tensor) and args[0].is_floating_point()
        weighted = len(args) > 1 and args[1] is not None
        if (name.startswith("cumsum") and of_floats) or (name == "bincount" and weighted):
            self.refused.append(name)
        return function(*args, **(kwargs or {}))


@pytest.fixture
def asked(monkeypatch):
    """What all steps of a run ask for, with the GPU's way through the regions."""
    mode, step = Asked(), Trainer.train_step

    def watched(self):
        with mode:
            return step(self)

    monkeypatch.setattr(Trainer, "train_step", watched)
    monkeypatch.setattr(RegionModulators, "_each_its_own", RegionModulators._at_once)
    return mode


def test_nothing_is_asked_for_that_is_refused(asked, tiny_dataset, tmp_path):
    weights = write_lpips_weights(tmp_path / "weights", "alex")
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    assert train_command(*arguments, "--lpips-weights", weights) == 0
    assert {"convolution", "convolution_backward", "mm"} <= asked.names
    refused = {name for names in REFUSED.values() for name in names.split()}
    assert asked.names & refused == set()
    assert asked.refused == []


def test_the_watch_sees_what_is_refused():
    pooled = torch.nn.AdaptiveAvgPool2d(2)
    with Asked() as mode:
        grown = torch.nn.functional.interpolate(
            pooled(torch.rand(1, 1, 8, 8, requires_grad=True)), scale_factor=2.0, mode="bilinear"
        )
        grown.sum().backward()
        torch.rand(3).cumsum(0)
    assert {"_adaptive_avg_pool2d_backward", "upsample_bilinear2d_backward"} <= mode.names
    assert mode.refused == ["cumsum"]
