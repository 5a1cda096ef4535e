import math
from dataclasses import replace

import pytest
import torch
from subjects import parameters, posed, small_canonical

from samira_warp.avatar import conditions_of
from samira_warp.data import PixelCache, open_sequence
from samira_warp.geometry.mesh import face_areas, vertex_normals
from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.nets import ConditionStatistics
from samira_warp.train import initialize
from samira_warp.train.initialize import (
    choose_reference,
    condition_statistics,
    initial_albedo,
    initial_gaussians,
)
from samira_warp.train.tracking import TrackedParameters

COUNT = 3000


def placed(*, count=COUNT, smooth=True, seed=0, albedo=None, device="cpu"):
    canonical = small_canonical().to(device)
    size = canonical.atlas.size
    albedo = torch.full((size, size, 3), 0.3, device=device) if albedo is None else albedo
    generator = torch.Generator().manual_seed(seed)
    return canonical, initial_gaussians(
        canonical, count=count, opacity=0.5, albedo=albedo, smooth_normals=smooth, generator=generator
    )


def factors(canonical):
    """(F,) three for faces of eye regions and lips, eight for irises, a half for the rest of eyeballs and one
    for all else: by two corners of three."""
    groups = canonical.template.masks
    result = torch.ones(len(canonical.topology.faces))
    for names, factor in (
        (("left_eye_region", "right_eye_region", "lips"), 3.0),
        (("left_eyeball", "right_eyeball"), 0.5),
    ):
        inside = torch.zeros(len(canonical.vertices), dtype=torch.long)
        for name in names:
            inside[torch.from_numpy(groups[name]).long()] = 1
        result[inside[canonical.topology.faces.cpu().long()].sum(1) >= 2] = factor
    vertices, iris = canonical.vertices.cpu(), torch.zeros(len(canonical.vertices), dtype=torch.long)
    for name in ("left_eyeball", "right_eyeball"):
        for vertex in groups[name].tolist():
            ball = vertices[torch.from_numpy(groups[name]).long()]
            way = vertices[vertex] - (ball.amin(0) + ball.amax(0)) / 2
            iris[vertex] = int(math.degrees(math.acos(way[2] / way.norm())) < 40.0)
    result[iris[canonical.topology.faces.cpu().long()].sum(1) >= 2] = 8.0
    return result


def test_every_face_gets_its_share_up_to_one(device):
    canonical, gaussians = placed(device=device)
    counts = torch.bincount(gaussians.faces.long().cpu(), minlength=len(canonical.topology.faces))
    share = face_areas(canonical.vertices, canonical.topology.faces).cpu() * factors(canonical)
    expected = COUNT * share / share.sum()
    assert counts.sum() == COUNT
    assert (counts - expected).abs().max() < 1.0


def test_they_lie_on_their_faces_with_the_faces_spacing_as_size(device):
    canonical, gaussians = placed(device=device)
    means, scales = gaussians.means.detach(), gaussians.scales.detach()
    # the triangle's second axis is its normal, and its origin lies in its plane: 1e-5 of its size is float32
    assert means[:, 1].abs().max() < 1e-4
    assert torch.equal(scales[:, 0], scales[:, 2])
    torch.testing.assert_close(scales[:, 1], 0.2 * scales[:, 0])
    k = triangle_frames(canonical.vertices, canonical.topology).scale[gaussians.faces.long()]
    share = (face_areas(canonical.vertices, canonical.topology.faces).cpu() * factors(canonical)).sum()
    spacing = (share / COUNT / factors(canonical)[gaussians.faces.long().cpu()]).sqrt().to(device)
    torch.testing.assert_close(scales[:, 0] * k, 0.75 * spacing, rtol=1e-4, atol=0)


def test_normals_are_unit_and_interpolated_or_the_faces(device):
    canonical, gaussians = placed(device=device)
    normals = gaussians.normals.detach()
    torch.testing.assert_close(normals.norm(dim=1), torch.ones(COUNT, device=device), atol=1e-6, rtol=0)
    assert torch.equal(normals, gaussians.initial_normals)
    rotation = triangle_frames(canonical.vertices, canonical.topology).rotation[gaussians.faces.long()]
    world = torch.einsum("nij,nj->ni", rotation, normals)
    corners = vertex_normals(canonical.vertices, canonical.topology.faces)[
        canonical.topology.faces[gaussians.faces.long()].long()
    ]
    # an interpolated normal is nearer to some corner's than the corners are to one another
    nearest = torch.einsum("nkc,nc->nk", corners, world).amax(1)
    apart = torch.einsum("nkc,nlc->nkl", corners, corners).amin((1, 2))
    assert (nearest >= apart - 1e-5).all()
    _, faceted = placed(smooth=False, device=device)
    assert (faceted.normals == torch.tensor([0.0, 1.0, 0.0], device=device)).all()


def test_albedo_is_sampled_where_each_lies_in_the_atlas():
    size = small_canonical().atlas.size
    u = ((torch.arange(size) + 0.5) / size).expand(size, size)
    v = 1 - ((torch.arange(size) + 0.5) / size)[:, None].expand(size, size)
    _, gaussians = placed(albedo=torch.stack([u, v, torch.full_like(u, 0.5)], dim=-1))
    expected = torch.cat([gaussians.uv, torch.full((COUNT, 1), 0.5)], dim=1)
    half = 0.5 / size
    # bilinear sampling is exact on a linear map, and held beyond the outer texel centres
    torch.testing.assert_close(gaussians.albedo.detach(), expected.clamp(half, 1 - half), atol=1e-5, rtol=0)


