"""The built-in head: a template like any other, sound as a mesh and as a body."""

import numpy as np
import pytest
import torch
from heads import anatomy, model, people, pose, share_facing
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from samira_subject.anatomy.assembly import PARTS
from samira_subject.anatomy.eyes import EYE, EYE_RADIUS
from samira_subject.anatomy.skinning import JOINTS
from samira_subject.head import ORIGIN, build_head
from samira_warp.head import Rig, read_template, save_template
from samira_warp.head.regions import REGIONS, route_faces, route_vertices

FLAME_MASKS = {
    "face", "neck", "scalp", "boundary", "left_eyeball", "right_eyeball", "left_ear", "right_ear", "forehead",
    "eye_region", "nose", "lips",
    "left_eye_region", "right_eye_region",
}  # fmt: skip
RIMS = {
    "skin": 3,  # the neck's foot and what lines the two eyes
    "left_eyeball": 1, "right_eyeball": 1, "left_ear": 1, "right_ear": 1, "teeth_upper": 1, "teeth_lower": 1,
    "tongue": 1,
}  # fmt: skip
"""Open edges of each part, all of them hidden in the head but the foot."""


@pytest.fixture(scope="module")
def template():
    return build_head().template


def directed_edges(faces):
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def rims(faces):
    """The loops of edges that one face alone has, each in the order of its faces' corners."""
    edges = {tuple(edge) for edge in directed_edges(faces).tolist()}
    after = {start: end for start, end in edges if (end, start) not in edges}
    loops = []
    while after:
        start, end = after.popitem()
        loop = [start]
        while end != start:
            loop.append(end)
            end = after.pop(end)
        loops.append(loop)
    return loops


def part_of(vertex):
    """The name of its part; the mouth's lining is one with the skin."""
    name = PARTS[anatomy().part[vertex]]
    return "skin" if name == "mouth" else name


def test_it_is_read_as_it_was_written(template, tmp_path):
    save_template(template, tmp_path / "template.npz")
    assert read_template(tmp_path / "template.npz").hash == template.hash


def test_it_has_flames_layout(template):
    assert 4500 <= len(template.v_template) <= 6000
    assert template.parents.tolist() == [-1, 0, 1, 1, 1]
    assert template.n_shape == 20
    assert template.n_expression >= 24
    assert len(set(template.expression_names)) == template.n_expression
    assert template.names_expressions
    # an adult's head and neck, face along +z, its middle near the origin
    size = np.ptp(template.v_template, axis=0)
    assert (size > [0.14, 0.28, 0.18]).all()
    assert (size < [0.2, 0.36, 0.26]).all()
    tip = template.v_template[template.v_template[:, 2].argmax()]
    assert abs(tip[0]) < 0.001


def test_every_region_is_there(template):
    assert set(template.masks) >= FLAME_MASKS
    assert all(len(template.masks[name]) for name in template.masks)
    assert set(route_vertices(template)) == set(route_faces(template)) == set(range(len(REGIONS)))
    x = template.v_template[:, 0]
    for name, ids in template.masks.items():
        assert len(np.unique(ids)) == len(ids)
        if name.startswith("left"):
            assert (x[ids] > 0).all()
            assert set(anatomy().mirror[ids]) == set(template.masks[name.replace("left", "right")])
        elif not name.startswith("right"):
            assert set(anatomy().mirror[ids]) == set(ids)


def test_it_is_a_manifold(template):
    faces = template.faces
    assert len(np.unique(directed_edges(faces), axis=0)) == 3 * len(faces)
    assert np.array_equal(np.unique(faces), np.arange(len(template.v_template)))
    # corners at one vertex that share an edge hang together: as many heaps as vertices says that each has one
    # fan of faces
    owner = {tuple(edge): number for number, edge in enumerate(directed_edges(faces).tolist())}
    corner = np.arange(3 * len(faces)).reshape(3, -1).T  # the corner at which each directed edge begins
    links = []
    for (start, end), number in owner.items():
        across = owner.get((end, start))
        if across is not None:
            row, face = divmod(across, len(faces))
            links.append((number, corner[face, (row + 1) % 3]))
    first, second = np.array(links).T
    count, _ = connected_components(
        coo_array((np.ones(len(first)), (first, second)), shape=(3 * len(faces),) * 2), directed=False
    )
    assert count == len(template.v_template)


def test_parts_hang_together_and_are_open_where_it_does_not_show(template):
    edges = directed_edges(template.faces)
    size = len(template.v_template)
    count, heap = connected_components(
        coo_array((np.ones(len(edges)), edges.T), shape=(size, size)), directed=False
    )
    names = [{part_of(vertex) for vertex in np.flatnonzero(heap == number)} for number in range(count)]
    assert sorted(map(sorted, names)) == sorted([name] for name in RIMS)
    loops = rims(template.faces)
    assert {name: sum(part_of(loop[0]) == name for loop in loops) for name in RIMS} == RIMS
    foot = max(loops, key=lambda loop: -anatomy().points[loop, 1].mean())
    assert np.ptp(anatomy().points[foot, 1]) < 15
    for loop in loops:
        hidden = part_of(loop[0]) != "skin" or anatomy().lid[loop[0]] < 0
        assert hidden == (loop is not foot)


def capped_volumes(vertices, faces):
    """Cubic millimetres of each part, closed by fans from the middles of its rims."""
    volumes = dict.fromkeys(RIMS, 0.0)
    triangles = [(part_of(face[0]), vertices[face]) for face in faces]
    for loop in rims(faces):
        middle = vertices[loop].mean(axis=0)
        for start, end in zip(loop, loop[1:] + loop[:1], strict=True):
            triangles.append((part_of(loop[0]), np.stack([vertices[end], vertices[start], middle])))
    for name, (a, b, c) in triangles:
        volumes[name] += np.dot(a, np.cross(b, c)) / 6.0
    return volumes


