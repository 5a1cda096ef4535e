"""Every tensor that a public operator takes, given with a wrong shape, dtype and device: refused by name."""

import dataclasses
import inspect

import pytest
import torch
from kernels.scenes import cloud, turned_camera

from samira_warp import kernels
from samira_warp.kernels import FaceBinding, GatherTable, MeshTopology, RayMesh
from samira_warp.support.errors import UserError
from samira_warp.surface import Surface

WIDTH, HEIGHT = 20, 12


def gaussians():
    names = ("means", "quaternions", "scales", "opacities", "features")
    return dict(zip(names, cloud(torch.Generator().manual_seed(0), "cpu", count=5), strict=True))


def without(arguments, *names):
    return {name: value for name, value in arguments.items() if name not in names}


def projected():
    arguments = {**without(gaussians(), "features"), "camera": turned_camera("cpu", WIDTH, HEIGHT)}
    return kernels.project(**arguments)


def blend_inputs():
    projection = projected()
    bins = kernels.bin_tiles(projection, width=WIDTH, height=HEIGHT)
    return {
        "means2d": projection.means2d,
        "conics": projection.conics,
        "opacities": projection.opacities,
        "features": torch.ones(5, 3),
        "bins": bins,
    }


def mesh():
    """A tetrahedron."""
    vertices = torch.cat([torch.zeros(1, 3), torch.eye(3)])
    return vertices, MeshTopology.build(torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), 4)


def bind_inputs():
    vertices, topology = mesh()
    return {
        **{name: torch.ones(6, size) for name, size in INTO_FRAMES.items()},
        "binding": FaceBinding.build(torch.tensor([0, 1, 2, 3, 0, 1]), 4),
        "frames": kernels.triangle_frames(vertices, topology),
    }


INTO_FRAMES = {"means": 3, "quaternions": 4, "scales": 3, "normals": 3}


def raster_inputs():
    """Two frames of a tetrahedron."""
    vertices, topology = mesh()
    points = (9 * vertices + 2.0).expand(2, 4, 3).contiguous()
    return points, kernels.rasterize_mesh(points, topology, width=WIDTH, height=HEIGHT), topology


CUBEMAP = torch.ones(6, 4, 4, 3)
DIRECTIONS = torch.ones(5, 3)

