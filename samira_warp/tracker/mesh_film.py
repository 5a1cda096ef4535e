"""A tracked mesh over its film, for a person to look at."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.io.files import whole_file
from samira_warp.io.images import to_uint8
from samira_warp.kernels import MeshTopology, antialias, interpolate, mesh_normals, rasterize_mesh
from samira_warp.stage.dots import draw_dots
from samira_warp.stage.video import VideoWriter
from samira_warp.support.validation import check_tensor

OPACITY = 0.55
"""Of the mesh: what is below it can be seen, and so can whether it fits."""

_SKIN = (0.35, 0.75, 1.0)
"""Display values of the mesh where it faces the camera."""

_AMBIENT = 0.25
"""Share of the brightness that has no direction."""

_DETECTED = (255, 210, 0)


def write_mesh_video(
    path: Path,
    pictures: Iterable[np.ndarray],
    vertices: Iterable[Tensor],
    topology: MeshTopology,
    camera: Camera,
    *,
    frames_per_second: float,
    landmarks: np.ndarray | None = None,
) -> None:
    """Write a film of pictures with the shaded mesh over them, and landmarks as yellow dots.

    Args:
        path: Where to write it, an .mp4.
        pictures: N pictures (H, W, 3) uint8 of the camera's size; they are taken one by one.
        vertices: (n, V, 3) float32 in camera space, of the next n frames each: x to the right, y down, z
            forward, metres. They are taken one by one, and drawn together: a few at once are enough.
        topology: The mesh, on the same device.
        camera: What focal length, centre and size are taken from; its place is not.
        frames_per_second: Of the film.
        landmarks: (N, L, 2) pixels; NaN where there is none.

    Raises:
        UserError: ``vertices`` has another shape than the topology needs, or a picture is too small for a
            film.
    """
    waiting, begin = iter(pictures), 0
    with whole_file(path) as fresh, VideoWriter(fresh, frames_per_second=frames_per_second) as film:
        for some in vertices:
            check_tensor(
                "vertices", some, shape=("N", topology.vertex_count, 3), device=topology.faces.device
            )
            layers = mesh_layers(some, topology, camera).cpu().numpy()
            for index, (layer, picture) in enumerate(
                zip(layers, islice(waiting, len(layers)), strict=True), start=begin
            ):
                shown = picture.astype(np.float32) / 255.0 * (1.0 - layer[..., 3:]) + layer[..., :3]
                if landmarks is not None:
                    radius = max(max(camera.width, camera.height) / 400.0, 1.0)
                    shown = draw_dots(shown, landmarks[index], _DETECTED, radius=radius)
                film.add(to_uint8(shown))
            begin += len(some)


@torch.no_grad()
def mesh_layers(vertices: Tensor, topology: MeshTopology, camera: Camera) -> Tensor:
    """(N, H, W, 4) premultiplied display values and coverage of meshes under a light at the camera.

    Args:
        vertices: (N, V, 3) float32 in camera space, metres.
        topology: The mesh.
        camera: As `write_mesh_video` takes it.
    """
    depth = vertices[..., 2:]
    focal = vertices.new_tensor([camera.fx, camera.fy])
    points = torch.cat(
        [focal * vertices[..., :2] / depth + vertices.new_tensor([camera.cx, camera.cy]), depth], dim=-1
    )
    raster = rasterize_mesh(points, topology, width=camera.width, height=camera.height)
    towards = -torch.nn.functional.normalize(vertices, dim=-1)
    # either side is lit: a surface that is seen from behind is no hole
    facing = (mesh_normals(vertices, topology) * towards).sum(dim=-1, keepdim=True).abs()
    bright = OPACITY * (_AMBIENT + (1.0 - _AMBIENT) * facing)
    colors = torch.cat([bright * vertices.new_tensor(_SKIN), torch.full_like(bright, OPACITY)], dim=-1)
    return antialias(interpolate(colors, raster, topology), raster, points, topology)
