from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from samira_warp.data.pixels import load_mask
from samira_warp.data.sequence import open_sequence
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.model import FrameParameters, HeadModel
from samira_warp.kernels.mesh.uv_raster import rasterize_uv
from samira_warp.support.errors import UserError

V, S, E = 30, 3, 4
PARENTS = (-1, 0, 1, 1, 1)
SIZES = {"translation": 3, "rotation": 3, "neck": 3, "jaw": 3, "eyes": 6, "expression": E}


def make_model(generator, dtype=torch.float64):
    """A head of noise: weights on all joints and pose correctives everywhere, so that no term can hide."""

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    model = HeadModel(
        v_template=0.1 * normal(V, 3),
        shapedirs=0.01 * normal(V, 3, S + E),
        n_shape=S,
        posedirs=0.01 * normal(V, 3, 36),
        joint_regressor=torch.softmax(normal(5, V), dim=1),
        weights=torch.softmax(normal(V, 5), dim=1),
        parents=PARENTS,
    )
    return model.to(dtype=dtype)


def make_parameters(generator, offsets=True, dtype=torch.float64):
    values = {
        name: 0.7 * torch.randn(size, generator=generator, dtype=torch.float64)
        for name, size in SIZES.items()
    }
    if offsets:
        values |= {
            name: 0.01 * torch.randn(V, 3, generator=generator, dtype=torch.float64)
            for name in ("static_offset", "dynamic_offset")
        }
    return FrameParameters(**values).to(dtype=dtype)


def make_shape(generator, dtype=torch.float64):
    return torch.randn(S, generator=generator, dtype=torch.float64).to(dtype)


def rigid(turn, shift):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, shift
    return matrix


def chain_of_matrices(model, parameters, shape):
    """The head vertex by vertex, by 4 x 4 matrices from joint to joint: vertices (V, 3) and transforms (5, 4,
    4)."""
    model = {
        name: value.double().numpy() if isinstance(value, torch.Tensor) else value
        for name, value in vars(model).items()
    }
    given = {name: value.double().numpy() for name, value in vars(parameters).items() if value is not None}
    coefficients = np.concatenate([shape.double().numpy(), given["expression"]])
    unposed = model["v_template"] + np.einsum("vci,i->vc", model["shapedirs"], coefficients)
    unposed = unposed + given.get("static_offset", 0) + given.get("dynamic_offset", 0)
    joints = np.einsum("jv,vc->jc", model["joint_regressor"], unposed)
    axis_angles = [given["rotation"], given["neck"], given["jaw"], given["eyes"][:3], given["eyes"][3:]]
    turns = [Rotation.from_rotvec(axis_angle).as_matrix() for axis_angle in axis_angles]
    feature = np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    corrected = unposed + np.einsum("vci,i->vc", model["posedirs"], feature)

    globals_ = [rigid(np.eye(3), given["translation"]) @ rigid(turns[0], joints[0])]
    for joint in range(1, 5):
        parent = PARENTS[joint]
        globals_.append(globals_[parent] @ rigid(turns[joint], joints[joint] - joints[parent]))
    transforms = [
        whole @ rigid(np.eye(3), -location) for whole, location in zip(globals_, joints, strict=True)
    ]
    vertices = [
        (
            sum(weight * transform for weight, transform in zip(weights, transforms, strict=True))
            @ [*point, 1]
        )[:3]
        for point, weights in zip(corrected, model["weights"], strict=True)
    ]
    return np.array(vertices), np.array(transforms)


@pytest.mark.parametrize("offsets", [True, False])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_matches_a_chain_of_matrices(device, generator, offsets, dtype):
    model, shape = make_model(generator, dtype), make_shape(generator, dtype)
    parameters = make_parameters(generator, offsets, dtype)
    posed = model.to(device).vertices(parameters.to(device), shape.to(device))
    vertices, transforms = chain_of_matrices(model, parameters, shape)
    # Coordinates up to 2 and a chain of three rotations, in either precision's rounding.
    tolerance = 1e-13 if dtype == torch.float64 else 2e-6
    assert np.abs(posed.vertices.double().cpu().numpy() - vertices).max() < tolerance
    assert np.abs(posed.joint_transforms.double().cpu().numpy() - transforms).max() < tolerance