CASES = {
    "antialias": lambda: {
        "image": torch.rand(2, HEIGHT, WIDTH, 3),
        **dict(zip(("points", "raster", "topology"), raster_inputs(), strict=True)),
    },
    "bilinear_table": lambda: {"uv": torch.rand(5, 2), "width": 4, "height": 4},
    "bin_tiles": lambda: {
        "projection": projected(),
        "width": WIDTH,
        "height": HEIGHT,
    },
    "bind": bind_inputs,
    "blend": lambda: {**blend_inputs(), "width": WIDTH, "height": HEIGHT},
    "closest_barycentrics": lambda: {"points": torch.ones(5, 3), "triangles": torch.rand(5, 3, 3)},
    "gather": lambda: {
        "values": torch.ones(4, 2),
        "table": GatherTable.build(torch.tensor([[0, 1], [2, 3]]), torch.ones(2, 2), sources=4),
    },
    "interpolate": lambda: {
        "attributes": torch.rand(4, 3),
        **dict(zip(("raster", "topology"), raster_inputs()[1:], strict=True)),
    },
    "irradiance": lambda: {"radiance": CUBEMAP, "size": 4},
    "mesh_normals": lambda: dict(zip(("vertices", "topology"), raster_inputs()[::2], strict=True)),
    "prefilter": lambda: {"base": CUBEMAP, "ladder": ((0.5, 4),)},
    "project": lambda: {**without(gaussians(), "features"), "camera": turned_camera("cpu", WIDTH, HEIGHT)},
    "rasterize": lambda: {**gaussians(), "camera": turned_camera("cpu", WIDTH, HEIGHT)},
    "rasterize_mesh": lambda: {
        **dict(zip(("points", "topology"), raster_inputs()[::2], strict=True)),
        "width": WIDTH,
        "height": HEIGHT,
    },
    "rasterize_uv": lambda: {"vt": torch.rand(4, 2), "ft": torch.tensor([[0, 1, 2], [1, 2, 3]]), "size": 8},
    "sample_cubemap": lambda: {"cubemap": CUBEMAP, "directions": DIRECTIONS},
    "sample_mips": lambda: {"mips": (CUBEMAP, CUBEMAP), "directions": DIRECTIONS, "levels": torch.ones(5)},
    "shade_gbuffer": lambda: {
        "surface": Surface.of(
            albedo=DIRECTIONS, normal=DIRECTIONS, roughness=torch.ones(5, 1), specular=torch.ones(5, 1)
        ),
        "view": DIRECTIONS,
        "alpha": torch.ones(5, 1),
        "irradiance": CUBEMAP,
        "mips": (CUBEMAP, CUBEMAP),
        "brdf": torch.ones(4, 4, 2),
        "background": torch.ones(5, 3),
    },
    "triangle_frames": lambda: dict(zip(("vertices", "topology"), mesh(), strict=True)),
    "unblocked": lambda: {
        "points": torch.ones(5, 3),
        "normals": torch.ones(5, 3),
        "mesh": RayMesh(torch.eye(3), torch.tensor([[0, 1, 2]])),
        "directions": torch.ones(32, 3),
    },
    "visible": lambda: {
        "points": torch.ones(5, 3),
        "mesh": RayMesh(torch.eye(3), torch.tensor([[0, 1, 2]])),
        "origin": torch.zeros(3),
    },
    "FaceBinding.build": lambda: {"faces": torch.tensor([0, 1]), "face_count": 2},
    "GatherTable.build": lambda: {
        "indices": torch.tensor([[0, 1], [2, 3]]),
        "weights": torch.ones(2, 2),
        "sources": 4,
    },
    "MeshTopology.build": lambda: {"faces": torch.tensor([[0, 1, 2]]), "vertex_count": 3},
}
"""Arguments that pass, by operator."""

LEADING = {
    "antialias": ("raster.face", "topology.faces"),
    "bilinear_table": ("uv",),
    "bin_tiles": ("projection.means2d",),
    "blend": ("means2d", "bins.records"),
    "closest_barycentrics": ("points",),
    "interpolate": ("raster.face", "topology.faces"),
    "mesh_normals": ("vertices", "topology.faces"),
    "project": ("means",),
    "rasterize": ("means",),
    "rasterize_mesh": ("points", "topology.faces"),
    "rasterize_uv": ("vt", "ft"),
    "sample_cubemap": ("directions",),
    "shade_gbuffer": ("surface.albedo",),
    "unblocked": ("points",),
    "visible": ("points",),
    "sample_mips": ("directions",),
    "FaceBinding.build": ("faces",),
    "GatherTable.build": ("indices",),
    "MeshTopology.build": ("faces",),
    "bind": ("binding.faces",),
    "gather": ("table.indices", "table.transpose_rows"),
    "triangle_frames": ("topology.faces",),
}
"""Tensors whose first size is theirs to choose: the others are measured against them."""


def operator(name):
    found = kernels
    for part in name.split("."):
        found = getattr(found, part)
    return found


def tensors(value, name=""):
    """{name: tensor} of everything in an argument, in the names that messages use."""
    if isinstance(value, torch.Tensor):
        return {name: value}
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        parts = {f"{name}[{index}]": part for index, part in enumerate(value)}
    else:
        fields = getattr(value, "_fields", None) or [
            field.name for field in (dataclasses.fields(value) if dataclasses.is_dataclass(value) else ())
        ]
        parts = {f"{name}.{field}": getattr(value, field) for field in fields}
    return {
        key: tensor for part_name, part in parts.items() for key, tensor in tensors(part, part_name).items()
    }


