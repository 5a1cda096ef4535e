"""FLAME's own files, in every form in which they are found, and what is said where one of them is missing or
broken."""

import itertools
import pickle
import shutil

import numpy as np
import pytest
import torch
from data.flame_files import (
    MASK_SIZES,
    N_EXPRESSION,
    UVS,
    flame_arrays,
    flame_masks,
    flame_uvs,
    pickle_flame,
    write_companions,
    write_flame,
)

from samira_warp.head import Rig, UvAtlas, read_template, save_template
from samira_warp.head.flame import EYELIDS, FLAME_FACES, FLAME_IDENTITY, FLAME_VERTICES, read_flame
from samira_warp.head.flame_companions import UV_FILES, read_masks
from samira_warp.head.models import read_head
from samira_warp.head.regions import REGIONS, route_faces
from samira_warp.head.teeth import LOWER_LIP, RING, TEETH_FACES, TEETH_VERTICES, UPPER_LIP
from samira_warp.support.errors import UserError


@pytest.fixture(scope="module")
def arrays():
    return flame_arrays()


@pytest.fixture(scope="module")
def original(arrays, tmp_path_factory):
    """A pickle and an .npz of FLAME, with what belongs beside them."""
    folder = tmp_path_factory.mktemp("flame")
    write_flame(folder, arrays=arrays, eyelids=True)
    write_flame(folder, name="flame2023.npz", arrays=arrays)
    return folder


@pytest.fixture
def folder(original, tmp_path):
    """A copy that a test may change; the large files are links."""
    shutil.copytree(original, tmp_path / "flame", copy_function=shutil.os.link)
    return tmp_path / "flame"


@pytest.fixture(scope="module")
def flame(original):
    return read_flame(original / "flame2023.pkl")


def test_it_is_flame_with_teeth(flame, arrays):
    assert flame.v_template.shape == (FLAME_VERTICES + TEETH_VERTICES, 3) == (5143, 3)
    assert flame.faces.shape == flame.ft.shape == (FLAME_FACES + TEETH_FACES, 3) == (10144, 3)
    assert (flame.n_shape, flame.n_expression) == (300, N_EXPRESSION + 2)
    for name, key in (("v_template", "v_template"), ("posedirs", "posedirs"), ("weights", "weights")):
        np.testing.assert_array_equal(getattr(flame, name)[:FLAME_VERTICES], arrays[key].astype(np.float32))
    np.testing.assert_array_equal(
        flame.shapedirs[:FLAME_VERTICES, :, : FLAME_IDENTITY + N_EXPRESSION], arrays["shapedirs"]
    )
    np.testing.assert_array_equal(
        flame.joint_regressor[:, :FLAME_VERTICES], arrays["J_regressor"].toarray().astype(np.float32)
    )
    np.testing.assert_array_equal(flame.faces[:FLAME_FACES], arrays["f"])
    assert flame.parents.tolist() == [-1, 0, 1, 1, 1]
    vt, ft = flame_uvs()
    np.testing.assert_array_equal(flame.vt[:UVS], vt.astype(np.float32))
    np.testing.assert_array_equal(flame.ft[:FLAME_FACES], ft)
    masks = flame_masks()
    assert {name: len(ids) for name, ids in flame.masks.items() if not name.startswith("teeth")} == MASK_SIZES
    assert all(np.array_equal(flame.masks[name], ids) for name, ids in masks.items())
    assert not flame.names_expressions
    assert flame.expression_names[:2] == ("expression_000", "expression_001")


def test_an_npz_of_the_same_keys_is_the_same_head(original, flame):
    assert read_flame(original / "flame2023.npz").hash == flame.hash


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_any_pickle_protocol(folder, arrays, flame, protocol):
    pickle_flame(folder / "generic_model.pkl", arrays, protocol=protocol)
    assert read_flame(folder / "generic_model.pkl").hash == flame.hash


