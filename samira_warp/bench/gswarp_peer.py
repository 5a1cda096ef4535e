"""gswarp, where it is installed, on the rasteriser's disc: another rasteriser in Warp, of three channels."""

from __future__ import annotations

import functools
import importlib
import importlib.util
from types import ModuleType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from samira_warp.bench.disc import Disc
from samira_warp.bench.peer import FAILURES, say_left_out
from samira_warp.bench.timing import least_ms
from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.rasterizer import rasterize

CHANNELS = 3
"""All that it blends."""

REPEATS = 20

NEAR, FAR = 0.01, 100.0
"""Metres: depths that its projection keeps within 0 and 1."""


class GswarpTimes(NamedTuple):
    """Milliseconds of gswarp's operator, which is not taken apart, and how near its picture is.

    Attributes:
        forward: Projection, tile lists and blending, with what the backward pass wants.
        backward: The adjoint by all five inputs, of colour and alpha.
        difference: Mean absolute difference of its blended features from ours, which are 0 to 1: a Gaussian
            is spread by 0.3 pixels squared there, by 0.1 here.
    """

    forward: float
    backward: float
    difference: float


def gswarp_times(disc: Disc) -> GswarpTimes | None:
    """Time gswarp on a disc on a GPU. None where it is absent, or fails: stderr says why."""
    try:
        gswarp = _gswarp()
        return None if gswarp is None else _measure(gswarp, disc)
    except FAILURES as error:
        say_left_out("gswarp", error)
        return None


@functools.cache
def _gswarp() -> ModuleType | None:
    return importlib.import_module("gswarp") if importlib.util.find_spec("gswarp") else None


def _measure(gswarp: ModuleType, disc: Disc) -> GswarpTimes:
    device = disc.means.device
    rasterizer = gswarp.GaussianRasterizer(gswarp.GaussianRasterizationSettings(**settings_of(disc.camera)))
    inputs = disc.raster_inputs(CHANNELS)
    leaves = [value.clone().requires_grad_() for value in inputs]
    means, quaternions, scales, opacities, features = leaves
    on_screen = torch.zeros_like(means)

    def draw() -> tuple[Tensor, Tensor]:
        color, _, found = rasterizer(
            means3D=means, means2D=on_screen, opacities=opacities[:, None], colors_precomp=features,
            scales=scales, rotations=quaternions,
        )  # fmt: skip
        return color, found.alpha

    images = draw()
    grad_features, grad_transmittance = disc.image_gradients(CHANNELS)
    grad_images = (grad_features.permute(2, 0, 1).contiguous(), -grad_transmittance[None])
    with torch.no_grad():
        ours = rasterize(*inputs, disc.camera).features
        difference = float((images[0].permute(1, 2, 0) - ours).abs().mean())
    return GswarpTimes(
        forward=least_ms(draw, device, repeats=REPEATS),
        backward=least_ms(
            lambda: torch.autograd.grad(images, leaves, grad_images, retain_graph=True),
            device,
            repeats=REPEATS,
        ),
        difference=difference,
    )


def settings_of(camera: Camera) -> dict[str, Any]:
    """A camera as those of diff-gaussian-rasterization's interface describe it, before black.

    Its matrices are for row vectors: the transposes of world to camera, and of world to clip space, where x
    and y are -1 to 1 over the image and z is 0 to 1 from `NEAR` to `FAR`. Its principal point is the middle
    of the image.
    """
    device = camera.world_to_camera.device
    half_width, half_height = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    projection = torch.zeros(4, 4, device=device)
    projection[0, 0], projection[1, 1] = 1.0 / half_width, 1.0 / half_height
    projection[2, 2], projection[2, 3] = FAR / (FAR - NEAR), -FAR * NEAR / (FAR - NEAR)
    projection[3, 2] = 1.0
    return {
        "image_height": camera.height,
        "image_width": camera.width,
        "tanfovx": half_width,
        "tanfovy": half_height,
        "bg": torch.zeros(CHANNELS, device=device),
        "scale_modifier": 1.0,
        "viewmatrix": camera.world_to_camera.T.contiguous(),
        "projmatrix": (projection @ camera.world_to_camera).T.contiguous(),
        "sh_degree": 0,
        "campos": camera.world_to_camera.inverse()[:3, 3].contiguous(),
        "prefiltered": False,
        "auto_tune_verbose": False,
    }
