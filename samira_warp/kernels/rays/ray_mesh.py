"""The mesh that rays are cast at: kept, and moved from frame to frame."""

from __future__ import annotations

import threading
import weakref

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.rays.block_tree import BlockTree
from samira_warp.kernels.runtime import stream_of, warp_array
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_ids, check_tensor


class RayMesh:
    """Triangles that kernels cast rays at, and a tree of boxes about them.

    The vertices are the mesh's own: what happens to the tensors that it was made from, or refitted to, does
    not reach it. Kernels take `id` and cast by `wp.mesh_query_ray` and its kin. A triangle is met from both
    sides, one without area by no ray; without faces no ray meets anything.

    Rays through a vertex may slip between the triangles about it, because their boxes are tested in float32:
    a few in a thousand do, and none in random directions. Warp's four triangles to a leaf are kept for that:
    with one, five times as many slip.

    Any number of threads may cast rays at one mesh. As with a tensor that is written to, no other thread may
    refit it meanwhile, and on a GPU no other stream that has not been waited for. A CUDA graph that casts
    rays at a mesh needs it for as long as it is replayed.

    `unblocked` on the CPU has a tree of its own, `blocks`, in which no ray slips through.

    Attributes:
        vertices: (V, 3) float32, where they are now; not to be written to.
        faces: (F, 3) int32 vertex ids.
        id: What kernels take for the mesh, a ``wp.uint64``.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        """Build the tree, in torch's current stream.

        On a GPU this waits for it, to look at the values.

        Args:
            vertices: (V, 3) float32.
            faces: (F, 3) integer vertex ids, on the same device.

        Raises:
            UserError: A tensor has another shape, dtype or device, a vertex is not finite, or a face has one
                that is not there.
        """
        check_tensor("vertices", vertices, shape=("V", 3))
        check_ids("faces", faces, shape=("F", 3), count=len(vertices), device=vertices.device)
        _check_finite(vertices)
        # `refit` writes into the vertices: they must be no tensors of an inference mode
        with torch.inference_mode(False):
            self.vertices = vertices.detach().clone(memory_format=torch.contiguous_format)
            self.faces = faces.to(torch.int32, memory_format=torch.contiguous_format, copy=True)
        points, corners = self.vertices, self.faces.flatten()
        if len(corners) == 0:
            # a triangle without area, so that kernels need not ask whether there are any
            points, corners = points.new_zeros(1, 3), corners.new_zeros(3)
        with stream_of(points.device):
            self._held = [wp.Mesh(points=warp_array(points, wp.vec3), indices=warp_array(corners, wp.int32))]
        self.id = int(self._held[0].id)
        self._triangles = points, corners.view(-1, 3)
        self._blocks: BlockTree | None = None
        self._building = threading.Lock()
        if points.device.type == "cuda":
            weakref.finalize(self, _free, self._held, points.device).atexit = False

    def __reduce__(self) -> tuple[type[RayMesh], tuple[Tensor, Tensor]]:
        """Copies build a tree of their own."""
        return RayMesh, (self.vertices, self.faces)

    @property
    def blocks(self) -> BlockTree:
        """The tree for a CPU's vector instructions: built when it is first asked for, then refitted, too."""
        with self._building, torch.inference_mode(False):
            if self._blocks is None:
                self._blocks = BlockTree(*self._triangles)
            return self._blocks

    def refit(self, vertices: Tensor) -> None:
        """Move the vertices, in torch's current stream: the boxes follow, the tree stays as it was built.

        It is never built anew in here. Over a head of 11,000 faces on one core a refit takes 0.25 ms and a
        new tree 5 ms, and after a turn of the head or an expression rays cost up to a quarter more than with
        a new one, some 0.2 microseconds each: a new mesh pays where tens of thousands of rays follow. In a
        shape that has nothing to do with the one that the tree was built for they cost several times as
        much; such a shape wants a mesh of its own.

        Args:
            vertices: (V, 3) float32 on the mesh's device. A GPU's are not looked at, which would wait for
                it: where one is not finite, rays may miss its triangles and others about them.

        Raises:
            UserError: Another shape, dtype or device, or, on the CPU, a vertex that is not finite.
        """
        check_tensor("vertices", vertices, shape=self.vertices.shape, device=self.vertices.device)
        if vertices.device.type == "cpu":
            _check_finite(vertices)
        self.vertices.copy_(vertices.detach())
        with stream_of(vertices.device):
            self._held[0].refit()
        if self._blocks is not None:
            self._blocks.refit(self._triangles[0])


def _check_finite(vertices: Tensor) -> None:
    finite = vertices.isfinite().all(dim=1)
    if not finite.all():
        first = int(finite.logical_not().nonzero()[0])
        raise UserError(
            "vertices", expected="finite coordinates", found=f"{vertices[first].tolist()} at vertex {first}"
        )


def _free(held: list[wp.Mesh], device: torch.device) -> None:
    """Free a mesh on a GPU after what is queued in the current stream: Warp by itself would not wait."""
    with stream_of(device):
        held.clear()
