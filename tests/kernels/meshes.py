"""Small meshes before a camera, in pixels and metres of depth."""

import math

import torch

from samira_warp.kernels.mesh.topology import MeshTopology


def sphere(rings=8, sectors=12):
    """Vertices and faces of a closed unit sphere about the origin."""
    polar = torch.linspace(0, math.pi, rings + 1)[1:-1, None]
    around = (torch.arange(sectors) * (2 * math.pi / sectors))[None]
    body = torch.stack(
        [polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos().expand(-1, sectors)], dim=-1
    ).view(-1, 3)
    vertices = torch.cat([body, torch.tensor([[0.0, 0, 1], [0, 0, -1]])])
    faces = []
    for ring in range(rings - 2):
        for sector in range(sectors):
            a, b = ring * sectors + sector, ring * sectors + (sector + 1) % sectors
            faces += [[a, a + sectors, b], [b, a + sectors, b + sectors]]
    top, bottom, last = len(body), len(body) + 1, (rings - 2) * sectors
    for sector in range(sectors):
        after = (sector + 1) % sectors
        faces += [[top, sector, after], [bottom, last + after, last + sector]]
    return vertices, torch.tensor(faces)


def seen(vertices, *, focal, depth, center, radius=0.3):
    """Points (x, y, z) of vertices that are scaled, moved away and projected."""
    position = radius * vertices + vertices.new_tensor([0.0, 0.0, depth])
    screen = focal * position[:, :2] / position[:, 2:] + vertices.new_tensor(center)
    return torch.cat([screen, position[:, 2:]], dim=1)


def two_spheres(generator, device):
    """(2, V, 3) points of a sphere before another, in two frames of 40 x 30 pixels, and their topology."""
    vertices, faces = sphere()
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    vertices = vertices @ turn
    frames = [
        torch.cat(
            [
                seen(vertices, focal=60, depth=1.5, center=(20.3 + shift, 15.2)),
                seen(vertices, focal=60, depth=1.1, center=(27.1, 18.4 - shift), radius=0.12),
            ]
        )
        for shift in (0.0, 3.3)
    ]
    both = torch.cat([faces, faces + len(vertices)])
    return torch.stack(frames).to(device), MeshTopology.build(both.to(device), 2 * len(vertices))


def rectangle(left, top, right, bottom, depth=1.0, cells=1):
    """Points and faces of a rectangle before the camera, of cells x cells squares of two triangles."""
    ramp = torch.linspace(0, 1, cells + 1)
    y, x = torch.meshgrid(ramp, ramp, indexing="ij")
    points = torch.stack(
        [left + (right - left) * x, top + (bottom - top) * y, torch.full_like(x, depth)], dim=-1
    )
    corner = (torch.arange(cells)[:, None] * (cells + 1) + torch.arange(cells)).flatten()
    below = corner + cells + 1
    faces = torch.cat(
        [torch.stack([corner, corner + 1, below], dim=1), torch.stack([corner + 1, below + 1, below], dim=1)]
    )
    return points.view(-1, 3), faces


def scene(*meshes, device):
    """(1, V, 3) points and the topology of several meshes together."""
    points = torch.cat([points for points, _ in meshes])
    firsts = [sum(len(points) for points, _ in meshes[:index]) for index in range(len(meshes))]
    faces = torch.cat([faces + first for first, (_, faces) in zip(firsts, meshes, strict=True)])
    return points[None].to(device), MeshTopology.build(faces.to(device), len(points))
