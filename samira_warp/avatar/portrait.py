"""How an avatar and a rendering show themselves where a notebook asks for a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from samira_warp.avatar.canonical import CanonicalHead
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import encode_png, to_uint8

if TYPE_CHECKING:
    from samira_warp.avatar.avatar import Avatar
    from samira_warp.light import FilteredLight

PORTRAIT_SIDE = 256
"""Pixels: a tenth of a second of two cores."""

DISTANCE = 1.0
"""Metres from the middle of a head to the camera."""

MARGIN = 1.2
"""The picture's side, in the head's larger extent."""


def portrait_camera(canonical: CanonicalHead) -> Camera:
    """A camera before the face of a head at rest that has all of it in its picture, upright."""
    low, high = canonical.vertices.amin(dim=0), canonical.vertices.amax(dim=0)
    extent = float((high - low)[:2].max())
    nearest = DISTANCE - 0.5 * float(high[2] - low[2])
    focal = PORTRAIT_SIDE * nearest / (MARGIN * extent)
    # OpenCV's axes: right, down, forward
    axes = torch.diag(low.new_tensor([1.0, -1.0, -1.0]))
    world_to_camera = torch.eye(4, dtype=low.dtype, device=low.device)
    world_to_camera[:3, :3] = axes
    world_to_camera[:3, 3] = -axes @ (0.5 * (low + high))
    world_to_camera[2, 3] += DISTANCE
    middle = 0.5 * PORTRAIT_SIDE
    return Camera(world_to_camera, focal, focal, middle, middle, PORTRAIT_SIDE, PORTRAIT_SIDE)


class Portraits:
    """An avatar's picture of itself; its light is filtered once for as long as nothing changes it."""

    def __init__(self) -> None:
        self._made_of: tuple[object, ...] | None = None
        self._light: FilteredLight | None = None

    @torch.no_grad()
    def draw(self, avatar: Avatar) -> Tensor:
        """(256, 256, 3) display values: the face at rest under the learned light, on white."""
        parameters = avatar.canonical.rig.rest()
        camera = portrait_camera(avatar.canonical)
        light, shadows = self._learned(avatar), avatar.settings.visibility
        return avatar.render(parameters, camera, light, shadows=shadows).image

    def _learned(self, avatar: Avatar) -> FilteredLight:
        # torch counts what was written to a tensor; a place in memory tells it from others
        values = [parameter.detach() for parameter in avatar.light.parameters()]
        made_of = tuple((value.data_ptr(), value._version, value.device) for value in values)
        if self._light is None or made_of != self._made_of:
            self._light, self._made_of = avatar.light(), made_of
        return self._light


def png_of(image: Tensor) -> bytes:
    """Display values (H, W, 3) as the bytes of a PNG file, clipped to 0..1."""
    return encode_png(to_uint8(image.detach().cpu().numpy()))
