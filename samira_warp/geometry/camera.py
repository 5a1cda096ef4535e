"""The pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from samira_warp.support.caching import cached_tensors


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with OpenCV axes (x right, y down, z forward); pixel centres lie at +0.5.

    Attributes:
        world_to_camera: (4, 4) float32 rigid transform, metres.
        fx: Focal length in pixels along x.
        fy: Focal length in pixels along y.
        cx: Principal point in pixels from the left edge.
        cy: Principal point in pixels from the top edge.
        width: W, pixels.
        height: H, pixels.
    """

    world_to_camera: Tensor
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def resized(self, *, width: int, height: int) -> Camera:
        """The same view on a grid of another size."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
            width=width,
            height=height,
        )

    def with_longer_side(self, pixels: int) -> Camera:
        """The same view at its own shape, with so many pixels along its longer side."""
        scale = pixels / max(self.width, self.height)
        return self.resized(
            width=max(round(self.width * scale), 1), height=max(round(self.height * scale), 1)
        )

    @property
    def field_of_view(self) -> float:
        """Degrees that the longer side spans where its middle is straight ahead."""
        longer, focal = max((self.width, self.fx), (self.height, self.fy), key=lambda side: side[0])
        return math.degrees(2.0 * math.atan(0.5 * longer / focal))

    def with_field_of_view(self, degrees: float) -> Camera:
        """The view from the same place through another lens; its principal point stays where it is.

        Args:
            degrees: `field_of_view`, above 0 and below 180.
        """
        tangents = [math.tan(math.radians(0.5 * angle)) for angle in (self.field_of_view, degrees)]
        factor = tangents[0] / tangents[1]
        return replace(self, fx=self.fx * factor, fy=self.fy * factor)

    def to(self, device: torch.device | str) -> Camera:
        """The same camera with its transform on ``device``."""
        return replace(self, world_to_camera=self.world_to_camera.to(device))

    def image_points(self, points: Tensor) -> Tensor:
        """(..., 3) x and y in pixels, and depth in metres, of (..., 3) points of the world."""
        seen = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        focal, center = seen.new_tensor([self.fx, self.fy]), seen.new_tensor([self.cx, self.cy])
        return torch.cat([focal * seen[..., :2] / seen[..., 2:] + center, seen[..., 2:]], dim=-1)

    @property
    def center(self) -> Tensor:
        """(3,) camera centre in world space, metres."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ translation

    def ray_directions(self) -> Tensor:
        """(H, W, 3) unit directions in world space from the camera through each pixel centre."""
        transform = self.world_to_camera
        rays = _unit_rays(
            self.fx, self.fy, self.cx, self.cy, self.width, self.height, transform.dtype, transform.device
        )
        return rays @ transform[:3, :3]


@cached_tensors(maxsize=4)
def _unit_rays(
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    width: int,
    height: int,
    dtype: torch.dtype,
    device: torch.device,
) -> Tensor:
    """(H, W, 3) unit directions in camera space: the same for every view of a sequence."""
    x = (torch.arange(width, dtype=dtype, device=device) + 0.5 - cx) / fx
    y = (torch.arange(height, dtype=dtype, device=device) + 0.5 - cy) / fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.nn.functional.normalize(torch.stack([x, y, torch.ones_like(x)], dim=-1), dim=-1)
