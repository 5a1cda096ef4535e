"""What of a light arrives past the head: closed forms, invariances, and where gradients go and do not."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from kernels.meshes import sphere
from scipy.spatial import ConvexHull
from subjects import camera, parameters, small_avatar

from samira_warp.avatar.gbuffer import blend_arrival
from samira_warp.avatar.occlusion import LEAST_OPEN, Occluder, sky
from samira_warp.head import PosedHead
from samira_warp.kernels.cubemap.layout import texel_directions
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.light import Environment, FilteredLight
from samira_warp.surface import LIGHT_CHANNELS, LIGHT_WIDTH


def pose(vertices, transform=None):
    """A mesh as a posed head; ``transform`` takes it to the world."""
    transform = torch.eye(4) if transform is None else transform
    world = vertices @ transform[:3, :3].T + transform[:3, 3]
    return PosedHead(world, transform[None], 0)


def sphere_over_plane():
    """A sphere of radius 0.05 at a height of 0.1 over a grid of points, and where the grid's points begin.

    The grid lies on a plane of its own triangles, which look up.
    """
    vertices, faces = sphere(rings=24, sectors=48)
    ball = 0.05 * vertices + torch.tensor([0.0, 0.1, 0.0])
    side = torch.linspace(-0.15, 0.15, 9)
    z, x = torch.meshgrid(side, side, indexing="ij")
    plane = torch.stack([x, torch.zeros_like(x), z], dim=-1).reshape(-1, 3)
    cell = (torch.arange(8)[:, None] * 9 + torch.arange(8)).reshape(-1, 1)
    squares = torch.cat([cell + torch.tensor([[0, 9, 1]]), cell + torch.tensor([[1, 9, 10]])])
    faces = torch.cat([faces, squares + len(ball)]).to(torch.int32)
    return torch.cat([ball, plane]), faces, len(ball)


def occluded(vertices, faces, transform=None):
    occluder = Occluder(vertices, MeshTopology.build(faces, len(vertices)))
    return occluder, occluder.occlude(pose(vertices, transform))


def uniform(value=1.0):
    cubemap = torch.full((6, 16, 16, 3), value)
    return FilteredLight.of(cubemap, cubemap)


def test_the_sky_is_the_whole_sphere_in_blocks():
    directions, areas, samples = sky(torch.device("cpu"))
    assert directions.shape == (384, 3)
    assert float(areas.double().sum()) == pytest.approx(4 * math.pi, rel=1e-6)
    assert torch.equal(directions.sort(dim=0).values, texel_directions(8).reshape(-1, 3).sort(dim=0).values)
    # samples of a direction lie within its texel: 45 degrees are 4 texels, their corners 8 degrees away
    assert float((samples * directions[:, None]).sum(dim=-1).min()) > math.cos(math.radians(10))
    # neighbours: sixteen of a block span at most half a face's diagonal
    packets = directions.unflatten(0, (-1, 16))
    assert float((packets @ packets.mT).min()) > math.cos(math.radians(60))


def test_a_sphere_over_a_plane_darkens_it_by_its_form_factor():
    """Under a uniform sky a plane's point loses (r / d)^2 cos of it, d and cos to the sphere's centre."""
    vertices, faces, first = sphere_over_plane()
    _, occlusion = occluded(vertices, faces)
    points = vertices[first:]
    away = torch.tensor([0.0, 0.1, 0.0]) - points
    distance = away.norm(dim=1)
    expected = 1.0 - (0.05 / distance) ** 2 * away[:, 1] / distance
    error = occlusion.openness[first:, 0] - expected
    # A sphere of angular radius a has 2 pi sin(a) / 0.18 texels along its rim; each is in or out by chance,
    # with a standard deviation of 0.3 texels (a fraction that is uniform), of 0.0327 / pi of the light.
    rim = 2.0 * math.pi * 0.05 / distance / 0.18
    sigma = 0.3 * rim.sqrt() * 0.0327 / math.pi
    assert float((error / sigma).abs().max()) < 4.0
    assert float(error.mean().abs()) < 0.003


def test_a_convex_mesh_is_unshadowed_to_the_bit(generator):
    vertices, faces = sphere(rings=16, sectors=32)
    occluder, occlusion = occluded(0.1 * vertices, faces.to(torch.int32))
    assert (occlusion.bits == -1).all()
    cubemap = torch.rand(6, 64, 64, 3, generator=generator) ** 16
    light = FilteredLight.of(cubemap, cubemap).with_spots(cubemap)
    assert light.spots is not None
    assert (occluder.arrival(occlusion, light, camera(16)) == 1).all()


def test_a_closed_box_is_dark_inside():
    """Its corners see their own walls alone, whatever the light."""
    corners = torch.tensor(np.array(np.meshgrid(*[[-0.1, 0.1]] * 3)).reshape(3, -1).T, dtype=torch.float32)
    faces = torch.from_numpy(ConvexHull(corners.numpy()).simplices)
    a, b, c = corners[faces].unbind(dim=1)
    inward = (torch.linalg.cross(b - a, c - a) * a).sum(dim=1) < 0
    faces = torch.where(inward[:, None], faces, faces.flip(1)).to(torch.int32)
    occluder, occlusion = occluded(corners, faces)
    arrival = occluder.arrival(occlusion, uniform(), camera(16))
    assert (arrival[:, :3] == 0).all()
    assert (occlusion.openness == torch.tensor(LEAST_OPEN)).all()


def test_under_a_uniform_light_what_arrives_is_openness(generator):
    vertices, faces, _ = sphere_over_plane()
    occluder, occlusion = occluded(vertices, faces)
    arrival = occluder.arrival(occlusion, uniform(0.7), camera(16))
    # the same sums with powers of areas x 0.7, looked up: some roundings
    expected = occlusion.openness.expand(-1, 3)
    torch.testing.assert_close(arrival[:, :3].clamp(min=LEAST_OPEN), expected, atol=1e-5, rtol=0)


def test_a_head_that_turns_with_its_light_and_camera_is_lit_the_same(generator):
    vertices, faces, _ = sphere_over_plane()
    cubemap = torch.rand(6, 16, 16, 3, generator=generator) ** 4
    light = FilteredLight.of(cubemap, cubemap)
    view = camera(16)
    angle = math.radians(37.0)
    turn = torch.eye(4)
    turn[0, 0] = turn[2, 2] = math.cos(angle)
    turn[0, 2], turn[2, 0] = math.sin(angle), -math.sin(angle)
    results = []
    for transform, lit, seen in (
        (torch.eye(4), light, view),
        (turn, light.turned(37.0), replace(view, world_to_camera=view.world_to_camera @ turn.T)),
        (turn, light.turned(-37.0), replace(view, world_to_camera=view.world_to_camera @ turn.T)),
    ):
        occluder, occlusion = occluded(vertices, faces, transform)
        results.append(occluder.arrival(occlusion, lit, seen))
    same, other = ((result - results[0]).abs().max() for result in results[1:])
    # rays and lookups in the head's axes, whose inputs are turned there and back: 1e-6, and a ray or two that
    # passes an edge so closely
    assert min(float(same), float(other)) < 0.01
    assert max(float(same), float(other)) > 0.05


def test_a_light_sends_its_shadows_a_gradient(generator):
    """Against a difference quotient of a smooth function: both are rounded, to some 1e-3 of it."""
    vertices, faces, first = sphere_over_plane()
    occluder, occlusion = occluded(vertices, faces)
    cubemap = (0.2 + torch.rand(6, 16, 16, 3, generator=generator)).requires_grad_()
    step = torch.randn(6, 16, 16, 3, generator=generator)
    upstream = torch.randn(len(vertices) - first, 3, generator=generator)

    def value(radiance):
        arrival = occluder.arrival(occlusion, FilteredLight.of(radiance, radiance), camera(16))
        return (arrival[first:, :3] * upstream).sum()

    (grad,) = torch.autograd.grad(value(cubemap), cubemap)
    with torch.no_grad():
        quotient = (value(cubemap + 0.01 * step) - value(cubemap - 0.01 * step)) / 0.02
    assert float((grad * step).sum()) == pytest.approx(float(quotient), rel=5e-3)


def test_an_unoccluded_avatar_has_the_bits_of_one_without_shadows():
    avatar, frame, view = small_avatar(perturb=0.1), parameters(0), camera(32)
    with torch.no_grad():
        motion = avatar.move(frame)
        gbuffer = avatar.rasterize(motion, view)
        occlusion = avatar.occluder.occlude(motion.head)
        open_to_all = replace(
            occlusion,
            bits=torch.full_like(occlusion.bits, -1),
            openness=torch.ones_like(occlusion.openness),
        )
        plain, lit = (
            avatar.shade(motion, gbuffer, view, avatar.light(), occlusion=each)
            for each in (None, open_to_all)
        )
    # blended ones are divided by alpha: a rounding or two from 1
    torch.testing.assert_close(lit.image, plain.image, atol=1e-5, rtol=0)


def reached_by(values, avatar):
    """Names of the avatar's parameters that have a gradient of some values."""
    grads = torch.autograd.grad(values.sum(), list(avatar.parameters()), allow_unused=True)
    named = zip(avatar.named_parameters(), grads, strict=True)
    return {name for (name, _), grad in named if grad is not None and (grad != 0).any()}


