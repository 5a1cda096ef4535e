"""The choice between a GPU and the CPU, the same for every verb."""

from __future__ import annotations

import sys

import torch
import warp as wp
from torch import Tensor

from samira_warp.support.device_names import DeviceName, gpu_number
from samira_warp.support.errors import UserError
from samira_warp.support.warp_start import start_warp


def pick_device(name: DeviceName) -> torch.device:
    """The device that ``--device`` names, a GPU with its number.

    ``auto`` takes torch's current GPU where torch and Warp can use it, else the CPU; a line on standard error
    says so where torch alone can. ``cuda`` takes torch's current GPU, ``cuda:N`` that one.

    Raises:
        UserError: It is no device's name, or a GPU that is not there or that Warp cannot use.
    """
    number = gpu_number(name)
    if name == "cpu" or (name == "auto" and not torch.cuda.is_available()):
        return torch.device("cpu")
    if not torch.cuda.is_available():
        raise UserError(f"--device {name}", expected="a CUDA device that torch can use", found="none")
    if number is None:
        number = torch.cuda.current_device()
    elif number >= torch.cuda.device_count():
        there = ", ".join(f"cuda:{index}" for index in range(torch.cuda.device_count()))
        raise UserError(f"--device {name}", expected=f"a CUDA device of this machine: {there}", found=name)
    if not _warp_has(number):
        if name != "auto":
            raise UserError(
                f"--device {name}",
                expected="a GPU that Warp can use",
                found=f"cuda:{number}, for torch alone",
            )
        print(f"computing on the CPU: torch can use cuda:{number}, but Warp cannot", file=sys.stderr)
        return torch.device("cpu")
    return torch.device("cuda", number)


def sent(values: Tensor, device: torch.device) -> Tensor:
    """A tensor of the CPU's on ``device``, without waiting for what a GPU is at work on."""
    if device.type != "cuda":
        return values.to(device)
    return values.pin_memory().to(device, non_blocking=True)


def _warp_has(number: int) -> bool:
    """Whether Warp found a GPU too: it needs a newer driver than torch may, and has builds without CUDA."""
    start_warp()
    return f"cuda:{number}" in {device.alias for device in wp.get_cuda_devices()}