def test_rest_is_the_template_with_its_shape(generator):
    model, shape = make_model(generator), make_shape(generator)
    posed = model.vertices(model.rest(), shape)
    assert torch.allclose(
        posed.vertices, model.v_template + model.shapedirs[:, :, :S] @ shape, rtol=0, atol=1e-14
    )
    assert torch.allclose(
        posed.joint_transforms, torch.eye(4, dtype=torch.float64).expand(5, 4, 4), rtol=0, atol=1e-14
    )
    assert (model.n_shape, model.n_expression) == (S, E)


def test_global_motion_is_rigid_about_the_root(generator):
    model, shape, moved = make_model(generator), make_shape(generator), make_parameters(generator)
    still = replace(moved, rotation=torch.zeros(3).double(), translation=torch.zeros(3).double())
    before, after = model.vertices(still, shape), model.vertices(moved, shape)
    unposed = (
        model.v_template
        + model.shapedirs @ torch.cat([shape, moved.expression])
        + moved.static_offset
        + moved.dynamic_offset
    )
    root = model.joint_regressor[0] @ unposed
    turn = torch.from_numpy(Rotation.from_rotvec(moved.rotation.numpy()).as_matrix())
    expected = (before.vertices - root) @ turn.T + root + moved.translation
    assert torch.allclose(after.vertices, expected, rtol=0, atol=1e-13)
    assert torch.allclose(after.in_head_frame(), before.in_head_frame(), rtol=0, atol=1e-13)


def test_the_head_frame_undoes_the_neck_but_not_the_jaw(generator):
    """Without correctives, what hangs on the neck alone is back at rest; what hangs on the jaw is turned by
    the jaw alone."""
    model, shape, parameters = make_model(generator), make_shape(generator), make_parameters(generator)
    weights = torch.zeros(V, 5, dtype=torch.float64)
    weights[:20, 1], weights[20:, 2] = 1, 1
    model = replace(model, weights=weights, posedirs=torch.zeros_like(model.posedirs))
    zero = torch.zeros(3).double()
    rest = model.vertices(
        replace(parameters, rotation=zero, translation=zero, neck=zero, jaw=zero), shape
    ).vertices
    jaw_only = model.vertices(replace(parameters, rotation=zero, translation=zero, neck=zero), shape).vertices
    found = model.vertices(parameters, shape).in_head_frame()
    assert torch.allclose(found[:20], rest[:20], rtol=0, atol=1e-13)
    assert torch.allclose(found[20:], jaw_only[20:], rtol=0, atol=1e-13)
    assert not torch.allclose(found[20:], rest[20:], rtol=0, atol=1e-3)


def test_offsets_are_part_of_the_rest_shape(generator):
    """Joints move with them: the same as another template."""
    model, shape, parameters = make_model(generator), make_shape(generator), make_parameters(generator)
    other = replace(model, v_template=model.v_template + parameters.static_offset + parameters.dynamic_offset)
    expected = other.vertices(replace(parameters, static_offset=None, dynamic_offset=None), shape)
    found = model.vertices(parameters, shape)
    assert torch.allclose(found.vertices, expected.vertices, rtol=0, atol=1e-14)
    assert torch.allclose(found.joint_transforms, expected.joint_transforms, rtol=0, atol=1e-14)


@pytest.mark.parametrize("pose", ["random", "zero"])
def test_gradients_by_finite_differences(generator, pose):
    model, shape = make_model(generator), make_shape(generator)
    parameters = make_parameters(generator)
    values = [
        value * (pose == "random") if value.shape != (V, 3) else value for value in vars(parameters).values()
    ]
    leaves = [tensor.clone().requires_grad_() for tensor in (shape, *values)]
    # Random projections of the results: 90 rows of a Jacobian add nothing.
    assert torch.autograd.gradcheck(
        lambda shape, *values: tuple(model.vertices(FrameParameters(*values), shape)), leaves, fast_mode=True
    )
    grads = torch.autograd.grad(
        model.vertices(FrameParameters(*leaves[1:]), leaves[0]).vertices.square().sum(), leaves
    )
    assert all(bool(grad.isfinite().all()) and bool(grad.any()) for grad in grads)