def replaced(value, name, tensor):
    """The argument with the tensor of that name, relative to the argument, changed."""
    if not name:
        return tensor
    if name.startswith("["):
        index, _, rest = name[1:].partition("]")
        return tuple(
            replaced(part, rest, tensor) if place == int(index) else part for place, part in enumerate(value)
        )
    field, rest = name[1:], ""
    for mark in (".", "["):
        if mark in field:
            field, rest = field[: field.index(mark)], field[field.index(mark) :]
    part = {field: replaced(getattr(value, field), rest, tensor)}
    return value._replace(**part) if hasattr(value, "_replace") else dataclasses.replace(value, **part)


def call_with(name, leaf, tensor):
    """Call an operator with one tensor changed; a table that checks itself may refuse it before."""
    arguments = CASES[name]()
    argument = leaf.split(".")[0].split("[")[0]
    arguments[argument] = replaced(arguments[argument], leaf[len(argument) :], tensor)
    operator(name)(**arguments)


def all_leaves():
    for name, arguments in CASES.items():
        for argument, value in arguments().items():
            for leaf, tensor in tensors(value, argument).items():
                yield pytest.param(name, leaf, tensor, id=f"{name}-{leaf}")


LEAVES = list(all_leaves())


def test_every_public_operator_is_here():
    functions = {name for name in kernels.__all__ if inspect.isfunction(getattr(kernels, name))}
    builders = {f"{name}.build" for name in kernels.__all__ if hasattr(getattr(kernels, name), "build")}
    assert set(CASES) == functions | builders
    for name, arguments in CASES.items():
        operator(name)(**arguments())


def refused(name, leaf, tensor):
    """The name that the refusal gives."""
    with pytest.raises(UserError) as caught:
        call_with(name, leaf, tensor)
    return caught.value.subject


@pytest.mark.parametrize(("name", "leaf", "tensor"), LEAVES)
def test_a_wrong_shape_is_refused_by_name(name, leaf, tensor):
    assert leaf.endswith(refused(name, leaf, tensor[None]))
    assert leaf.endswith(refused(name, leaf, tensor.flatten()[0]))


@pytest.mark.parametrize(
    ("name", "leaf", "tensor"),
    [case for case in LEAVES if case.values[1] not in LEADING.get(case.values[0], ())],
)
def test_a_size_that_does_not_fit_the_others_is_refused_by_name(name, leaf, tensor):
    assert leaf.endswith(refused(name, leaf, tensor[1:]))


@pytest.mark.parametrize(("name", "leaf", "tensor"), LEAVES)
def test_a_wrong_dtype_is_refused_by_name(name, leaf, tensor):
    wrong = torch.float32 if not tensor.is_floating_point() else torch.int64
    assert leaf.endswith(refused(name, leaf, tensor.to(wrong)))


@pytest.mark.parametrize(("name", "leaf", "tensor"), LEAVES)
def test_another_device_is_refused_by_name(name, leaf, tensor):
    assert leaf.endswith(refused(name, leaf, tensor.to("meta")))


@pytest.mark.parametrize(("name", "leaf", "tensor"), LEAVES)
def test_what_is_no_tensor_is_refused_by_name(name, leaf, tensor):
    assert leaf.endswith(refused(name, leaf, tensor.tolist()))


@pytest.mark.parametrize(
    ("name", "leaf"),
    [
        ("rasterize_uv", "ft"),
        ("FaceBinding.build", "faces"),
        ("GatherTable.build", "indices"),
        ("MeshTopology.build", "faces"),
    ],
)
@pytest.mark.parametrize("wrong", [-1, 4])
def test_an_id_of_nothing_is_refused_by_name(name, leaf, wrong):
    ids = CASES[name]()[leaf].clone()
    ids.view(-1)[-1] = wrong
    assert refused(name, leaf, ids) == leaf


def test_bins_of_another_image_are_refused():
    with pytest.raises(UserError, match=r"^bins: expected tiles of an image of 40 x 12 pixels, found 2 x 1"):
        kernels.blend(**blend_inputs(), width=40, height=HEIGHT)
