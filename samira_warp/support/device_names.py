"""How a device is named on the command line; free of torch, for configurations."""

from __future__ import annotations

import re
from typing import Literal

from samira_warp.support.errors import UserError

DeviceName = Literal["auto", "cpu", "cuda"] | str
"""``auto``, ``cpu``, ``cuda`` or ``cuda:N``."""


def gpu_number(name: DeviceName) -> int | None:
    """The N of ``cuda:N``; None for every other name.

    Raises:
        UserError: It is no device's name.
    """
    found = re.fullmatch(r"auto|cpu|cuda(?::([0-9]+))?", name)
    if found is None:
        raise UserError("--device", expected="auto, cpu, cuda or cuda:N", found=name)
    return None if found[1] is None else int(found[1])
