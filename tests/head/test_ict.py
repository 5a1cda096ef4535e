"""ICT-FaceKit by a stand-in: a folder of the release's layout, vertices counted as its README does."""

import json

import numpy as np
import pytest

from samira_warp.head import read_head
from samira_warp.head.ict import JOINTS
from samira_warp.head.ict_regions import KEPT, PARTS, VERTICES, regions_of
from samira_warp.head.origin import EYES
from samira_warp.head.regions import REGIONS, route_vertices
from samira_warp.head.uv_layout import uv_fault
from samira_warp.support.errors import UserError

DROPPED = {
    "left_iris": (22221, 23021),
    "right_iris": (23791, 24591),
    "fluid_and_more": (24591, 26719),
}
"""Parts by the README's numbers that are left out."""

PLACES = {
    "face": ((0.0, 0.0, 1.0), (8.5, 12.0, 11.5)),
    "head": ((0.0, -2.0, -3.0), (9.0, 16.0, 8.0)),
    "left_eyeball": ((3.1, 3.6, 8.1), (1.5, 1.5, 1.5)),
    "right_eyeball": ((-3.1, 3.6, 8.1), (1.5, 1.5, 1.5)),
    "left_socket": ((3.1, 3.6, 7.9), (1.6, 1.6, 1.6)),
    "right_socket": ((-3.1, 3.6, 7.9), (1.6, 1.6, 1.6)),
}
"""Middles and radii, in the file's unit; all else is a small ball in the mouth."""


def part_of(first, last, middle, radii, tile):
    """Vertices, quads and their UV coordinates of one part: a grid on an ellipsoid, in a tile of its own."""
    count = last - first
    rows = int(np.sqrt(count))
    columns = count // rows
    row, column = np.divmod(np.arange(rows * columns), columns)
    polar, turn = np.pi * (row + 0.5) / rows, 1.9 * np.pi * column / columns
    ball = np.column_stack([np.sin(polar) * np.sin(turn), np.cos(polar), np.sin(polar) * np.cos(turn)])
    vertices = np.concatenate([ball, np.tile(ball[:1], (count - len(ball), 1))]) * radii + middle
    uvs = np.column_stack([tile + 0.05 + 0.9 * column / columns, 0.95 - 0.9 * row / rows])
    uvs = np.concatenate([uvs, np.tile(uvs[:1], (count - len(uvs), 1))])
    corner = first + (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None]).ravel()
    return vertices, uvs, np.stack([corner, corner + columns, corner + columns + 1, corner + 1], axis=1)


def mesh():
    """(26719, 3) vertices, their UV coordinates, and quads."""
    parts = []
    for tile, (name, (first, last)) in enumerate(sorted((PARTS | DROPPED).items(), key=lambda part: part[1])):
        middle, radii = PLACES.get(name, ((0.0, -3.5, 6.0), (1.5, 0.7, 3.0)))
        parts.append(part_of(first, last, np.array(middle), np.array(radii), tile))
    return (np.concatenate(part) for part in zip(*parts, strict=True))


