"""The head's UV atlas: what each texel of a UV map is on the mesh, computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from samira_warp.head.regions import REGIONS, response_coverage, route_faces
from samira_warp.head.template import HeadTemplate
from samira_warp.kernels.gathering.gather import GatherTable, gather
from samira_warp.kernels.mesh.uv_raster import rasterize_uv

DILATION = 2
"""Texels by which maps reach over chart borders, so that bilinear samples and 3 x 3 convolutions there see no
emptiness."""

SOFTENING = 3
"""Texels over which a region's response fades into its neighbour's."""


@dataclass(frozen=True, eq=False)
class UvAtlas:
    """Per-texel facts of a head's UV layout.

    Texel (row, column) has its centre at u = (column + 0.5) / W, v = 1 - (row + 0.5) / H.

    Attributes:
        size: H = W, texels.
        valid: (H, W) bool, texels whose centre a face covers, and those up to 2 texels beyond a chart's
            border, which copy the nearest covered one.
        region: (H, W) int8 index into REGIONS of every valid texel, else -1: the disjoint routing masks.
        soft_masks: (K, H, W) float32 routing masks softened within their charts; they sum to 1 where a
            texel's face is in some mask of the template, and are 0 elsewhere.
        position_table: Takes (V, C) values of vertices to the (H * W, C) flattened map; 0 where not valid.
        dilation_table: Takes the (H * W, C) flattened map to itself, valid texels copied from the nearest
            covered one, 0 elsewhere.
        vt: (T, 2) float32 UV coordinates, u to the right and v up.
        ft: (F, 3) int32 ids of the faces' UV coordinates.
    """

    size: int
    valid: Tensor
    region: Tensor
    soft_masks: Tensor
    position_table: GatherTable
    dilation_table: GatherTable
    vt: Tensor
    ft: Tensor

    @classmethod
    def build(cls, template: HeadTemplate, *, size: int) -> UvAtlas:
        """Rasterise a template's UV layout, on the CPU.

        Args:
            template: The head.
            size: H = W, texels.
        """
        vt, ft = torch.from_numpy(template.vt.copy()), torch.from_numpy(template.ft.copy())
        raster = rasterize_uv(vt, ft, size=size)
        source = torch.from_numpy(_nearest_covered(raster.face.numpy() >= 0))
        valid = source >= 0
        source = source.clamp(min=0).flatten()
        face = raster.face.flatten().long()[source].clamp(min=0).view(size, size)
        region = torch.where(valid, torch.from_numpy(route_faces(template))[face], -1).to(torch.int8)
        chart = torch.where(valid, torch.from_numpy(_charts(template))[face], -1)
        responds = valid & torch.from_numpy(response_coverage(template))[face]

        weights = raster.barycentrics.view(-1, 3)[source] * valid.view(-1, 1)
        corners = torch.from_numpy(template.faces)[face.flatten()]
        return cls(
            size=size,
            valid=valid,
            region=region,
            soft_masks=_soften(region.long(), chart, responds),
            position_table=GatherTable.build(corners, weights, sources=len(template.v_template)),
            dilation_table=GatherTable.build(source[:, None], valid.view(-1, 1).float(), sources=size * size),
            vt=vt,
            ft=ft,
        )

    def to(self, device: torch.device | str) -> UvAtlas:
        """The same atlas on ``device``."""
        moved: dict[str, Any] = {
            name: value.to(device)
            for name, value in vars(self).items()
            if isinstance(value, Tensor | GatherTable)
        }
        return replace(self, **moved)

    def positions(self, vertices: Tensor) -> Tensor:
        """(H, W, 3) position map P of (V, 3) float32 vertices (Eq. uv_displacement); 0 where not valid.

        Differentiable.
        """
        return gather(vertices, self.position_table).view(self.size, self.size, 3)

    def dilate(self, uv_map: Tensor) -> Tensor:
        """(H, W, C) float32 map with its covered texels carried 2 texels over chart borders, 0 beyond.

        Differentiable.
        """
        return gather(uv_map.flatten(0, 1), self.dilation_table).view(uv_map.shape)

    def uv_of(self, faces: Tensor, barycentrics: Tensor) -> Tensor:
        """UV coordinates of points on the mesh: Alg. 1's BarycentricReweight.

        Args:
            faces: (N,) integer face ids.
            barycentrics: (N, 3) float32 weights of the faces' corners.

        Returns:
            (N, 2) float32.
        """
        return (barycentrics[:, :, None] * self.vt[self.ft[faces.long()].long()]).sum(dim=1)


def _nearest_covered(covered: np.ndarray) -> np.ndarray:
    """(H, W) flat index of the nearest covered texel within the dilation, -1 where there is none.

    A covered texel's nearest is itself.
    """
    height, width = covered.shape
    own = np.arange(height * width).reshape(height, width)
    reach = range(-DILATION, DILATION + 1)
    steps = sorted(
        ((row, column) for row in reach for column in reach),
        key=lambda step: (step[0] ** 2 + step[1] ** 2, step),
    )
    nearest = np.full((height, width), -1)
    for row, column in steps:
        here, there = _overlap(height, row), _overlap(height, -row)
        across_here, across_there = _overlap(width, column), _overlap(width, -column)
        target = nearest[here, across_here]
        take = (target < 0) & covered[there, across_there]
        target[take] = own[there, across_there][take]
    return nearest


def _overlap(size: int, step: int) -> slice:
    """Indices i with i + step inside as well."""
    return slice(max(0, -step), max(0, size - max(0, step)))


def _charts(template: HeadTemplate) -> np.ndarray:
    """(F,) label of each face's chart: faces belong together when they share UV coordinates."""
    labels = np.arange(len(template.vt))
    while True:
        lowest = labels[template.ft].min(axis=1)
        joined = labels.copy()
        np.minimum.at(joined, template.ft, lowest[:, None])
        joined = joined[joined]
        if np.array_equal(joined, labels):
            return labels[template.ft[:, 0]]
        labels = joined


def _soften(region: Tensor, chart: Tensor, responds: Tensor) -> Tensor:
    """(K, H, W) shares of the regions in a cone of 3 texels about each texel, its own chart alone."""
    size = len(region)
    shares = torch.zeros(len(REGIONS), size, size)
    for row in range(-SOFTENING, SOFTENING + 1):
        for column in range(-SOFTENING, SOFTENING + 1):
            weight = 1 - (row**2 + column**2) ** 0.5 / (SOFTENING + 1)
            if weight <= 0:
                continue
            here, there = (
                (_overlap(size, row), _overlap(size, column)),
                (_overlap(size, -row), _overlap(size, -column)),
            )
            counts = responds[here] & responds[there] & (chart[here] == chart[there])
            view = shares[:, here[0], here[1]]
            view.scatter_add_(0, region[there].clamp(min=0)[None], weight * counts[None])
    return shares / shares.sum(dim=0).clamp(min=1e-8)