def test_faces_look_outwards(template):
    volumes = capped_volumes(anatomy().points, template.faces)
    assert min(volumes.values()) > 0
    # a ball of EYE_RADIUS less its cap behind 120 degrees (0.16 of it); chords lose some hundredths, the
    # cornea adds as much
    ball = 4.0 / 3.0 * np.pi * EYE_RADIUS**3
    assert 0.76 * ball < volumes["left_eyeball"] < 0.88 * ball
    assert volumes["left_eyeball"] == pytest.approx(volumes["right_eyeball"])
    # brain, face and neck: some litres
    assert 3e6 < volumes["skin"] < 6e6


@pytest.mark.parametrize("bearing", [0, 45, 90, 135, 180, -45, -90, -135])
def test_what_is_seen_from_around_faces_the_viewer(bearing):
    share, count = share_facing(
        anatomy().points, np.arange(-110.0, 110.0, 2.3), np.arange(-165.0, 120.0, 2.7), bearing=bearing
    )
    assert count > 4000
    # between the ear's root and the head one may look behind a rim
    assert share > 0.998


def test_both_sides_mirror_each_other(template):
    a, flip = anatomy(), np.array([-1.0, 1.0, 1.0])
    assert np.array_equal(a.mirror[a.mirror], np.arange(len(a.points)))
    # teeth are strung on a spline whose nodes are symmetric to rounding
    np.testing.assert_allclose(a.points[a.mirror], a.points * flip, atol=1e-9)
    np.testing.assert_allclose(
        template.shapedirs[a.mirror, :, :20], template.shapedirs[:, :, :20] * flip[:, None], atol=1e-9
    )
    np.testing.assert_allclose(template.weights[a.mirror][:, [0, 1, 2, 4, 3]], template.weights, atol=1e-7)
    np.testing.assert_allclose(
        template.joint_regressor[[0, 1, 2, 4, 3]][:, a.mirror], template.joint_regressor, atol=1e-6
    )
    paired = {name.replace("left", "right"): name for name in PARTS if name.startswith("left")}
    mirrored = [PARTS.index(paired.get(name, name.replace("left", "right"))) for name in PARTS]
    assert np.array_equal(a.part[a.mirror], np.array(mirrored)[a.part])


def test_faces_mirror_but_on_teeth_and_tongue(template):
    a = anatomy()
    symmetric = ~a.is_part("teeth_upper", "teeth_lower", "tongue")[template.faces[:, 0]]
    faces = np.sort(template.faces[symmetric], axis=1)
    mirrored = np.sort(a.mirror[faces], axis=1)
    assert np.array_equal(np.unique(faces, axis=0), np.unique(mirrored, axis=0))


def test_weights_are_shares(template):
    assert template.weights.min() >= 0
    np.testing.assert_allclose(template.weights.sum(axis=1), 1.0, atol=1e-6)
    for joint, name in ((3, "left_eyeball"), (4, "right_eyeball")):
        assert np.array_equal(np.flatnonzero(template.weights[:, joint]), template.masks[name])
    # the foot stays, the skull goes with the neck's joint
    assert (template.weights[anatomy().points[:, 1] < -180, 0] > 0.95).all()
    assert (template.weights[anatomy().points[:, 1] > 20, 1] > 0.999).all()


def test_without_parameters_it_is_the_template(template):
    single = Rig.build(template)
    vertices = single.pose(single.rest(), torch.zeros(template.n_shape)).vertices.numpy()
    # three float32 roundings of numbers up to 0.25 m
    np.testing.assert_allclose(vertices, template.v_template, atol=3 * 0.25 * 2**-24 * 2)


def test_joints_are_where_a_skull_has_them(template):
    np.testing.assert_allclose(template.joint_regressor.sum(axis=1), 1.0, atol=1e-5)
    joints = 1000.0 * template.joint_regressor.astype(np.float64) @ template.v_template - ORIGIN
    # float32 vertices and weights: some 1e-5 mm each, times the weights' sum
    np.testing.assert_allclose(joints, JOINTS, atol=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_eyes_turn_about_the_middle_of_their_balls_whoevers_they_are(side):
    ball = anatomy().is_part("left_eyeball" if side > 0 else "right_eyeball")
    center = EYE * (side, 1.0, 1.0)
    for identity in people(20):
        rest = pose(identity=identity)
        unposed = model().v_template + model().shapedirs[:, :, :20] @ torch.from_numpy(identity).double()
        joint = (1000.0 * model().joint_regressor @ unposed).numpy()[3 if side > 0 else 4] - ORIGIN
        # the ball is moved as one: its middle went where all of it did
        shift = rest[ball] - anatomy().points[ball]
        np.testing.assert_allclose(shift, shift[:1].repeat(ball.sum(), axis=0), atol=1e-3)
        assert np.linalg.norm(center + shift[0] - joint) < 0.2
        turned = pose(identity=identity, eyes=(0.2, 0.4, 0.0) * 2)
        before, after = (np.linalg.norm(vertices[ball] - joint, axis=1) for vertices in (rest, turned))
        np.testing.assert_allclose(after, before, atol=1e-3)


def test_an_eyeball_is_round_behind_its_cornea():
    ball = anatomy().points[anatomy().is_part("left_eyeball")] - EYE
    radius = np.linalg.norm(ball, axis=1)
    cornea = ball[:, 2] > radius * np.cos(0.6)
    np.testing.assert_allclose(radius[~cornea], EYE_RADIUS, atol=1e-6)
    assert radius[cornea].min() >= EYE_RADIUS - 1e-6
    assert radius.max() < EYE_RADIUS + 1.5