def text_of(vertices, uvs=(), quads=()):
    lines = [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uvs]
    lines += ["f " + " ".join(f"{corner + 1}/{corner + 1}" for corner in quad) for quad in quads]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def release(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ict") / "FaceXModel"
    folder.mkdir()
    vertices, uvs, quads = mesh()
    assert len(vertices) == VERTICES
    text = text_of(vertices, uvs, quads)
    (folder / "generic_neutral_mesh.obj").write_text(text)
    for name, step in (("identity001", 2.0), ("identity000", 1.0), ("jawOpen", 3.0), ("browDown_L", 4.0)):
        moved = vertices + step * np.array([0.01, 0.02, -0.01])
        (folder / f"{name}.obj").write_text(text_of(moved, uvs, quads))
    (folder / "PupilDilate_L.obj").write_text("what is within the eyeballs is not looked at")
    (folder / "vertex_indices.json").write_text(json.dumps({"expressions": ["jawOpen", "browDown_L"]}))
    return folder, vertices


@pytest.fixture(scope="module")
def template(release):
    return read_head(release[0])


def test_shapes_are_differences_in_metres_in_order(template):
    assert template.n_shape == 2
    assert template.expression_names == ("browDown_L", "jawOpen")
    steps = 0.01 * np.array([1.0, 2.0, 4.0, 3.0])[None, None] * np.array([0.01, 0.02, -0.01])[None, :, None]
    # six digits of up to 20 units
    assert np.abs(template.shapedirs - steps).max() < 0.01 * 2e-4


def test_the_eyes_come_to_where_flame_has_them(template):
    for mask, joint in (("left_eyeball", 2), ("right_eyeball", 3)):
        ball = template.v_template[template.masks[mask]]
        joints = template.joint_regressor.astype(np.float64) @ template.v_template
        distances = np.linalg.norm(ball - joints[joint], axis=1)
        assert np.abs(distances - 0.015).max() < 1e-5
        assert (template.weights[template.masks[mask]] == np.eye(4)[joint]).all()
    assert np.abs(joints[2:].mean(axis=0) - EYES).max() < 1e-6
    assert template.joint_names == JOINTS
    assert joints[0, 1] < joints[1, 1] < -0.08


def test_parts_that_need_shaders_are_left_out(template, release):
    vertices = release[1]
    assert len(template.v_template) == len(KEPT) == 22991
    eyes = 0.5 * (np.array(PLACES["left_eyeball"][0]) + PLACES["right_eyeball"][0])
    wanted = 0.01 * (vertices[KEPT] - eyes) + EYES
    assert np.abs(template.v_template - wanted).max() < 1e-5
    assert template.faces.max() < 22991
    used = np.unique(template.faces)
    for name, (first, _) in PARTS.items():
        place = np.searchsorted(KEPT, first)
        assert np.isin(place, used), f"{name} has no faces"


def test_one_atlas(template):
    assert uv_fault(template.vt, template.ft) is None


def test_the_neck_bends_and_the_head_goes_with_it(template):
    heights = template.v_template[:, 1]
    assert (template.weights[heights > -0.10, 0] == 0.0).all()
    low = (heights < -0.18) & (template.weights[:, 2:].sum(axis=1) == 0.0)
    assert (template.weights[low, 0] == 1.0).all()
    assert low.any()


def test_regions_cover_the_face_and_are_where_they_should_be(release, template):
    regions = regions_of(release[1])
    number = {name: REGIONS.index(name) for name in REGIONS}
    routed = route_vertices(template)
    for name in ("nose", "lips", "forehead", "scalp", "neck", "left_eye", "right_eye", "mouth"):
        assert (routed == number[name]).any(), name
    for name, ids in regions.items():
        assert np.isin(ids, KEPT).all(), name
        x = release[1][ids, 0]
        assert not name.startswith("left") or (x > 0.0).all(), name
        assert not name.startswith("right") or (x < 0.0).all(), name


def test_the_release_above_the_folder_will_do(release, template):
    assert read_head(release[0].parent).hash == template.hash


def test_a_folder_that_is_none(tmp_path):
    with pytest.raises(
        UserError, match=r"expected a template.npz, .*ICT-FaceKit's folder, found another folder"
    ):
        read_head(tmp_path)


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("jawOpen.obj", "v 0 0 0\n", "jawOpen.obj: expected the 26719 vertices of ICT-FaceKit, found 1"),
        ("identity000.obj", "v 0 0\n", "identity000.obj: expected three numbers after each v"),
        ("generic_neutral_mesh.obj", "v 0 0 0\nf 1 1 1\n", "expected the 26719 vertices"),
    ],
)
def test_a_file_that_is_broken_is_named(release, tmp_path, file, text, said):
    for path in release[0].iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / file).write_text(text)
    with pytest.raises(UserError, match=said):
        read_head(tmp_path)


def test_without_shapes(release, tmp_path):
    (tmp_path / "generic_neutral_mesh.obj").write_bytes(
        (release[0] / "generic_neutral_mesh.obj").read_bytes()
    )
    with pytest.raises(UserError, match=r"expected identity000.obj and on, found none"):
        read_head(tmp_path)
