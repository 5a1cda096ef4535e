"""Adjoints are written by hand and have none of their own: a second derivative is refused, not silently
wrong."""

import pytest
import torch
from kernels.scenes import block, straight_camera
from torch.autograd import grad

from samira_warp.kernels.cubemap.filter import irradiance
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.kernels.gathering.gather import GatherTable, gather
from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.binding import FaceBinding, bind
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.light import FilteredLight, shade
from samira_warp.surface import Surface


def frames_of(device, vertices):
    return triangle_frames(
        vertices, MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device), 4)
    )


def bound(device, means):
    binding, vertices = (
        FaceBinding.build(torch.tensor([0, 1, 1, 0], device=device), 2),
        torch.eye(4, 3, device=device),
    )
    quaternions = torch.eye(4, device=device)
    return bind(
        means,
        quaternions,
        torch.ones(4, 3, device=device),
        means.detach(),
        binding,
        frames_of(device, vertices),
    ).means


def shaded(device, albedo):
    one, normal = torch.ones(4, 1, device=device), torch.eye(4, 3, device=device)
    surface = Surface.of(albedo=albedo, normal=normal, roughness=one, specular=one)
    light = FilteredLight(*(lambda one: (one, (one,) * 2, one))(torch.ones(6, 2, 2, 3, device=device)))
    return shade(surface, normal, light).color


def rasterized(device, features):
    scene = block(torch.Generator().manual_seed(0), device, 4)
    return rasterize(*scene[:4], features, straight_camera(device, 20, 20)).features


def gathered(device, values):
    table = GatherTable.build(
        torch.zeros(5, 1, dtype=torch.long, device=device), torch.ones(5, 1, device=device), sources=4
    )
    return gather(values, table)


def drawn(device, points, colors):
    """Two triangles over a picture, and their outlines."""
    topology = MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device), 4)
    points = torch.cat([20 * points[None, :, :2], 1 + points[None, :, 2:]], dim=-1)
    raster = rasterize_mesh(points, topology, width=20, height=20)
    return antialias(interpolate(colors, raster, topology), raster, points.detach(), topology)


OPERATORS = {
    "antialias": lambda device, x: drawn(device, x.detach(), torch.ones(4, 3, device=device) * x),
    "bind": bound,
    "gather": gathered,
    "interpolate": lambda device, x: drawn(device, x, torch.ones(4, 3, device=device)),
    "irradiance": lambda device, x: irradiance(x[0, 0] * torch.ones(6, 4, 4, 3, device=device), size=2),
    "mesh_normals": lambda device, x: mesh_normals(
        x[None], MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device), 4)
    ),
    "rasterize": rasterized,
    "sample_cubemap": lambda device, x: sample_cubemap(torch.ones(6, 2, 2, 3, device=device), x),
    "shade": shaded,
    "triangle_frames": lambda device, x: frames_of(device, x).translation,
}


@pytest.mark.parametrize("operator", OPERATORS)
def test_a_second_derivative_is_refused(device, generator, operator):
    leaf = torch.rand(4, 3, generator=generator).to(device).requires_grad_()
    (first,) = grad(OPERATORS[operator](device, leaf).square().sum(), leaf, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        first.sum().backward()
