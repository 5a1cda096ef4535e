from dataclasses import replace

import pytest
import torch
from scipy.spatial.transform import Rotation
from subjects import camera, parameters, posed, small_avatar, small_canonical

from samira_warp.avatar import CanonicalHead, conditions_of, geometry_uv
from samira_warp.avatar.avatar import DISPLACEMENT_UNIT
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.kernels.mesh.uv_raster import rasterize_uv
from samira_warp.reference.mesh.binding import bind as bind_in_torch
from samira_warp.reference.mesh.triangle_frames import triangle_frames as frames_in_torch


def matrices(quaternions):
    return torch.from_numpy(
        Rotation.from_quat(quaternions.detach().double().cpu().numpy(), scalar_first=True).as_matrix()
    )


def turned(avatar, *, root=(0.4, -0.7, 0.2), neck=(0.1, 0.5, -0.2)):
    """Parameters that only move the head as a whole."""
    rest = avatar.canonical.rig.rest()
    moved = replace(rest, translation=rest.translation.new_tensor([0.02, -0.01, 0.03]))
    return posed(moved, root=root, neck=neck)


def test_step_zero_is_the_mesh_bound_avatar_to_the_bit(device):
    full, bound = small_avatar(device=device), small_avatar(device=device, residual=False)
    frame = parameters(1, device=device)
    refined, plain = full.move(frame), bound.move(frame)
    assert all(torch.equal(a, b) for a, b in zip(refined.gaussians, plain.gaussians, strict=True))
    assert (refined.residual_position == 0).all()
    assert (refined.residual_rotation == 0).all()
    view = camera(32, device=device)
    assert torch.equal(full.render(frame, view).image, bound.render(frame, view).image)


