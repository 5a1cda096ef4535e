"""The subject's head at rest: everything about geometry that does not change from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, HeadTemplate, PosedHead, Rig, UvAtlas
from samira_warp.kernels.mesh.topology import MeshTopology


@dataclass(frozen=True, eq=False)
class CanonicalHead:
    """One subject's rig, its atlas and its reference mesh M_ref.

    Attributes:
        template: The head's file content.
        rig: What poses it.
        topology: Its triangles.
        atlas: Its UV atlas.
        shape: (n_shape,) identity coefficients.
        static_offset: (V, 3) metres, or None.
        vertices: (V, 3) reference mesh: shape and static offset, zero pose and expression, metres.
        positions: (H, W, 3) P_ref, metres.
    """

    template: HeadTemplate
    rig: Rig
    topology: MeshTopology
    atlas: UvAtlas
    shape: Tensor
    static_offset: Tensor | None
    vertices: Tensor
    positions: Tensor

    def sampling_interval(self, parameters: FrameParameters, camera: Camera) -> float:
        """Metres between the points of the posed head that neighbouring pixels of a camera see."""
        middle = self.pose(parameters).vertices.mean(dim=0)
        depth = camera.world_to_camera[2, :3] @ middle + camera.world_to_camera[2, 3]
        return float(depth) / max(camera.fx, camera.fy)

    @classmethod
    def build(
        cls, template: HeadTemplate, *, shape: Tensor, static_offset: Tensor | None, uv_size: int
    ) -> CanonicalHead:
        """Set up a subject's head.

        Args:
            template: The head's file content.
            shape: (n_shape,) identity coefficients.
            static_offset: (V, 3) metres, or None.
            uv_size: Width and height of the UV maps.
        """
        rig = Rig.build(template)
        atlas = UvAtlas.build(template, size=uv_size)
        topology = MeshTopology.build(torch.from_numpy(template.faces), len(template.v_template))
        vertices = rig.pose(rig.rest(), shape, static_offset).vertices
        return cls(template, rig, topology, atlas, shape, static_offset, vertices, atlas.positions(vertices))

    def to(self, device: torch.device | str) -> CanonicalHead:
        """The same head on ``device``."""
        return replace(
            self,
            rig=self.rig.to(device),
            topology=self.topology.to(device),
            atlas=self.atlas.to(device),
            shape=self.shape.to(device),
            static_offset=None if self.static_offset is None else self.static_offset.to(device),
            vertices=self.vertices.to(device),
            positions=self.positions.to(device),
        )

    def pose(self, parameters: FrameParameters) -> PosedHead:
        """The posed meshes M_t, with the subject's own shape and static offset."""
        return self.rig.pose(parameters, self.shape, self.static_offset)

    def displacement(self, head: PosedHead, *, in_head: bool) -> Tensor:
        """D_uv (H, W, 3) in metres (Eq. uv_displacement).

        Args:
            head: One posed mesh.
            in_head: Undo the head joint's motion first, so that what is left is expression; False is the
                equation as written.
        """
        vertices = head.in_head_frame() if in_head else head.vertices
        return self.atlas.positions(vertices - self.vertices)
