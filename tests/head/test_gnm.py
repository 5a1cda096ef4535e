"""GNM Head by a stand-in: arrays of the shapes that its description gives, posed by its own formula."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from samira_warp.head import FrameParameters, Rig, read_head
from samira_warp.head.gnm import KEYS
from samira_warp.head.origin import EYES
from samira_warp.head.template import read_template, save_template
from samira_warp.support.errors import UserError

VERTICES, IDENTITIES, EXPRESSIONS = 150, 5, 4
NAMES = ("neck", "head", "left_eye", "right_eye")
GROUPS = ("skin", "hockey_mask", "upper_lip", "lower_lip", "left_eye", "right_eye", "tongue")


@pytest.fixture(scope="module")
def arrays():
    generator = np.random.default_rng(7)
    index = np.arange(VERTICES)
    height = 1.0 - (2.0 * index + 1.0) / VERTICES
    turn = np.pi * (1.0 + 5.0**0.5) * index
    ring = np.sqrt(1.0 - height**2)
    points = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    faces = ConvexHull(points).simplices
    points = 0.12 * points + (0.0, 0.28, 0.02)
    # the least weights that sum to 1 and give each joint
    joints = np.array([(0, 0.16, 0.0), (0, 0.24, 0.01), (0.031, 0.31, 0.09), (-0.031, 0.31, 0.09)])
    system = np.concatenate([points.T, np.ones((1, VERTICES))])
    regressor = np.stack([np.linalg.lstsq(system, np.append(joint, 1.0))[0] for joint in joints])
    identity = 0.01 * generator.standard_normal((IDENTITIES, VERTICES, 3))
    groups = np.zeros((len(GROUPS), VERTICES))
    groups[generator.integers(0, len(GROUPS), VERTICES), index] = 1.0
    uvs = np.column_stack([turn % 1.0, (1.0 + height) / 2.0])[faces]
    return {
        "version": np.array("3.0"),
        "variant": np.array("head"),
        "template_vertex_positions": points.astype(np.float32),
        "template_joint_positions": joints.astype(np.float32),
        "vertex_identity_basis": identity.astype(np.float32),
        "joint_identity_basis": (regressor @ identity).astype(np.float32),
        "expression_basis": (0.01 * generator.standard_normal((EXPRESSIONS, VERTICES, 3))).astype(np.float32),
        "identity_names": np.array([f"head_{number:03d}" for number in range(IDENTITIES)]),
        "expression_names": np.array([f"lower_face_region_{number:03d}" for number in range(EXPRESSIONS)]),
        "joint_names": np.array(NAMES),
        "joint_parent_indices": np.array([0, 0, 1, 1]),
        "joint_regressor": regressor.astype(np.float32),
        "skinning_weights": generator.dirichlet(np.ones(4), VERTICES).T.astype(np.float32),
        "pose_correctives_regressor": 0.01 * generator.standard_normal((36, 3 * VERTICES)).astype(np.float32),
        "triangles": faces.astype(np.int32),
        "triangle_uvs": uvs.astype(np.float32),
        "vertex_groups": groups.astype(np.float32),
        "vertex_group_names": np.array(GROUPS),
        "mirror_indices": index,
    }


@pytest.fixture
def path(arrays, tmp_path):
    np.savez(tmp_path / "gnm_head.npz", **arrays)
    return tmp_path / "gnm_head.npz"


def posed_by_its_formula(arrays, identity, expression, turns, translation):
    """(V, 3) float64: bases, correctives of all joints' rotations, then linear blend skinning."""
    a = {key: np.asarray(value, np.float64) for key, value in arrays.items() if value.dtype.kind in "fi"}
    vertices = a["template_vertex_positions"] + np.tensordot(identity, a["vertex_identity_basis"], 1)
    vertices = vertices + np.tensordot(expression, a["expression_basis"], 1)
    joints = a["template_joint_positions"] + np.tensordot(identity, a["joint_identity_basis"], 1)
    rotations = Rotation.from_rotvec(turns).as_matrix()
    features = (rotations - np.eye(3)).reshape(-1)
    vertices = vertices + (features @ a["pose_correctives_regressor"]).reshape(-1, 3)
    world, places = [], []
    for joint, parent in enumerate(arrays["joint_parent_indices"]):
        if joint == 0:
            world.append(rotations[0])
            places.append(joints[0] + translation)
        else:
            places.append(places[parent] + world[parent] @ (joints[joint] - joints[parent]))
            world.append(world[parent] @ rotations[joint])
    turned = [
        (vertices - joint) @ turn.T + place for joint, turn, place in zip(joints, world, places, strict=True)
    ]
    return np.einsum("jv,jvx->vx", a["skinning_weights"], np.stack(turned))


