"""The choice between a GPU and the CPU, the same for every verb."""

from __future__ import annotations

from typing import Literal

import torch

from samira_warp.support.errors import UserError

DeviceName = Literal["auto", "cpu", "cuda"]


def pick_device(name: DeviceName) -> torch.device:
    """The device that ``--device`` names; auto takes a GPU where there is one.

    Raises:
        UserError: A GPU is asked for where there is none.
    """
    gpu = torch.cuda.is_available()
    if name == "cuda" and not gpu:
        raise UserError("--device cuda", expected="a CUDA device that torch can use", found="none")
    return torch.device("cuda" if name != "cpu" and gpu else "cpu")