@pytest.mark.parametrize("uvs", UV_FILES)
def test_uvs_of_any_kind(folder, flame, uvs):
    (folder / "flame_uv.npz").unlink()
    write_companions(folder / "uvs", uvs=uvs)
    shutil.copy(folder / "uvs" / uvs, folder / uvs)
    ours = read_flame(folder / "flame2023.npz")
    # text of nine digits, and rounding to float32
    np.testing.assert_allclose(ours.vt, flame.vt, atol=1e-7)
    np.testing.assert_array_equal(ours.ft, flame.ft)
    np.testing.assert_array_equal(ours.faces, flame.faces)


def test_a_texture_without_uvs_is_passed_over(folder, flame):
    (folder / "flame_uv.npz").unlink()
    np.savez(folder / "FLAME_texture.npz", mean=np.zeros(3))
    write_companions(folder / "uvs", uvs="texture_data_512.npy")
    shutil.copy(folder / "uvs" / "texture_data_512.npy", folder)
    np.testing.assert_allclose(read_flame(folder / "flame2023.npz").vt, flame.vt, atol=1e-7)


def test_an_npz_may_bring_its_uvs(folder, flame):
    vt, ft = flame_uvs()
    with np.load(folder / "flame2023.npz") as archive:
        np.savez(folder / "own.npz", **archive, vt=vt, ft=ft)
    (folder / "flame_uv.npz").unlink()
    assert read_flame(folder / "own.npz").hash == flame.hash


def test_eyelids_are_the_last_expressions(original, flame, folder):
    assert flame.expression_names[-2:] == EYELIDS
    for column, name in ((-2, "l_eyelid.npy"), (-1, "r_eyelid.npy")):
        np.testing.assert_array_equal(flame.shapedirs[:FLAME_VERTICES, :, column], np.load(original / name))
        assert not flame.shapedirs[FLAME_VERTICES:, :, column].any()
    (folder / "blendshapes").mkdir()
    for name in ("l_eyelid.npy", "r_eyelid.npy"):
        (folder / name).rename(folder / "blendshapes" / name)
    assert read_flame(folder / "flame2023.npz").hash == flame.hash
    shutil.rmtree(folder / "blendshapes")
    without = read_flame(folder / "flame2023.npz")
    assert without.n_expression == N_EXPRESSION
    assert without.expression_names[-1] == f"expression_{N_EXPRESSION - 1:03d}"


