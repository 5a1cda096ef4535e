from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from samira_warp.data.pixels import load_mask
from samira_warp.data.sequence import open_sequence
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head import FLAME_JOINTS, FrameParameters, Rig
from samira_warp.kernels.mesh.uv_raster import rasterize_uv
from samira_warp.support.errors import UserError

V, S, E = 30, 3, 4
TREES = {
    "FLAME": ((-1, 0, 1, 1, 1), FLAME_JOINTS, "neck"),
    "a chain of seven": ((-1, 0, 1, 2, 3, 4, 5), tuple("abcdefg"), "d"),
    "three limbs": ((-1, 0, 0, 1, 2, 1, 4, 0), ("hip", "a", "b", "a1", "b1", "a2", "b11", "c"), "b1"),
    "a root alone": ((-1,), ("all",), "all"),
}
"""Parents, names and head joint of rigs of some shapes."""


def make_rig(generator, tree="FLAME", dtype=torch.float64):
    """A head of noise: weights on all joints and pose correctives everywhere, so that no term can hide."""
    parents, names, head = TREES[tree]
    joints = len(parents)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    rig = Rig(
        v_template=0.1 * normal(V, 3),
        shapedirs=0.01 * normal(V, 3, S + E),
        n_shape=S,
        posedirs=0.01 * normal(V, 3, 9 * (joints - 1)),
        joint_regressor=torch.softmax(normal(joints, V), dim=1),
        weights=torch.softmax(normal(V, joints), dim=1),
        parents=parents,
        joint_names=names,
        head_joint=head,
    )
    return rig.to(dtype=dtype)


def make_parameters(generator, rig, *, batch=(), offsets=True):
    def normal(*shape):
        return torch.randn(*batch, *shape, generator=generator, dtype=torch.float64)

    parameters = FrameParameters(
        translation=0.7 * normal(3),
        rotations=0.7 * normal(len(rig.parents), 3),
        expression=0.7 * normal(E),
        dynamic_offset=0.01 * normal(V, 3) if offsets else None,
    )
    return parameters.to(dtype=rig.v_template.dtype)


def make_shape(generator, rig):
    return torch.randn(S, generator=generator, dtype=torch.float64).to(rig.v_template.dtype)


def make_offset(generator, rig):
    return (0.01 * torch.randn(V, 3, generator=generator, dtype=torch.float64)).to(rig.v_template.dtype)


def rigid(turn, shift):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, shift
    return matrix


def chain_of_matrices(rig, parameters, shape, static_offset):
    """The head vertex by vertex, by 4 x 4 matrices from joint to joint: vertices (V, 3) and transforms (J, 4,
    4)."""
    model = {
        name: value.double().numpy() if isinstance(value, torch.Tensor) else value
        for name, value in vars(rig).items()
    }
    given = {name: value.double().numpy() for name, value in vars(parameters).items() if value is not None}
    coefficients = np.concatenate([shape.double().numpy(), given["expression"]])
    unposed = model["v_template"] + np.einsum("vci,i->vc", model["shapedirs"], coefficients)
    unposed = unposed + given.get("dynamic_offset", 0)
    unposed = unposed + (0 if static_offset is None else static_offset.double().numpy())
    joints = np.einsum("jv,vc->jc", model["joint_regressor"], unposed)
    turns = [Rotation.from_rotvec(axis_angle).as_matrix() for axis_angle in given["rotations"]]
    feature = np.array([(turn - np.eye(3)).ravel() for turn in turns[1:]]).ravel()
    corrected = unposed + np.einsum("vci,i->vc", model["posedirs"], feature)

    globals_ = [rigid(np.eye(3), given["translation"]) @ rigid(turns[0], joints[0])]
    for joint in range(1, len(turns)):
        parent = rig.parents[joint]
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
@pytest.mark.parametrize("tree", TREES)
def test_matches_a_chain_of_matrices(device, generator, tree, offsets, dtype):
    rig = make_rig(generator, tree, dtype)
    shape, parameters = make_shape(generator, rig), make_parameters(generator, rig, offsets=offsets)
    static = make_offset(generator, rig) if offsets else None
    posed = rig.to(device).pose(
        parameters.to(device), shape.to(device), None if static is None else static.to(device)
    )
    vertices, transforms = chain_of_matrices(rig, parameters, shape, static)
    # Coordinates up to 2 and a chain of three rotations, of seven at most, in either precision's rounding.
    tolerance = 1e-13 if dtype == torch.float64 else 4e-6
    assert np.abs(posed.vertices.double().cpu().numpy() - vertices).max() < tolerance
    assert np.abs(posed.joint_transforms.double().cpu().numpy() - transforms).max() < tolerance


