"""The subject's head at rest: everything about geometry that does not change from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from samira_warp.head import FrameParameters, HeadModel, HeadTemplate, PosedHead, UvAtlas
from samira_warp.head.model import NECK
from samira_warp.kernels.mesh.triangle_frames import MeshTopology


@dataclass(frozen=True, eq=False)
class CanonicalHead:
    """One subject's head model, its atlas and its reference mesh M_ref.

    Attributes:
        template: The head model's file content.
        model: The head model.
        topology: Its triangles.
        atlas: Its UV atlas.
        shape: (n_shape,) identity coefficients.
        static_offset: (V, 3) metres, or None.
        vertices: (V, 3) reference mesh: shape and static offset, zero pose and expression, metres.
        positions: (H, W, 3) P_ref, metres.
    """

    template: HeadTemplate
    model: HeadModel
    topology: MeshTopology
    atlas: UvAtlas
    shape: torch.Tensor
    static_offset: torch.Tensor | None
    vertices: torch.Tensor
    positions: torch.Tensor

    @classmethod
    def build(
        cls, template: HeadTemplate, *, shape: torch.Tensor, static_offset: torch.Tensor | None, uv_size: int
    ) -> CanonicalHead:
        """Set up a subject's head.

        Args:
            template: The head model's file content.
            shape: (n_shape,) identity coefficients.
            static_offset: (V, 3) metres, or None.
            uv_size: Width and height of the UV maps.
        """
        model = HeadModel.build(template)
        atlas = UvAtlas.build(template, size=uv_size)
        topology = MeshTopology.build(torch.from_numpy(template.faces), len(template.v_template))
        vertices = model.vertices(replace(model.rest(), static_offset=static_offset), shape).vertices
        return cls(
            template, model, topology, atlas, shape, static_offset, vertices, atlas.positions(vertices)
        )

    def to(self, device: torch.device | str) -> CanonicalHead:
        """The same head on ``device``."""
        movable = ("model", "topology", "atlas", "shape", "vertices", "positions")
        moved = {name: getattr(self, name).to(device) for name in movable}
        return replace(
            self, **moved, static_offset=None if self.static_offset is None else self.static_offset.to(device)
        )

    def pose(self, parameters: FrameParameters) -> PosedHead:
        """The posed mesh M_t, with the subject's own shape and static offset, whatever offset the parameters
        came with.
        """
        return self.model.vertices(replace(parameters, static_offset=self.static_offset), self.shape)

    def displacement(self, head: PosedHead, *, in_head: bool) -> torch.Tensor:
        """D_uv (H, W, 3) in metres (Eq. uv_displacement).

        Args:
            head: The posed mesh.
            in_head: Undo the neck joint's motion first, so that what is left is expression; False is the
                equation as written.
        """
        vertices = head.in_head_frame() if in_head else head.vertices
        return self.atlas.positions(vertices - self.vertices)


def neck_rotation(head: PosedHead) -> torch.Tensor:
    """(3, 3) rotation of the head from the reference mesh's axes to the world's."""
    return head.joint_transforms[NECK, :3, :3]