def test_final_motion_equals_an_independent_one_in_float64(device):
    avatar = small_avatar(perturb=0.5, device=device)
    frame = parameters(2, device=device)
    with torch.no_grad():
        motion = avatar.move(frame)
        head = avatar.canonical.pose(frame)
        displaced = avatar.canonical.displacement(head, in_head=True) / DISPLACEMENT_UNIT
        residual = avatar.motion(displaced.permute(2, 0, 1), avatar.statistics(conditions_of(frame)))
        residual = avatar.canonical.atlas.dilate(residual.permute(1, 2, 0)).double().cpu()
    g = avatar.gaussians
    # grid_sample's rows run downwards and v upwards
    grid = torch.stack([2 * g.uv[:, 0] - 1, 1 - 2 * g.uv[:, 1]], dim=1).double().cpu()[None, None]
    image = residual.permute(2, 0, 1)[None]
    sampled = torch.nn.functional.grid_sample(image, grid, align_corners=False, padding_mode="border")[
        0, :, 0
    ].T
    assert sampled.abs().max() > 0.5
    locals_ = (value.detach().double().cpu() for value in (g.means, g.quaternions, g.scales, g.normals))
    topology = avatar.canonical.topology.to("cpu")
    bound = bind_in_torch(
        *locals_, avatar.binding.to("cpu"), frames_in_torch(head.vertices.double().cpu(), topology)
    )
    turn = Rotation.from_rotvec(torch.pi * torch.tanh(sampled[:, 3:]).numpy())
    expected = torch.from_numpy(turn.as_matrix()) @ matrices(bound.quaternions)
    # positions of 0.1 m in float32 by some 10 roundings of 2^-24 of them; rotations of numbers up to 1, with
    # angles up to pi
    torch.testing.assert_close(
        motion.gaussians.means.double().cpu(),
        bound.means + 0.02 * torch.tanh(sampled[:, :3]),
        atol=2e-7,
        rtol=0,
    )
    torch.testing.assert_close(matrices(motion.gaussians.quaternions), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(motion.gaussians.normals.double().cpu(), bound.normals, atol=2e-6, rtol=0)
    torch.testing.assert_close(motion.gaussians.scales.double().cpu(), bound.scales, atol=0, rtol=2e-6)


def constant_residual(avatar, values):
    """Make the network say the same everywhere: zero weights in its last layer."""
    with torch.no_grad():
        avatar.motion.residual.weight.zero_()
        avatar.motion.residual.bias.copy_(torch.tensor(values))


@pytest.mark.parametrize("frame_of_residual", ["world", "head"])
def test_the_axes_of_the_residual(frame_of_residual, device):
    values = [0.3, -0.2, 0.5, 0.1, 0.05, -0.08]
    avatar = small_avatar(residual_frame=frame_of_residual, device=device)
    constant_residual(avatar, values)
    bound = small_avatar(residual=False, device=device)
    frame = turned(avatar)
    with torch.no_grad():
        moved, plain = avatar.move(frame).gaussians, bound.move(frame).gaussians
        axes = avatar.canonical.pose(frame).head_transform[:3, :3].double().cpu()
    assert (axes - torch.eye(3, dtype=torch.float64)).abs().max() > 0.3
    if frame_of_residual == "world":
        axes = torch.eye(3, dtype=torch.float64)
    limited = torch.tanh(torch.tensor(values, dtype=torch.float64))
    shift = axes @ (0.02 * limited[:3])
    difference = (moved.means - plain.means).double().cpu()
    # both means are near 0.1 m in float32: their difference is good to 2^-24 * 0.2
    torch.testing.assert_close(difference, shift.expand_as(difference), atol=5e-8, rtol=0)
    turn = torch.from_numpy(Rotation.from_rotvec((axes @ (torch.pi * limited[3:])).numpy()).as_matrix())
    torch.testing.assert_close(
        matrices(moved.quaternions), turn @ matrices(plain.quaternions), atol=2e-6, rtol=0
    )


def test_rigid_motion_leaves_no_displacement_in_the_heads_frame(device):
    avatar = small_avatar(device=device)
    canonical = avatar.canonical
    head = canonical.pose(turned(avatar, neck=(0.0, 0.0, 0.0)))
    valid = canonical.atlas.valid
    # 0.1 m through two rotations in float32
    assert canonical.displacement(head, in_head=True).abs().max() < 1e-7
    assert canonical.displacement(head, in_head=False)[valid].norm(dim=-1).min() > 0.01


def test_turning_the_neck_displaces_only_what_is_not_on_the_head(device):
    avatar = small_avatar(device=device)
    canonical = avatar.canonical
    displacement = canonical.displacement(canonical.pose(turned(avatar)), in_head=True)
    on_root = (
        torch.from_numpy(canonical.template.weights[:, 0] > 0)[
            torch.from_numpy(canonical.template.faces).long()
        ]
        .any(dim=1)
        .to(device)
    )
    atlas = canonical.atlas
    face = rasterize_uv(atlas.vt, atlas.ft, size=atlas.size).face.long()
    covered = face >= 0
    of_root = on_root[face.clamp(min=0)] & covered
    assert displacement[covered & ~of_root].abs().max() < 1e-7
    assert displacement[of_root].norm(dim=-1).max() > 0.01


def test_expression_is_in_the_displacement_map(device):
    canonical = small_avatar(device=device).canonical
    rest = canonical.rig.rest()
    expression = rest.expression.clone()
    expression[0] = 1.0
    displacement = canonical.displacement(canonical.pose(replace(rest, expression=expression)), in_head=True)
    expected = canonical.atlas.positions(canonical.rig.shapedirs[:, :, canonical.rig.n_shape].contiguous())
    torch.testing.assert_close(displacement, expected, atol=1e-7, rtol=0)


def test_displacement_frame_decides_what_the_network_sees(device):
    """A head that turns as a whole changes the residual in "world" through D_uv, and in "head" through the
    pose condition alone."""
    for name, moves in (("head", False), ("world", True)):
        avatar = small_avatar(perturb=0.5, displacement_frame=name, device=device)
        rest = avatar.canonical.rig.rest()
        avatar.statistics.translation_scale.zero_()  # the condition is out of the way: only D_uv is left
        moved = replace(rest, translation=rest.translation + 0.05)
        with torch.no_grad():
            difference = avatar.move(moved).residual_position - avatar.move(rest).residual_position
        assert (difference.abs().max() > 1e-5).item() is moves


def test_geometry_uv_of_points_on_faces_is_the_barycentric_uv(device, generator):
    canonical = small_canonical().to(device)
    vertices, faces = canonical.vertices, canonical.topology.faces.long()
    count = len(faces)
    weights = torch.rand(count, 3, generator=generator).to(device)
    weights[: count // 4, 0] = 0.0  # on an edge
    weights[: count // 8, 1] = 0.0  # on a corner
    weights = weights / weights.sum(1, keepdim=True)
    frames = triangle_frames(vertices, canonical.topology)
    points = (weights[:, :, None] * vertices[faces]).sum(1)
    means = torch.einsum("nji,nj->ni", frames.rotation, points - frames.translation) / frames.scale[:, None]
    ids = torch.arange(count, dtype=torch.int32, device=device)
    uv = geometry_uv(means, ids, vertices=vertices, topology=canonical.topology, atlas=canonical.atlas)
    atlas = canonical.atlas
    expected = (weights[:, :, None] * atlas.vt[atlas.ft.long()]).sum(1)
    # slivers magnify the roundings of the points: compare where the face's height is a tenth of its length or
    # more
    edges = (vertices[faces] - vertices[faces].roll(1, dims=1)).norm(dim=2).amax(1)
    sound = 2 * face_areas(vertices, faces) > 0.1 * edges**2
    assert sound.float().mean() > 0.9
    torch.testing.assert_close(uv[sound], expected[sound], atol=2e-5, rtol=0)


def test_geometry_uv_ignores_height_above_the_face(device, generator):
    canonical = small_canonical().to(device)
    ids = torch.arange(len(canonical.topology.faces), dtype=torch.int32, device=device)
    means = torch.zeros(len(ids), 3, device=device)
    options = {"vertices": canonical.vertices, "topology": canonical.topology, "atlas": canonical.atlas}
    raised = means.clone()
    raised[:, 1] = 0.3
    torch.testing.assert_close(
        geometry_uv(raised, ids, **options), geometry_uv(means, ids, **options), atol=1e-5, rtol=0
    )


def test_driving_by_the_same_frame_twice_gives_the_same_bits_and_gradients(device):
    avatar = small_avatar(perturb=0.3, device=device)
    frame = parameters(3, device=device)
    gradients = []
    for _ in range(2):
        avatar.zero_grad()
        rendering = avatar.render(frame, camera(32, device=device))
        (rendering.image * torch.linspace(0, 1, 32, device=device)[:, None]).sum().backward()
        gradients.append([p.grad.clone() for p in avatar.parameters() if p.grad is not None])
    assert all(torch.equal(a, b) for a, b in zip(*gradients, strict=True))


def test_the_static_offset_is_the_subjects_in_every_frame():
    canonical = small_canonical()
    offset = 5e-3 * torch.sin(40.0 * canonical.vertices)
    own = CanonicalHead.build(canonical.template, shape=canonical.shape, static_offset=offset, uv_size=8)
    torch.testing.assert_close(own.vertices, canonical.vertices + offset, atol=1e-8, rtol=0)
    for seed in (2, 3):
        frame = parameters(seed)
        as_dynamic = canonical.pose(replace(frame, dynamic_offset=offset)).vertices
        assert torch.equal(own.pose(frame).vertices, as_dynamic)
        assert (own.pose(frame).vertices - canonical.pose(frame).vertices).norm(dim=1).mean() > 1e-3


def test_conditions_are_the_joints_one_after_the_other():
    frame = parameters(3)
    conditions = conditions_of(frame)
    assert torch.equal(conditions.pose, torch.cat([*frame.rotations]))
    batch = conditions_of(FrameParameters.stack([frame, parameters(4)]))
    assert batch.pose.shape == (2, 15)
    assert all(torch.equal(values[0], alone) for values, alone in zip(batch, conditions, strict=True))
