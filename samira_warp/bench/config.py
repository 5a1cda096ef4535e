"""Options of the bench verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from samira_warp.support.device_names import DeviceName


@dataclass(frozen=True)
class BenchConfig:
    """Measure a part of the package on this machine: its time, or its memory."""

    what: Positional[
        Literal["raster", "mesh", "visibility", "light", "avatar", "view", "drive", "train", "memory", "gpu"]
    ]
    """raster: kernels against plain ones or, on a GPU, gsplat; mesh: the rasteriser of meshes; visibility:
    what a head blocks of its own directions; light: filtering; avatar: a frame, train: a step, by stage;
    view: a picture of the viewer; drive: from a picture of a face to the avatar's; memory: what a training
    takes of it, by stage; gpu: all that wants a GPU, its tests too, in eight minutes."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""
    json: bool = False
    """Print JSON instead of a table."""
    hdri: Path | None = None
    """light: also shade a sphere and a head under every map of this folder, against Monte Carlo (minutes)."""
    count: bool = False
    """train: count what a step launches and waits for, instead of its time."""
    film: Path | None = None
    """drive: a film of a face; default pictures of the built-in subject, whose dataset is made first."""
    data: Path | None = None
    """gpu, memory: the dataset to train on; default the built-in subject's, which is made first."""