@pytest.mark.parametrize("batch", [(1,), (4,), (2, 3), (0,)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("tree", TREES)
def test_a_batch_is_its_frames_one_by_one(device, generator, tree, dtype, batch):
    rig = make_rig(generator, tree, dtype).to(device)
    shape = make_shape(generator, rig).to(device)
    static = make_offset(generator, rig).to(device)
    parameters = make_parameters(generator, rig, batch=batch).to(device)
    together = rig.pose(parameters, shape, static)
    assert together.vertices.shape == (*batch, V, 3)
    assert together.joint_transforms.shape == (*batch, len(rig.parents), 4, 4)
    head_frames = together.in_head_frame()
    # sums of a few dozen products of order 1 in another order; 1e-15 and 6e-7 were seen
    tolerance = 1e-14 if dtype == torch.float64 else 4e-6
    for place in np.ndindex(batch):
        frame = FrameParameters(*(value[place] for value in vars(parameters).values()))
        alone = rig.pose(frame, shape, static)
        for found, expected in (
            (together.vertices[place], alone.vertices),
            (together.joint_transforms[place], alone.joint_transforms),
            (together.head_transform[place], alone.head_transform),
            (head_frames[place], alone.in_head_frame()),
        ):
            torch.testing.assert_close(found, expected, rtol=0, atol=tolerance)


def test_rest_is_the_template_with_its_shape(generator):
    rig = make_rig(generator)
    shape = make_shape(generator, rig)
    posed = rig.pose(rig.rest(), shape)
    assert torch.allclose(
        posed.vertices, rig.v_template + rig.shapedirs[:, :, :S] @ shape, rtol=0, atol=1e-14
    )
    assert torch.allclose(
        posed.joint_transforms, torch.eye(4, dtype=torch.float64).expand(5, 4, 4), rtol=0, atol=1e-14
    )
    assert (rig.n_shape, rig.n_expression, rig.pose_size) == (S, E, 15)


def test_global_motion_is_rigid_about_the_root(generator):
    rig = make_rig(generator)
    shape, moved, static = (
        make_shape(generator, rig),
        make_parameters(generator, rig),
        make_offset(generator, rig),
    )
    still = turned(replace(moved, translation=torch.zeros(3).double()), rig, root=0.0)
    before, after = rig.pose(still, shape, static), rig.pose(moved, shape, static)
    unposed = (
        rig.v_template + rig.shapedirs @ torch.cat([shape, moved.expression]) + static + moved.dynamic_offset
    )
    root = rig.joint_regressor[0] @ unposed
    turn = torch.from_numpy(Rotation.from_rotvec(moved.rotations[0].numpy()).as_matrix())
    expected = (before.vertices - root) @ turn.T + root + moved.translation
    assert torch.allclose(after.vertices, expected, rtol=0, atol=1e-13)
    assert torch.allclose(after.in_head_frame(), before.in_head_frame(), rtol=0, atol=1e-13)


def turned(parameters, rig, **values):
    """The parameters with the rotations of some joints, by name, set to a number."""
    rotations = parameters.rotations.clone()
    for name, value in values.items():
        rotations[..., rig.joint(name), :] = value
    return replace(parameters, rotations=rotations)


def test_the_head_frame_undoes_the_neck_but_not_the_jaw(generator):
    """Without correctives, what hangs on the neck alone is back at rest; what hangs on the jaw is turned by
    the jaw alone."""
    rig = make_rig(generator)
    shape, parameters = make_shape(generator, rig), make_parameters(generator, rig)
    weights = torch.zeros(V, 5, dtype=torch.float64)
    weights[:20, 1], weights[20:, 2] = 1, 1
    rig = replace(rig, weights=weights, posedirs=torch.zeros_like(rig.posedirs))
    still = replace(parameters, translation=torch.zeros(3).double())
    rest = rig.pose(turned(still, rig, root=0.0, neck=0.0, jaw=0.0), shape).vertices
    jaw_only = rig.pose(turned(still, rig, root=0.0, neck=0.0), shape).vertices
    found = rig.pose(parameters, shape).in_head_frame()
    assert torch.allclose(found[:20], rest[:20], rtol=0, atol=1e-13)
    assert torch.allclose(found[20:], jaw_only[20:], rtol=0, atol=1e-13)
    assert not torch.allclose(found[20:], rest[20:], rtol=0, atol=1e-3)


@pytest.mark.parametrize("tree", TREES)
def test_the_head_frame_is_the_named_joints(generator, tree):
    rig = make_rig(generator, tree)
    posed = rig.pose(make_parameters(generator, rig), make_shape(generator, rig))
    transform = posed.joint_transforms[rig.joint_names.index(TREES[tree][2])]
    back = torch.linalg.inv(transform)
    assert torch.equal(posed.head_transform, transform)
    torch.testing.assert_close(
        posed.in_head_frame(), posed.vertices @ back[:3, :3].T + back[:3, 3], rtol=0, atol=1e-13
    )


def test_offsets_are_part_of_the_rest_shape(generator):
    """Joints move with them: the same as another template."""
    rig = make_rig(generator)
    shape, parameters, static = (
        make_shape(generator, rig),
        make_parameters(generator, rig),
        make_offset(generator, rig),
    )
    other = replace(rig, v_template=rig.v_template + static + parameters.dynamic_offset)
    expected = other.pose(replace(parameters, dynamic_offset=None), shape)
    found = rig.pose(parameters, shape, static)
    assert torch.allclose(found.vertices, expected.vertices, rtol=0, atol=1e-14)
    assert torch.allclose(found.joint_transforms, expected.joint_transforms, rtol=0, atol=1e-14)


@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize("pose", ["random", "zero"])
@pytest.mark.parametrize("tree", ["FLAME", "a chain of seven"])
def test_gradients_by_finite_differences(generator, tree, pose, batch):
    rig = make_rig(generator, tree)
    shape, static = make_shape(generator, rig), make_offset(generator, rig)
    parameters = make_parameters(generator, rig, batch=batch)
    moving = [parameters.translation, parameters.rotations, parameters.expression]
    values = [value * (pose == "random") for value in moving] + [parameters.dynamic_offset]
    leaves = [tensor.clone().requires_grad_() for tensor in (shape, static, *values)]

    def posed(shape, static, *values):
        head = rig.pose(FrameParameters(*values), shape, static)
        return head.vertices, head.joint_transforms, head.in_head_frame()

    # Random projections of the results: 90 rows of a Jacobian add nothing.
    assert torch.autograd.gradcheck(posed, leaves, fast_mode=True)
    grads = torch.autograd.grad(posed(*leaves)[0].square().sum(), leaves)
    assert all(bool(grad.isfinite().all()) and bool(grad.any()) for grad in grads)


def test_the_gradient_of_a_batch_is_its_frames(generator):
    """Rows of a batch do not meet: what a row's head asks for is that row's alone."""
    rig = make_rig(generator)
    shape, batch = make_shape(generator, rig), make_parameters(generator, rig, batch=(3,))
    leaf = batch.rotations.clone().requires_grad_()
    target = torch.randn(3, V, 3, generator=generator, dtype=torch.float64)
    found = rig.pose(replace(batch, rotations=leaf), shape).vertices
    (together,) = torch.autograd.grad((found * target).sum(), leaf)
    for row in range(3):
        own = batch.rotations[row].clone().requires_grad_()
        alone = rig.pose(replace(batch[row], rotations=own), shape).vertices
        (expected,) = torch.autograd.grad((alone * target[row]).sum(), own)
        torch.testing.assert_close(together[row], expected, rtol=0, atol=1e-13)


def test_joints_are_known_by_name(generator):
    rig = make_rig(generator, "three limbs")
    assert [rig.joint(name) for name in rig.joint_names] == list(range(8))
    with pytest.raises(UserError, match=r"joint: expected one of hip, a, b, a1, .* c, found 'jaw'"):
        rig.joint("jaw")


def test_frames_are_stacked_and_taken(generator):
    rig = make_rig(generator)
    frames = [make_parameters(generator, rig, offsets=row != 1) for row in range(3)]
    batch = FrameParameters.stack(frames)
    assert len(batch) == 3
    assert batch.batch_shape == (3,)
    for name in ("translation", "rotations", "expression"):
        stacked = getattr(batch, name)
        assert all(torch.equal(stacked[row], getattr(frame, name)) for row, frame in enumerate(frames))
        assert getattr(batch[1], name).data_ptr() == stacked[1].data_ptr()  # a view
    assert torch.equal(batch[0].dynamic_offset, frames[0].dynamic_offset)
    assert not batch[1].dynamic_offset.any()
    assert torch.equal(batch[torch.tensor([2, 0])].rotations[0], frames[2].rotations)
    assert batch[1:].expression.shape == (2, E)
    assert [frame.rotations.shape for frame in batch] == [(5, 3)] * 3
    bare = FrameParameters.stack([replace(frame, dynamic_offset=None) for frame in frames])
    assert bare.dynamic_offset is None
    assert bare[0].dynamic_offset is None
    assert batch.to(dtype=torch.float32).dynamic_offset.dtype == torch.float32


def test_one_frame_has_no_rows(generator):
    frame = make_parameters(generator, make_rig(generator))
    with pytest.raises(TypeError, match="one frame"):
        len(frame)
    with pytest.raises(TypeError, match="one frame"):
        frame[0]


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


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("name", ["translation", "rotations", "expression", "dynamic_offset"])
def test_a_wrong_parameter_is_a_users_error(generator, name, batch):
    rig = make_rig(generator)
    shape, parameters = make_shape(generator, rig), make_parameters(generator, rig, batch=batch)
    value = getattr(parameters, name)
    for wrong in (value[..., :-1], value.float(), value[None]):
        # the translation says how many frames there are: with another number the next tensor does not fit
        with pytest.raises(UserError, match="translation|rotations" if name == "translation" else name):
            rig.pose(replace(parameters, **{name: wrong}), shape)


def test_a_wrong_subject_is_a_users_error(generator):
    rig = make_rig(generator)
    shape, parameters, static = (
        make_shape(generator, rig),
        make_parameters(generator, rig),
        make_offset(generator, rig),
    )
    for wrong in (shape[:-1], shape.float()):
        with pytest.raises(UserError, match=r"^shape"):
            rig.pose(parameters, wrong)
    for wrong in (static[:-1], static.float()):
        with pytest.raises(UserError, match="static_offset"):
            rig.pose(parameters, shape, wrong)


@pytest.mark.subject
def test_the_real_heads_silhouette(subject):
    """Vertices through the camera cover what the renderer's mattes cover, above the line where the neck fades
    out."""
    sequence = open_sequence(subject)
    rig = Rig.build(sequence.template)
    faces = torch.from_numpy(sequence.template.faces)
    for index in (sequence.test[0], sequence.test[50], sequence.train[150]):
        frame = sequence.frames[index]
        size = frame.camera.width
        assert size == frame.camera.height
        vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
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
