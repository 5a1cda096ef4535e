"""gsplat, where it is installed, on the rasteriser's disc, stage against stage: like with like."""

from __future__ import annotations

import functools
import importlib
import importlib.util
from types import ModuleType
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.bench.disc import Disc
from samira_warp.bench.peer import FAILURES, say_left_out
from samira_warp.bench.timing import least_ms

REPEATS = 20


class GsplatTimes(NamedTuple):
    """Milliseconds of gsplat's stages.

    Attributes:
        prepare: All of ``rasterization`` without gradients, less ``forward``: projection and tile lists, as
            our own prepare.
        forward: ``rasterize_to_pixels`` alone, which is our blending.
        backward: Its adjoint.
    """

    prepare: float
    forward: float
    backward: float


def gsplat_times(disc: Disc, channels: int) -> GsplatTimes | None:
    """Time gsplat on a disc on a GPU.

    None where gsplat is absent, or fails (its first call builds it, with nvcc): stderr says why.
    """
    try:
        gsplat = _gsplat()
        return None if gsplat is None else _measure(gsplat, disc, channels)
    except FAILURES as error:
        say_left_out("gsplat", error)
        return None


@functools.cache
def _gsplat() -> ModuleType | None:
    return importlib.import_module("gsplat") if importlib.util.find_spec("gsplat") else None


def _measure(gsplat: ModuleType, disc: Disc, channels: int) -> GsplatTimes:
    camera, device = disc.camera, disc.means.device
    intrinsics = torch.tensor(
        [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]], device=device
    )
    gaussians = disc.raster_inputs(channels)
    view = (camera.world_to_camera[None], intrinsics[None], camera.width, camera.height)

    @torch.no_grad()
    def whole() -> dict[str, Tensor]:
        _, _, found = gsplat.rasterization(*gaussians, *view, packed=False)
        return found

    # one camera: everything per Gaussian is (1, N, ...)
    lists = whole()
    values = (lists["means2d"], lists["conics"], gaussians.features[None], lists["opacities"])
    leaves = [value.contiguous().clone().requires_grad_() for value in values]
    tiles = (lists["tile_size"], lists["isect_offsets"], lists["flatten_ids"])

    def blend() -> tuple[Tensor, Tensor]:
        return gsplat.rasterize_to_pixels(*leaves, camera.width, camera.height, *tiles)

    image, alpha = blend()
    grad_features, grad_transmittance = disc.image_gradients(channels)
    grad_image = (grad_features[None], -grad_transmittance[None, ..., None])
    forward = least_ms(blend, device, repeats=REPEATS)
    backward = least_ms(
        lambda: torch.autograd.grad((image, alpha), leaves, grad_image, retain_graph=True),
        device,
        repeats=REPEATS,
    )
    return GsplatTimes(least_ms(whole, device, repeats=REPEATS) - forward, forward, backward)