def test_shadows_are_blended_at_once_or_later_and_are_the_same():
    avatar, frame, view = small_avatar(perturb=0.1), parameters(0), camera(32)
    at_once = avatar.render(frame, view)
    motion, light = avatar.move(frame), avatar.light()
    occlusion = avatar.occluder.occlude(motion.head)
    later = avatar.shade(motion, avatar.rasterize(motion, view), view, light, occlusion=occlusion)
    for name in LIGHT_CHANNELS:
        values = getattr(at_once.gbuffer, name)
        assert (values < 0.999).any(), name
        assert torch.equal(values, getattr(later.gbuffer, name)), name
    assert torch.equal(at_once.image, later.image)
    # at once, a Gaussian that stands before others may leave or fade; the light learns either way
    assert reached_by(later.gbuffer.visibility, avatar) == {"light.diffuse"}
    moved = {"light.diffuse", "gaussians.means", "gaussians.opacity_logits"}
    assert moved <= reached_by(at_once.gbuffer.visibility, avatar)


def test_an_avatar_that_learned_without_shadows_casts_none_under_its_own_light():
    avatar, frame, view = small_avatar(visibility=False), parameters(0), camera(32)
    environment = Environment.from_cubemaps(*(torch.ones(6, 16, 16, 3),) * 2)
    with torch.no_grad():
        own, off = avatar.render(frame, view), avatar.render(frame, view, shadows=False)
        lit, unlit = (avatar.render(frame, view, environment, shadows=each) for each in (True, False))
    assert torch.equal(own.image, off.image)
    assert not torch.equal(lit.image, unlit.image)


def test_arrival_of_a_wrong_shape_is_refused():
    avatar = small_avatar()
    gbuffer = avatar.rasterize(avatar.move(parameters(0)), camera(16))
    for wrong in (torch.ones(len(avatar.gaussians), LIGHT_WIDTH + 1), torch.ones(3, LIGHT_WIDTH)):
        with pytest.raises(ValueError, match=r"arrival|features"):
            blend_arrival(gbuffer, wrong)
