"""Memory of this process as the system counts it: every page that is in use, of whichever library."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from samira_warp.support.errors import UserError

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")

_FORGET_PEAK = "5"
"""What Linux takes for it (proc(5))."""


class Resident(NamedTuple):
    """Bytes of this process in memory.

    Attributes:
        now: At this moment.
        peak: At most, since `forget_peak`, else since the process began.
    """

    now: int
    peak: int


def resident() -> Resident:
    """What this process takes.

    Raises:
        UserError: The system does not tell.
    """
    try:
        lines = dict(re.findall(r"^(\w+):\s+(\d+) kB$", _STATUS.read_text(), flags=re.MULTILINE))
    except OSError as error:
        raise UserError("bench memory", expected=f"Linux's {_STATUS}", found=error.strerror) from error
    return Resident(now=1024 * int(lines["VmRSS"]), peak=1024 * int(lines["VmHWM"]))


def forget_peak() -> None:
    """Begin the peak anew at what is taken now.

    Raises:
        UserError: The system does not let this process do so.
    """
    try:
        _CLEAR.write_text(_FORGET_PEAK)
    except OSError as error:
        raise UserError("bench memory", expected=f"{_CLEAR} to be writable", found=error.strerror) from error
