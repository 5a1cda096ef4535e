"""Radiance all around, as a file holds it: a panorama or a cube cross."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.cubemap.equirect import picture_equirect
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.light.cross import cross_to_cube, is_cross, resample_cube
from samira_warp.light.equirect import equirect_to_cube, turn_directions
from samira_warp.light.radiance_file import read_radiance
from samira_warp.support.errors import UserError


@dataclass(frozen=True, eq=False)
class RadianceMap:
    """A map at its own resolution.

    Attributes:
        texels: (H, 2 H, 3) panorama or (6, S, S, 3) cubemap, float32 linear radiance.
    """

    texels: Tensor

    @classmethod
    def read(cls, path: str | Path, *, ldr: bool = False) -> RadianceMap:
        """Read a map of any size.

        An equirectangular panorama (2:1) or a cube cross, lying (4:3) or upright (3:4): the shape tells which
        it is. What the file's header says of its pixels holds, see `radiance_file.read_radiance`.

        Args:
            path: A floating-point file (.hdr, .exr).
            ldr: Also take files of whole numbers (.jpg, .png), decoded from sRGB.

        Raises:
            UserError: `radiance_file.read_radiance` refuses it, or it is of another shape.
        """
        path = Path(path)
        radiance = read_radiance(path, ldr=ldr)
        height, width = radiance.shape[:2]
        if width == 2 * height:
            return cls(radiance)
        if is_cross(height, width):
            return cls(cross_to_cube(radiance))
        shapes = "an equirectangular map, twice as wide as high, or a cube cross, 4:3 or 3:4"
        raise UserError(path, expected=shapes, found=f"{width} x {height}")

    @property
    def face_size(self) -> int | None:
        """S of a cubemap, None of a panorama."""
        return self.texels.shape[1] if self.texels.dim() == 4 else None

    def to_cube(self, size: int) -> Tensor:
        """(6, size, size, 3) radiance, each texel the mean over its solid angle.

        A cubemap of that size is itself.
        """
        convert = equirect_to_cube if self.face_size is None else resample_cube
        return convert(self.texels, size=size)

    def look(self, directions: Tensor) -> Tensor:
        """(..., 3) radiance that unit directions (..., 3) float32 see, smooth between the map's texels."""
        if self.face_size is None:
            return picture_equirect(self.texels, directions)
        return sample_cubemap(self.texels, directions.reshape(-1, 3)).view(directions.shape)

    def behind(self, camera: Camera, *, rotate: float = 0.0) -> Tensor:
        """(H, W, 3) what a camera sees of it once it is turned by so many degrees."""
        return self.look(
            turn_directions(camera.to(self.texels.device).ray_directions().to(torch.float32), rotate)
        )

    def to(self, device: torch.device | str) -> RadianceMap:
        """The same map on ``device``."""
        return replace(self, texels=self.texels.to(device))