def test_the_teeth_are_behind_the_lips_and_outward(flame, arrays):
    upper, lower = (arrays["v_template"][list(ring)] for ring in (UPPER_LIP, LOWER_LIP))
    gap = np.linalg.norm(upper - lower, axis=1).mean()
    teeth = flame.v_template[FLAME_VERTICES:].reshape(8, RING, 3)
    middle = (upper + lower) / 2
    np.testing.assert_allclose(teeth[:, :, 0], np.tile(middle[:, 0], (8, 1)), atol=1e-7)
    heights = (teeth[:, :, 1] - middle[:, 1].mean()) / gap
    np.testing.assert_allclose(
        heights, np.tile([[2.1], [-2.1], [0.1], [-0.1], [2.1], [0.1], [-2.1], [-0.1]], (1, RING)), atol=1e-4
    )
    depths = (middle[:, 2] - teeth[:, :, 2]) / gap
    np.testing.assert_allclose(
        depths, np.tile([[1.5], [1.9], [1.5], [1.9], [2.5], [2.5], [2.9], [2.9]], (1, RING)), atol=1e-4
    )
    a, b, c = (flame.v_template[flame.faces[FLAME_FACES:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a).reshape(6, -1, 3)
    faces_front, faces_down, faces_up = normals[[0, 3], :, 2], normals[2, :, 1], normals[5, :, 1]
    assert (faces_front > 0).all()
    assert (normals[[1, 4], :, 2] < 0).all()
    assert (faces_down < 0).all()
    assert (faces_up > 0).all()


def test_the_teeth_move_with_their_jaw(flame, arrays):
    upper, lower = flame.masks["teeth_upper"], flame.masks["teeth_lower"]
    assert np.array_equal(
        np.sort(np.concatenate([upper, lower])), np.arange(FLAME_VERTICES, FLAME_VERTICES + TEETH_VERTICES)
    )
    np.testing.assert_array_equal(flame.weights[upper], np.tile(np.eye(5)[1], (60, 1)))
    np.testing.assert_array_equal(flame.weights[lower], np.tile(np.eye(5)[2], (60, 1)))
    assert not flame.joint_regressor[:, FLAME_VERTICES:].any()
    assert not flame.posedirs[FLAME_VERTICES:].any()
    assert not flame.shapedirs[FLAME_VERTICES:, :, FLAME_IDENTITY:].any()
    lips = (arrays["shapedirs"][list(UPPER_LIP)] + arrays["shapedirs"][list(LOWER_LIP)])[
        :, :, :FLAME_IDENTITY
    ] / 2
    np.testing.assert_allclose(
        flame.shapedirs[FLAME_VERTICES:, :, :FLAME_IDENTITY], np.tile(lips, (8, 1, 1)), atol=1e-9
    )


def test_a_texel_of_the_teeth_means_one_place(flame):
    """Each strip has its own band of v, and all are within the strip that VHAP found free."""
    uvs = flame.vt[flame.ft[FLAME_FACES:]].reshape(6, -1, 2)
    assert uvs[:, :, 0].min() > 0.37
    assert uvs[:, :, 0].max() < 0.63
    assert uvs[:, :, 1].min() >= np.float32(1 - 0.0425)
    assert uvs[:, :, 1].max() <= np.float32(1 - 0.0083)
    bands = sorted((band[:, 1].min(), band[:, 1].max()) for band in uvs)
    assert all(above[0] >= below[1] for below, above in itertools.pairwise(bands))


def test_it_serves_as_any_template(flame, tmp_path):
    save_template(flame, tmp_path / "template.npz")
    assert read_template(tmp_path / "template.npz").hash == flame.hash
    assert read_head(tmp_path / "template.npz").hash == flame.hash
    rig = Rig.build(flame)
    posed = rig.pose(rig.rest(), torch.zeros(flame.n_shape))
    np.testing.assert_allclose(posed.vertices.numpy(), flame.v_template, atol=1e-6)
    assert (route_faces(flame)[FLAME_FACES:] == REGIONS.index("mouth")).all()
    atlas = UvAtlas.build(flame, size=64)
    assert (atlas.region[atlas.valid] >= 0).all()


def refused(path):
    with pytest.raises(UserError) as caught:
        read_head(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("flame2023.npz", "flame2023.npz: expected a template.npz, FLAME's file, GNM's"),
        ("flame_uv.npz", "expected FLAME's UV coordinates in one of head_template_mesh.obj"),
        ("FLAME_masks.pkl", "FLAME_masks.pkl: expected FLAME's vertex masks"),
        ("l_eyelid.npy", "l_eyelid.npy: expected the other eyelid beside r_eyelid.npy"),
    ],
)
def test_a_file_that_is_missing_is_named(folder, file, said):
    (folder / file).unlink()
    assert said in refused(folder / "flame2023.npz")


def test_no_flame_at_all(tmp_path):
    assert "generic_model.pkl: expected FLAME's file (.pkl or .npz), found no such file" in refused(
        tmp_path / "generic_model.pkl"
    )


def broken(folder, **changes):
    with np.load(folder / "flame2023.npz") as archive:
        arrays = dict(archive)
    for key, value in changes.items():
        if value is None:
            del arrays[key]
        else:
            arrays[key] = value
    np.savez(folder / "broken.npz", **arrays)
    return folder / "broken.npz"


FAULTS = {
    "no shapes": ({"shapedirs": None}, "broken.npz: expected the key shapedirs, found only"),
    "another head": (
        {"v_template": np.zeros((10, 3))},
        "v_template: expected FLAME's numbers of shape (5023, 3), found float64 of shape (10, 3)",
    ),
    "identity alone": (
        {"shapedirs": np.zeros((5023, 3, 300), np.float32)},
        "shapedirs: expected numbers of shape (5023, 3, 400)",
    ),
    "NaN": ({"v_template": np.full((5023, 3), np.nan)}, "v_template: expected finite numbers"),
    "faces beyond the vertices": ({"f": np.full((9976, 3), 5023)}, "f: expected integers"),
    "other faces": ({"f": np.zeros((99, 3), int)}, "f: expected FLAME's numbers of shape (9976, 3)"),
    "words": ({"weights": np.full((5023, 5), "a")}, "weights: expected FLAME's numbers of shape (5023, 5)"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_file_that_is_not_flames_is_named(folder, name):
    changes, said = FAULTS[name]
    message = refused(broken(folder, **changes))
    assert str(folder / "broken.npz") in message
    assert said in message


COMPANION_FAULTS = {
    "uvs of other faces": (
        "flame_uv.npz", {"vt": np.zeros((9, 2)), "ft": np.zeros((9, 3), int)},
        "ft: expected the 9976 triangles",
    ),
    "uvs beyond": (
        "flame_uv.npz", {"vt": np.zeros((9, 2)), "ft": np.full((9976, 3), 9)},
        "ft: expected integers from 0 to 8",
    ),
    "uvs of three": (
        "flame_uv.npz", {"vt": np.zeros((9, 3)), "ft": np.zeros((9976, 3), int)},
        "vt: expected finite numbers of shape",
    ),
    "masks that are a list": (
        "FLAME_masks.pkl", [1, 2], "expected a dictionary of vertex ids by region, found list",
    ),
    "masks beyond": (
        "FLAME_masks.pkl", {"lips": np.array([5023])},
        "FLAME_masks.pkl: lips: expected integers from 0 to 5022",
    ),
    "masks of words": ("FLAME_masks.pkl", {"lips": "all"}, "FLAME_masks.pkl: lips: expected an array"),
    "eyelids of another head": (
        "l_eyelid.npy", np.zeros((9, 3)), "l_eyelid.npy: expected finite numbers of shape (5023, 3)",
    ),
    "eyelids of words": (
        "l_eyelid.npy", np.full((5023, 3), "a"), "l_eyelid.npy: expected finite numbers of shape (5023, 3)",
    ),
    "an empty mesh": (
        "head_template.obj", "# nothing",
        "head_template.obj: expected polygons (f), found none",
    ),
    "quads": (
        "head_template.obj", 4 * "v 0 0 0\n" + "vt 0 0\nf 1/1 2/1 3/1 4/1",
        "head_template.obj: f: expected the 9976 triangles of FLAME, found shape (2, 3)",
    ),
    "a mesh without uvs": (
        "head_template.obj", 3 * "v 0 0 0\n" + 9976 * "f 1 2 3\n",
        "head_template.obj: vt: expected at least one",
    ),
    "a mesh with some uvs": (
        "head_template.obj", 3 * "v 0 0 0\n" + "vt 0 0\n" + 9976 * "f 1/1 2/1 3\n",
        "head_template.obj: ft: expected integers from 0 to 0",
    ),
    "a mesh beyond": ("head_template.obj", "vt 0 0\nf 1/1 2/1 3/1", "expected ids of its 0 vertices"),
    "a mesh of words": ("head_template.obj", "vt 0 zero", "line 1: expected numbers after vt"),
}  # fmt: skip


@pytest.mark.parametrize("name", COMPANION_FAULTS)
def test_a_companion_that_is_broken_is_named(folder, name):
    file, content, said = COMPANION_FAULTS[name]
    path = folder / file
    path.unlink(missing_ok=True)
    if path.suffix == ".npz":
        np.savez(path, **content)
    elif path.suffix == ".npy":
        np.save(path, content)
    elif path.suffix == ".pkl":
        path.write_bytes(pickle.dumps(content))
    else:
        path.write_text(content)
    message = refused(folder / "flame2023.npz")
    assert str(path) in message
    assert said in message


def test_masks_saved_as_lists_are_the_same(tmp_path):
    """Scripts that think in JSON write a number as an operation of its own, and there are thousands."""
    masks = {name: np.arange(count) for name, count in MASK_SIZES.items()}
    found = []
    for name, content in (("arrays", masks), ("lists", {name: ids.tolist() for name, ids in masks.items()})):
        (tmp_path / name).mkdir()
        (tmp_path / name / "FLAME_masks.pkl").write_bytes(pickle.dumps(content, 4))
        found.append(read_masks(tmp_path / name, vertices=5023))
    arrays, lists = found
    assert arrays.keys() == lists.keys()
    for name, ids in arrays.items():
        np.testing.assert_array_equal(lists[name], ids)
