"""What of a light arrives at a head past the head itself: cast shadows, blocked glints, openness to the sky.

Which directions of a fixed sky a posed mesh blocks is asked once a pose, in the head's own axes, and kept as
bits; that serves every light, turn and camera. What of a light arrives is then a sum over the sky. Factors
are those of vertices; Gaussians take theirs from the corners of their faces, and pixels from Gaussians. As a
ratio to what would arrive unblocked, which shading knows exactly, a coarse sky is exact where nothing blocks,
and its noise stays in the shadows (Heitz, Hill and McGuire 2018, "Combining analytic direct illumination and
stochastic shadows").
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.head import PosedHead
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.rays.arriving import arriving_irradiance, open_shares
from samira_warp.kernels.rays.occlusion import unblocked
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.light.equirect import turn_directions
from samira_warp.light.filtered import FilteredLight
from samira_warp.support.caching import cached_tensors

SKY_SIZE = 8
"""Texels along a face of the sky's cube: 384 directions, ten degrees apart, 48 bytes a vertex."""

BLOCK = 4
"""Directions are ordered in blocks of 4 x 4 texels, which rays are traced in together."""

SAMPLES = 4
"""Places along a texel of the sky where a light is looked up: finer than the light's own texels."""

GLOSSY, ROUGH = 0.25, 0.75
"""Roughness of the two lobes whose openness is asked for; in between it is blended."""

LEAST_OPEN = 0.05
"""Openness is held above this, so that light bounces at most twenty times as bright in what is closed."""


class Sky(NamedTuple):
    """D fixed directions in the head's axes.

    Attributes:
        directions: (D, 3) float32 unit vectors, every 16 in a row neighbours.
        areas: (D,) float32 solid angles, which sum to 4 pi.
        samples: (D, K, 3) float32 unit vectors, where the light of each is looked up.
    """

    directions: Tensor
    areas: Tensor
    samples: Tensor


@cached_tensors()
def sky(device: torch.device) -> Sky:
    """The sky on a device."""
    directions = _in_blocks(texel_directions(SKY_SIZE)[:, :, None, :, None])[:, 0]
    areas = _in_blocks(texel_solid_angles(SKY_SIZE).expand(6, -1, -1)[:, :, None, :, None, None])
    fine = texel_directions(SKY_SIZE, supersample=SAMPLES)
    samples = _in_blocks(fine.unflatten(2, (SKY_SIZE, SAMPLES)).unflatten(1, (SKY_SIZE, SAMPLES)))
    return Sky(*(values.contiguous().to(device) for values in (directions, areas[:, 0, 0], samples)))


def _in_blocks(texels: Tensor) -> Tensor:
    """(D, k k, C) of (6, S, k, S, k, C) texels with k x k values each, block by block."""
    blocks = SKY_SIZE // BLOCK
    split = texels.unflatten(3, (blocks, BLOCK)).unflatten(1, (blocks, BLOCK))
    face, row, row_in, sub_row, column, column_in, sub_column, channel = range(8)
    ordered = split.permute(face, row, column, row_in, column_in, sub_row, sub_column, channel)
    return ordered.flatten(0, 4).flatten(1, 2)


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Which directions of the sky one pose of V vertices blocks.

    Attributes:
        bits: (V, D / 32) int32 of `kernels.rays.occlusion.unblocked`.
        points: (V, 3) float32 vertices in the head's axes, metres.
        normals: (V, 3) float32 unit normals there.
        transform: (4, 4) float32, from there to the world.
        openness: (V, 1) float32, o: the share of a uniform sky that is open, weighted by the cosine.
    """

    bits: Tensor
    points: Tensor
    normals: Tensor
    transform: Tensor
    openness: Tensor

    @property
    def bytes(self) -> int:
        """Of memory that it holds."""
        return sum(values.nbytes for values in (self.bits, self.points, self.normals, self.openness))

    def under(self, head: PosedHead) -> Occlusion:
        """The same bits for a pose that has hardly moved in the head's axes, carried to where it is now."""
        return replace(self, transform=head.head_transform.detach())