def test_rotations_are_scipys(generator):
    axis = torch.nn.functional.normalize(torch.randn(60, 3, generator=generator, dtype=torch.float64), dim=1)
    angles = torch.tensor(
        [0, 1e-12, 1e-6, 9.99e-3, 1e-2, 1.001e-2, 0.5, 3.0, np.pi, 6.0], dtype=torch.float64
    ).repeat(6)
    vectors = axis * angles[:, None]
    expected = torch.from_numpy(Rotation.from_rotvec(vectors.numpy()).as_matrix())
    # Below 0.01 rad the next terms of the series are 0.01^6 / 5040 and less: 2e-16.
    assert torch.allclose(axis_angle_to_matrix(vectors), expected, rtol=0, atol=1e-14)
    assert torch.allclose(axis_angle_to_matrix(vectors.float()).double(), expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("length", [0.0, 1e-5, 0.02, 3.0])
def test_gradient_of_a_rotation(length):
    vector = torch.tensor([[0.6, 0.0, -0.8]], dtype=torch.float64) * length
    assert torch.autograd.gradcheck(axis_angle_to_matrix, vector.requires_grad_())
    assert torch.autograd.gradgradcheck(axis_angle_to_matrix, vector)


def test_the_gradient_at_zero_is_the_generators():
    """dR/dw at zero is the cross-product matrix, in float32 as well."""
    vector = torch.zeros(3, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(axis_angle_to_matrix, vector)
    levi_civita = -torch.linalg.cross(
        torch.eye(3)[:, None].expand(3, 3, 3), torch.eye(3)[None].expand(3, 3, 3)
    )
    assert torch.equal(jacobian, levi_civita)


@pytest.mark.parametrize("name", [*SIZES, "static_offset", "dynamic_offset"])
def test_a_wrong_parameter_is_a_users_error(generator, name):
    model, shape, parameters = make_model(generator), make_shape(generator), make_parameters(generator)
    for wrong in (getattr(parameters, name)[:-1], getattr(parameters, name).float()):
        with pytest.raises(UserError, match=name):
            model.vertices(replace(parameters, **{name: wrong}), shape)
    with pytest.raises(UserError, match="shape"):
        model.vertices(parameters, shape[:-1])


@pytest.mark.subject
def test_the_real_heads_silhouette(subject):
    """Vertices through the camera cover what the renderer's mattes cover, above the line where the neck fades
    out."""
    sequence = open_sequence(subject)
    model = HeadModel.build(sequence.template)
    faces = torch.from_numpy(sequence.template.faces)
    for index in (sequence.test[0], sequence.test[50], sequence.train[150]):
        frame = sequence.frames[index]
        size = frame.camera.width
        assert size == frame.camera.height
        vertices = model.vertices(frame.parameters, sequence.shape).vertices
        mask = load_mask(frame, width=size, height=size) > 0.5
        covered = silhouette(vertices, faces, frame.camera)
        neck = torch.from_numpy(sequence.template.masks["neck"]).long()
        line = int(project(vertices[neck], frame.camera)[:, 1].median())
        assert size // 2 < line < size
        inside, either = (mask & covered)[:line].sum(), (mask | covered)[:line].sum()
        assert inside > 0.95 * either, f"{frame.name}: {inside / either:.4f}"


def project(vertices, camera):
    """(V, 2) pixels, written anew."""
    x, y, z = (vertices @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).unbind(dim=1)
    assert bool((z > 0).all())
    return torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], dim=1)


def silhouette(vertices, faces, camera):
    """(H, W) bool: pixels whose centre a triangle covers. The image is square, and its rows run against v."""
    pixels = project(vertices, camera) / camera.width
    return (
        rasterize_uv(torch.stack([pixels[:, 0], 1 - pixels[:, 1]], dim=1), faces, size=camera.width).face >= 0
    )
