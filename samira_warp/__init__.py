"""Relightable, animatable Gaussian head avatars from a tracked monocular video."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily
from samira_warp.support.moved import keep_old_paths

# Before torch loads OpenMP: its threads spin between parallel regions by default, and on a machine that other
# processes also use, spinning threads keep the cores from the thread that has work: training steps then take
# ten times as long. Waiting costs next to nothing.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

keep_old_paths()

__version__ = "0.1.0"
__all__ = [
    "Avatar",
    "Camera",
    "Environment",
    "MaterialEdit",
    "UserError",
    "__version__",
    "open_sequence",
    "read_frames",
]

if TYPE_CHECKING:
    from samira_warp.avatar import Avatar, MaterialEdit, read_frames
    from samira_warp.data import open_sequence
    from samira_warp.geometry.camera import Camera
    from samira_warp.light import Environment
    from samira_warp.support.errors import UserError

__getattr__ = lazily(
    __name__,
    {
        "Avatar": "avatar",
        "Camera": "geometry.camera",
        "Environment": "light",
        "MaterialEdit": "avatar",
        "UserError": "support.errors",
        "open_sequence": "data",
        "read_frames": "avatar",
    },
)
