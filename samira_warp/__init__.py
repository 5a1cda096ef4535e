"""Relightable, animatable Gaussian head avatars from a tracked monocular video."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

# Before torch loads OpenMP: its threads spin between parallel regions by default, and on a machine that other
# processes also use, spinning threads keep the cores from the thread that has work: training steps then take
# ten times as long. Waiting costs next to nothing.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = "0.1.0"
__all__ = ["Avatar", "Camera", "Environment", "UserError", "__version__"]

if TYPE_CHECKING:
    from samira_warp.avatar import Avatar
    from samira_warp.geometry.camera import Camera
    from samira_warp.light import Environment
    from samira_warp.support.errors import UserError

_HOMES = {
    "Avatar": "avatar",
    "Camera": "geometry.camera",
    "Environment": "light",
    "UserError": "support.errors",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``import samira_warp`` itself loads neither torch nor
    Warp.
    """
    import importlib

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"samira_warp.{_HOMES[name]}"), name)
