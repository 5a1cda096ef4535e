"""A head as it is tracked: its rig, its landmarks, and the smooth offsets that its shapes lack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head.landmarks import LandmarkEmbedding
from samira_warp.head.rig import Rig
from samira_warp.head.template import HeadTemplate
from samira_warp.tracker.surface_points import SurfacePoints
from samira_warp.tracker.unknowns import Layout

STILL = ("neck",)
"""Joints that are not turned: a neck's own turn is told by shoulders alone, which are left out."""


@dataclass(frozen=True, eq=False)
class TrackedHead:
    """What a fit needs of a head model.

    Attributes:
        template: The head.
        rig: The same as tensors, float32.
        faces: (F, 3) int64.
        basis: (V, K) float32 smooth functions, each of root mean square 1 over the vertices.
        roughness: (K,) float64 eigenvalues of the functions, relative to the first that is not constant.
        layout: What is solved for.
    """

    template: HeadTemplate
    rig: Rig
    faces: Tensor
    basis: Tensor
    roughness: Tensor
    layout: Layout

    @classmethod
    def build(cls, template: HeadTemplate, *, basis: np.ndarray, eigenvalues: np.ndarray) -> TrackedHead:
        """Prepare a head."""
        rig = Rig.build(template)
        functions = torch.tensor(basis, dtype=torch.float32)  # in aligned memory, as the rig is
        moving = tuple(joint for joint, name in enumerate(rig.joint_names) if joint == 0 or name not in STILL)
        return cls(
            template=template,
            rig=rig,
            faces=torch.from_numpy(template.faces).long(),
            basis=functions,
            roughness=torch.from_numpy(eigenvalues).double(),
            layout=Layout(
                joints=len(rig.joint_names),
                moving=moving,
                expressions=rig.n_expression,
                identities=rig.n_shape,
                functions=functions.shape[1],
            ),
        )

    def points(self, embedding: LandmarkEmbedding) -> SurfacePoints:
        """Landmarks as points on the surface."""
        corners = self.faces[torch.from_numpy(embedding.faces).long()]
        return self.surface_points(corners, torch.from_numpy(embedding.barycentrics))

    def surface_points(self, corners: Tensor, barycentrics: Tensor) -> SurfacePoints:
        """(L,) points by the vertices about them and their weights."""
        return SurfacePoints.build(
            self.rig, corners, barycentrics, basis=self.basis, moving=self.layout.moving
        )

    def rest_normals(self, corners: Tensor, barycentrics: Tensor) -> Tensor:
        """(L, 3) unit normals at points of the mean head."""
        normals = vertex_normals(self.rig.v_template, self.faces)[corners]
        return torch.nn.functional.normalize((barycentrics[..., None] * normals).sum(dim=1), dim=1)
