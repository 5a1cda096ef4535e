"""Attributes of a mesh's corners in the pixels that show the mesh."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.gathering.sums import sum_groups
from samira_warp.kernels.mesh.mesh_raster import MeshRaster
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensor, check_tensors

GRAIN = 4096
"""Pixels, or triangles, that are worth a thread."""


def interpolate(attributes: Tensor, raster: MeshRaster, topology: MeshTopology) -> Tensor:
    """Interpolate what belongs to the corners, differentiably in the attributes and the barycentrics.

    Args:
        attributes: (V, C) float32 for all frames alike, or (B, V, C).
        raster: What the pixels show.
        topology: Whose attributes each triangle has at its corners: the mesh that was rasterised, or one of
            as many triangles in the same order, such as those of a UV layout.

    Returns:
        (B, H, W, C) float32, 0 where there is no triangle.

    Raises:
        UserError: A tensor has another shape, dtype or device than the others need.
    """
    face_count, shared = topology.faces.shape[0], isinstance(attributes, Tensor) and attributes.ndim == 2
    check_tensors(
        ("raster.face", raster.face, ("B", "H", "W"), torch.int32),
        ("raster.barycentrics", raster.barycentrics, ("B", "H", "W", 3)),
        ("raster.boxes", raster.boxes, ("B", face_count, 4), torch.int32),
        device=topology.faces.device,
    )
    by_vertex = (topology.vertex_count, "C")
    check_tensor(
        "attributes",
        attributes,
        shape=by_vertex if shared else (raster.face.shape[0], *by_vertex),
        device=topology.faces.device,
    )
    return _Interpolate.apply(attributes, raster.barycentrics, raster, topology)


class _Interpolate(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, attributes: Tensor, barycentrics: Tensor, raster: MeshRaster, topology: MeshTopology
    ) -> Tensor:
        shared = attributes.ndim == 2
        by_frame = (attributes[None] if shared else attributes).contiguous()
        shape, channels = raster.face.shape, attributes.shape[-1]
        face, barycentrics = raster.face.flatten(), barycentrics.reshape(-1, 3)
        image = attributes.new_empty(face.shape[0], channels)
        per_frame = shape[1] * shape[2]
        seen = (face, barycentrics)
        launch_range(_interpolate, len(face), by_frame, topology.faces, per_frame, *seen, image, grain=GRAIN)
        ctx.save_for_backward(by_frame, face, barycentrics, raster.boxes)
        ctx.topology, ctx.shared, ctx.shape = topology, shared, shape
        return image.view(*shape, channels)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_image: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        by_frame, face, barycentrics, boxes = ctx.saved_tensors
        topology: MeshTopology = ctx.topology
        frames, height, width = ctx.shape
        grad_image = grad_image.reshape(len(face), by_frame.shape[2])
        grad_attributes = grad_barycentrics = None
        if ctx.needs_input_grad[0]:
            faces = topology.faces.shape[0]
            grad_corners = grad_image.new_empty(frames, 3 * faces, grad_image.shape[1])
            seen = (boxes.contiguous(), width, height, face, barycentrics, grad_image)
            launch_range(_gather_attributes, frames * faces, *seen, grad_corners, grain=GRAIN)
            together = frames if ctx.shared else 1
            grad_attributes = sum_groups(grad_corners, topology.corners, together=together)
            grad_attributes = grad_attributes[0] if ctx.shared else grad_attributes
        if ctx.needs_input_grad[1]:
            grad_barycentrics = torch.empty_like(barycentrics)
            shown = (by_frame, topology.faces, height * width, face, grad_image)
            launch_range(_gather_weights, len(face), *shown, grad_barycentrics, grain=GRAIN)
            grad_barycentrics = grad_barycentrics.view(*ctx.shape, 3)
        return grad_attributes, grad_barycentrics, None, None


@wp.func
def _own_or_shared(attributes: wp.array3d[wp.float32], frame: wp.int32) -> wp.int32:
    """The frame's own attributes, or those of all frames."""
    return wp.min(frame, attributes.shape[0] - 1)


@wp.kernel(enable_backward=False)
def _interpolate(
    first: wp.int32,
    attributes: wp.array3d[wp.float32],
    faces: wp.array2d[wp.int32],
    per_frame: wp.int32,
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    image: wp.array2d[wp.float32],
) -> None:
    """One pixel."""
    pixel = first + wp.tid()
    shown = face[pixel]
    if shown < 0:
        for channel in range(image.shape[1]):
            image[pixel, channel] = 0.0
        return
    source = _own_or_shared(attributes, pixel // per_frame)
    weights = barycentrics[pixel]
    a, b, c = faces[shown, 0], faces[shown, 1], faces[shown, 2]
    for channel in range(image.shape[1]):
        image[pixel, channel] = (
            weights[0] * attributes[source, a, channel]
            + weights[1] * attributes[source, b, channel]
            + weights[2] * attributes[source, c, channel]
        )


@wp.kernel(enable_backward=False)
def _gather_weights(
    first: wp.int32,
    attributes: wp.array3d[wp.float32],
    faces: wp.array2d[wp.int32],
    per_frame: wp.int32,
    face: wp.array[wp.int32],
    grad_image: wp.array2d[wp.float32],
    grad_barycentrics: wp.array[wp.vec3],
) -> None:
    """One pixel's gradients of its barycentrics."""
    pixel = first + wp.tid()
    shown = face[pixel]
    total = wp.vec3(0.0)
    if shown >= 0:
        source = _own_or_shared(attributes, pixel // per_frame)
        a, b, c = faces[shown, 0], faces[shown, 1], faces[shown, 2]
        for channel in range(grad_image.shape[1]):
            total += grad_image[pixel, channel] * wp.vec3(
                attributes[source, a, channel], attributes[source, b, channel], attributes[source, c, channel]
            )
    grad_barycentrics[pixel] = total


@wp.kernel(enable_backward=False)
def _gather_attributes(
    first: wp.int32,
    boxes: wp.array2d[wp.vec4i],
    width: wp.int32,
    height: wp.int32,
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    grad_image: wp.array2d[wp.float32],
    grad_corners: wp.array3d[wp.float32],
) -> None:
    """One triangle of one frame: the gradients of its corners' attributes, from its pixels."""
    index = first + wp.tid()
    frame = index // boxes.shape[1]
    shown = index - frame * boxes.shape[1]
    channels = grad_image.shape[1]
    for corner in range(3):
        for channel in range(channels):
            grad_corners[frame, 3 * shown + corner, channel] = 0.0
    box = boxes[frame, shown]
    for row in range(box[1], box[3]):
        line = (frame * height + row) * width
        for pixel in range(line + box[0], line + box[2]):
            if face[pixel] != shown:
                continue
            weights = barycentrics[pixel]
            for channel in range(channels):
                grad = grad_image[pixel, channel]
                grad_corners[frame, 3 * shown, channel] += weights[0] * grad
                grad_corners[frame, 3 * shown + 1, channel] += weights[1] * grad
                grad_corners[frame, 3 * shown + 2, channel] += weights[2] * grad