class Occluder:
    """A head's triangles, to ask which directions they block; any thread may."""

    def __init__(self, vertices: Tensor, topology: MeshTopology) -> None:
        """Keep a mesh.

        Args:
            vertices: (V, 3) float32 at rest, metres.
            topology: Its triangles, on the same device.
        """
        self.topology = topology
        self._mesh = RayMesh(vertices, topology.faces)
        self._lock = threading.Lock()
        self._traced: Tensor | None = None

    @torch.no_grad()
    def occlude(self, head: PosedHead) -> Occlusion:
        """Trace one pose."""
        points = head.in_head_frame().detach().contiguous()
        normals = mesh_normals(points[None], self.topology)[0]
        directions, areas, _ = sky(points.device)
        bits = self._trace(points, normals, directions)
        uniform = areas[:, None].expand(-1, 3).contiguous()
        openness = _ratio(*arriving_irradiance(bits, normals, directions, uniform))[:, :1]
        return Occlusion(bits, points, normals, head.head_transform.detach(), openness.clamp(min=LEAST_OPEN))

    def arrival(self, occlusion: Occlusion, light: FilteredLight, camera: Camera) -> Tensor:
        """What of a light arrives at the vertices; differentiable in the light.

        Args:
            occlusion: What is blocked.
            light: On the same device.
            camera: Likewise; where glints are seen from.

        Returns:
            (V, 6) float32: the share of the diffuse light by colour, of a glossy and of a rough lobe about
            the mirrored view, and openness.
        """
        shares, lobes = self.shares(occlusion, light), self.lobes(occlusion, camera)
        return torch.cat([shares, lobes, occlusion.openness], dim=1)

    def shares(self, occlusion: Occlusion, light: FilteredLight) -> Tensor:
        """(V, 3) float32 share of a diffuse light that arrives, by colour, wherever it is seen from.

        Differentiable in the light, whose exposure does not matter.
        """
        normals, transform = occlusion.normals, occlusion.transform
        directions, _, _ = sky(normals.device)
        bits, toward, powers = occlusion.bits, directions, sky_powers(light, transform)
        if light.spots is not None:
            spots = (turn_directions(light.spots.directions, -light.rotate) @ transform[:3, :3]).contiguous()
            bits = torch.cat([bits, self._trace(occlusion.points, normals, spots)], dim=1)
            toward, powers = torch.cat([toward, spots]), torch.cat([powers, light.spots.powers])
        return _ratio(*arriving_irradiance(bits, normals, toward, powers))

    def lobes(self, occlusion: Occlusion, camera: Camera) -> Tensor:
        """(V, 2) float32 shares of a glossy and of a rough lobe about the mirrored view, under any light."""
        normals, transform = occlusion.normals, occlusion.transform
        directions, areas, _ = sky(normals.device)
        center = (camera.center - transform[:3, 3]) @ transform[:3, :3]
        view = torch.nn.functional.normalize(center - occlusion.points, dim=-1)
        mirrored = 2.0 * (normals * view).sum(dim=-1, keepdim=True) * normals - view
        edges = view.new_tensor([lobe_edge(GLOSSY), lobe_edge(ROUGH)])
        return open_shares(occlusion.bits, mirrored, edges, directions, areas)

    def _trace(self, points: Tensor, normals: Tensor, directions: Tensor) -> Tensor:
        """(V, D / 32) bits of what a pose leaves open; poses differ by their points."""
        with self._lock:
            if self._traced is not points:
                self._mesh.refit(points)
                self._traced = points
            return unblocked(points, normals, self._mesh, directions)


def sky_powers(light: FilteredLight, transform: Tensor) -> Tensor:
    """(D, 3) float32 power of each direction of the sky of a head in the world: radiance times solid angle.

    Differentiable in the light; its exposure is left out, which no ratio knows.
    """
    _, areas, samples = sky(transform.device)
    directions = turn_directions((samples @ transform[:3, :3].T).flatten(0, 1), light.rotate)
    radiance = sample_cubemap(light.radiance, directions.contiguous())
    return radiance.unflatten(0, samples.shape[:2]).mean(dim=1) * areas[:, None]


def lobe_edge(roughness: float) -> float:
    """The cosine of the angle at which a lobe of some roughness ends, for `open_shares`.

    Half vectors lie mostly within atan(alpha) of the normal, the mirrored light within twice that; a texel
    and a half of the sky is added, so that the narrowest lobe has directions in it.
    """
    angle = torch.tensor(roughness, dtype=torch.float64).square().atan() * 2.0 + 0.25
    return float(angle.cos())


def gaussian_arrival(arrival: Tensor, roughness: Tensor) -> Tensor:
    """The channels of light of Gaussians from what arrives at their places on the mesh.

    Args:
        arrival: (N, 6) of `vertex_arrival`, at the Gaussians.
        roughness: (N, 1), a constant.

    Returns:
        (N, 5) visibility, visibility_specular and ambient_occlusion, side by side.
    """
    shares, glossy, rough, openness = arrival.split((3, 1, 1, 1), dim=1)
    blend = ((roughness - GLOSSY) / (ROUGH - GLOSSY)).clamp(0.0, 1.0)
    return torch.cat([shares, torch.lerp(glossy, rough, blend), openness], dim=1)


def _ratio(arriving: Tensor, unblocked: Tensor) -> Tensor:
    """Arriving over unblocked irradiance, 1 where there is no light at all."""
    lit = unblocked > 0.0
    return torch.where(lit, arriving / torch.where(lit, unblocked, 1.0), 1.0)