def test_the_seed_decides(device):
    first, second, other = (placed(seed=seed, device=device)[1] for seed in (0, 0, 1))
    assert all(
        torch.equal(a, b) for a, b in zip(first.tensors().values(), second.tensors().values(), strict=True)
    )
    assert not torch.equal(first.means, other.means)


@pytest.mark.parametrize("count", [1, 7])
def test_fewer_gaussians_than_faces(count):
    assert len(placed(count=count)[1]) == count


def test_initial_materials(device):
    _, gaussians = placed(count=5, device=device)
    for name, value in (("opacities", 0.5), ("albedo", 0.3)):
        found = getattr(gaussians, name)
        torch.testing.assert_close(found, torch.full_like(found, value), atol=1e-5, rtol=0)


@pytest.fixture
def sequence(tiny_dataset):
    return open_sequence(tiny_dataset)


def with_frames(sequence, changes):
    """The sequence with other parameters for some frames, by index."""
    frames = [
        replace(frame, parameters=changes.get(index, frame.parameters))
        for index, frame in enumerate(sequence.frames)
    ]
    return replace(sequence, frames=tuple(frames))


def test_the_reference_is_the_frontal_neutral_frame(sequence):
    canonical = small_canonical()
    rest = canonical.rig.rest()
    turned = {index: posed(rest, root=(0.0, 0.5, 0.0)) for index in range(6)}
    for index in sequence.train:
        assert (
            choose_reference(
                with_frames(sequence, {**turned, index: rest}),
                canonical,
                ConditionStatistics.of(conditions_of(FrameParameters.stack([rest]))),
            )
            == index
        )


def test_the_reference_has_the_mean_expression_among_frontal_frames(sequence):
    canonical = small_canonical()
    rest = canonical.rig.rest()
    values = dict(zip(sequence.train, (-2.0, 0.6, 2.0, -2.0), strict=True))
    frames = {
        index: replace(rest, expression=torch.full_like(rest.expression, value))
        for index, value in values.items()
    }
    changed = with_frames(sequence, frames)
    assert choose_reference(changed, canonical, condition_statistics(changed)) == sequence.train[1]


def test_test_frames_are_neither_reference_nor_in_the_statistics(sequence):
    canonical = small_canonical()
    rest = canonical.rig.rest()
    away = {index: parameters(index) for index in sequence.train}
    changed = with_frames(sequence, {**away, **dict.fromkeys(sequence.test, rest)})
    assert choose_reference(changed, canonical, condition_statistics(changed)) in sequence.train
    wild = with_frames(
        sequence, {index: replace(rest, expression=rest.expression + 99) for index in sequence.test}
    )
    before, after = condition_statistics(sequence).state_dict(), condition_statistics(wild).state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)


def test_initial_albedo_is_the_pseudo_albedo_or_the_reference_image(sequence):
    canonical = small_canonical()
    size = canonical.atlas.size
    reference = torch.full((size, size, 3), 0.123)
    with PixelCache(sequence.frames, resolution=32) as pixels:
        found = initial_albedo(sequence, pixels, canonical, reference)
        assert not torch.allclose(found, reference)
        # skin's display values in the made-up subject's albedo
        skin = torch.tensor([0.7, 0.45, 0.35]) ** (1 / 2.2)
        assert ((found - skin).abs().amax(-1) < 0.02).float().mean() > 0.1
    bare = replace(sequence, frames=tuple(replace(frame, albedo_path=None) for frame in sequence.frames))
    with PixelCache(bare.frames, resolution=32) as pixels:
        assert initial_albedo(bare, pixels, canonical, reference) is reference


@pytest.mark.parametrize(
    ("having", "expected"),
    [
        (range(0, 60, 2), [0, 4, 10, 14, 20, 24, 30, 34, 40, 44, 50, 54]),
        (range(3), [0, 1, 2]),
        (range(50, 62), list(range(50, 62))),
    ],
)
def test_the_albedo_is_unwrapped_from_twelve_frames_that_have_one(sequence, monkeypatch, having, expected):
    path = sequence.frames[sequence.train[0]].albedo_path
    frames = [
        replace(sequence.frames[0], albedo_path=path if index in having else None) for index in range(64)
    ]
    long = replace(sequence, frames=tuple(frames), train=tuple(range(62)), test=(62, 63))
    seen = []
    monkeypatch.setattr(
        initialize, "albedo_view", lambda sequence, pixels, canonical, index: seen.append(index)
    )
    initial_albedo(long, None, small_canonical(), torch.zeros(1))
    assert seen == expected


def test_tracked_parameters_start_as_tracked_and_learn_by_row(sequence):
    names = ("translation", "rotations", "expression")
    frames = [sequence.frames[index].parameters for index in sequence.train]
    tracked = TrackedParameters(sequence.batch(sequence.train))
    assert set(dict(tracked.named_parameters())) == set(names)
    for row, frame in enumerate(frames):
        assert all(
            torch.equal(getattr(tracked.frame(row, frame), name), getattr(frame, name)) for name in names
        )
    offset = torch.ones(len(sequence.template.v_template), 3)
    driven = tracked.frame(2, replace(frames[2], dynamic_offset=offset))
    assert driven.dynamic_offset is offset
    sum(getattr(driven, name).sum() for name in names).backward()
    for name in names:
        gradient = getattr(tracked, name).grad
        assert (gradient[2] == 1).all()
        assert (gradient[[0, 1, 3]] == 0).all()
