import torch
from kernels.meshes import rectangle, sphere

from samira_warp.kernels import MeshTopology


def edges_of(faces, count, device):
    topology = MeshTopology.build(torch.as_tensor(faces, device=device), count)
    ends, opposites, ends_of = topology.edges
    assert (ends[:, 0] < ends[:, 1]).all()
    # each end is listed under its vertex, and once
    assert ends_of.members.sort().values.tolist() == list(range(2 * len(ends)))
    vertices = torch.arange(count, device=device).repeat_interleave(ends_of.offsets.diff())
    assert torch.equal(ends.flatten()[ends_of.members.long()].long(), vertices)
    return {
        tuple(end): tuple(sorted(third)) for end, third in zip(ends.tolist(), opposites.tolist(), strict=True)
    }


def test_a_closed_surface_has_two_triangles_at_each_edge(device):
    vertices, faces = sphere()
    edges = edges_of(faces, len(vertices), device)
    assert len(vertices) - len(edges) + len(faces) == 2
    for (a, b), thirds in edges.items():
        found = [set(face) - {a, b} for face in faces.tolist() if {a, b} <= set(face)]
        assert [{third} for third in thirds] == sorted(found, key=min)


def test_a_border_has_one_triangle(device):
    _, faces = rectangle(0, 0, 1, 1)
    assert edges_of(faces, 4, device) == {
        (0, 1): (-1, 2),
        (0, 2): (-1, 1),
        (1, 2): (0, 3),
        (1, 3): (-1, 2),
        (2, 3): (-1, 1),
    }


def test_edges_of_three_triangles_and_of_none(device):
    fan = [[0, 1, 2], [0, 1, 3], [1, 0, 4]]
    assert edges_of(fan, 5, device)[0, 1] == (-1, 2)
    # a triangle whose corners coincide has one edge, twice, and no length of another
    assert edges_of([[0, 1, 1]], 2, device) == {(0, 1): (1, 1)}
    assert edges_of(torch.empty(0, 3, dtype=torch.long), 3, device) == {}