def test_it_is_posed_as_its_formula_says(arrays, path):
    """Without expression: with one, our eyes' joints go along with the lids, and its own stay."""
    template = read_head(path)
    assert template.joint_names == ("root", *NAMES)
    assert template.head_joint == "head"
    assert template.parents.tolist() == [-1, 0, 1, 2, 2]
    assert (template.n_shape, template.n_expression) == (IDENTITIES, EXPRESSIONS)
    generator = np.random.default_rng(3)
    identity, turns = generator.standard_normal(IDENTITIES), 0.3 * generator.standard_normal((4, 3))
    translation = np.array([0.1, -0.2, 0.3])
    wanted = posed_by_its_formula(arrays, identity, np.zeros(EXPRESSIONS), turns, translation)
    rig = Rig.build(template).to(dtype=torch.float64)
    parameters = FrameParameters(
        torch.from_numpy(translation),
        torch.cat([torch.zeros(1, 3, dtype=torch.float64), torch.from_numpy(turns)]),
        torch.zeros(EXPRESSIONS, dtype=torch.float64),
    )
    found = rig.pose(parameters, torch.from_numpy(identity)).vertices.numpy()
    shift = EYES - arrays["template_joint_positions"][2:].mean(axis=0)
    # float32 bases of a few centimetres, and of regressed joints
    assert np.abs(found - (wanted + shift)).max() < 1e-6


def test_expressions_are_its_own(arrays, path):
    template = read_head(path)
    for number, name in enumerate(arrays["expression_names"]):
        assert template.expression_names[number] == name
        np.testing.assert_array_equal(
            template.shapedirs[:, :, IDENTITIES + number], arrays["expression_basis"][number]
        )


def test_eyes_come_to_where_flame_has_them_and_the_root_turns_all(path):
    template = read_head(path)
    joints = template.joint_regressor.astype(np.float64) @ template.v_template
    assert np.abs(joints[3:].mean(axis=0) - EYES).max() < 1e-6
    assert np.abs(joints[0] - joints[1]).max() < 1e-6
    assert not template.weights[:, 0].any()


def test_masks_are_groups_of_it(arrays, path):
    template = read_head(path)
    groups = dict(zip(GROUPS, arrays["vertex_groups"], strict=True))
    assert set(template.masks) == {"face", "lips", "mouth", "left_eyeball", "right_eyeball"}
    np.testing.assert_array_equal(
        template.masks["lips"], np.flatnonzero(groups["upper_lip"] + groups["lower_lip"])
    )
    np.testing.assert_array_equal(template.masks["face"], np.flatnonzero(groups["hockey_mask"]))
    np.testing.assert_array_equal(template.masks["left_eyeball"], np.flatnonzero(groups["left_eye"]))


def test_coordinates_that_overlap_become_one_atlas(path):
    from samira_warp.head.uv_layout import uv_fault

    template = read_head(path)
    assert uv_fault(template.vt, template.ft) is None
    assert template.landmarks is None


def test_saved_as_a_template_it_is_the_same(path, tmp_path):
    template = read_head(path)
    save_template(template, tmp_path / "template.npz")
    assert read_template(tmp_path / "template.npz").hash == template.hash
    assert dataclasses.replace(template, landmarks=None).hash == template.hash


@pytest.mark.parametrize("key", KEYS[1:])
def test_a_key_that_is_missing_or_of_another_shape_is_named(arrays, tmp_path, key):
    rest = {name: array for name, array in arrays.items() if name != key}
    np.savez(tmp_path / "gnm_head.npz", **rest)
    with pytest.raises(UserError, match=rf"gnm_head.npz: {key}: expected an array, found no such key"):
        read_head(tmp_path / "gnm_head.npz")
    if arrays[key].dtype.kind == "U":
        return
    np.savez(tmp_path / "gnm_head.npz", **rest, **{key: arrays[key][..., :-1]})
    with pytest.raises(UserError, match=r"gnm_head.npz: \w+: expected numbers of shape"):
        read_head(tmp_path / "gnm_head.npz")


def test_joints_that_are_elsewhere(arrays, tmp_path):
    moved = arrays | {"template_joint_positions": arrays["template_joint_positions"] + np.float32(0.01)}
    np.savez(tmp_path / "gnm_head.npz", **moved)
    with pytest.raises(UserError, match=r"joint_regressor: .* found joints 10.0 mm away"):
        read_head(tmp_path / "gnm_head.npz")
