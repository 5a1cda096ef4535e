"""``glb``: read by pygltflib and trimesh, posed by glTF's formulas, its textures against the avatar."""

import numpy as np
import pytest
import torch
import trimesh
from gltf_reader import Glb
from sources import made_source, with_template
from subjects import small_avatar

from samira_warp.export.__main__ import command
from samira_warp.export.baking import bake, chosen_frames
from samira_warp.export.glb import write
from samira_warp.export.mesh import SplitMesh, tangent_frames
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.light import decode_srgb

SIZE = 64
ROUNDING = 2.0**-24
"""Relative error of one float32 number."""


def correctives(template):
    """(V, 3, 9 (J - 1)) random, of a millimetre."""
    shape = template.posedirs.shape
    return np.random.default_rng(0).normal(scale=1e-3, size=shape).astype(np.float32)


@pytest.fixture(scope="module")
def source():
    """A head whose expressions move its joints, with correctives, of three frames."""
    avatar = small_avatar(perturb=0.2)
    template = avatar.canonical.template
    regressor = np.full_like(template.joint_regressor, 1.0 / len(template.v_template))
    regressor[2:] = template.joint_regressor[2:]
    with_template(avatar, posedirs=correctives(template), joint_regressor=regressor)
    return made_source(avatar, texture_size=SIZE)


@pytest.fixture(scope="module")
def path(source, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "head.glb"
    assert "3 frames, textures of 64 texels" in write(source, path)
    return path


@pytest.fixture(scope="module")
def glb(path):
    return Glb(path)


@pytest.fixture(scope="module")
def mesh(source):
    return SplitMesh.of(source.avatar.canonical.template)


def test_the_animation_poses_the_vertices_as_the_rig_does(source, glb, mesh):
    """To the rounding of what is in the file, which is far below a micrometre.

    Along a vertex's way lie its place and its J + E + 9 (J - 1) shifts (each below 0.3 m), a turn of each of
    three joints (an error of sqrt(2) roundings, with a lever below 0.3 m), and places of joints, each twice:
    fewer than 100 roundings of 0.3 m, which add up to 1.8e-6 m if all go one way.
    """
    canonical = source.avatar.canonical
    rig = canonical.rig.to(dtype=torch.float64)
    for key, frame in enumerate(source.chosen):
        wanted = rig.pose(frame.parameters.to(dtype=torch.float64), canonical.shape.double()).vertices
        posed = glb.posed(key)
        np.testing.assert_allclose(posed, wanted[mesh.source].numpy(), rtol=0, atol=100 * 0.3 * ROUNDING)
    # the frames differ by far more than that
    assert np.abs(glb.posed(0) - glb.posed(1)).max() > 0.01


def test_joints_are_the_rigs_by_name_and_parent(source, glb):
    rig, nodes = source.avatar.canonical.rig, glb.document.nodes
    names = [nodes[joint].name for joint in glb.document.skins[0].joints]
    assert names == list(rig.joint_names)
    for joint, parent in enumerate(rig.parents):
        above = [i for i, node in enumerate(nodes) if joint in (node.children or ())]
        assert above == ([] if parent < 0 else [parent])


def test_skinning_weights_sum_to_one_and_are_the_rigs(source, glb, mesh):
    ids, weights = glb.attribute("JOINTS_0"), glb.attribute("WEIGHTS_0")
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=0, atol=4 * ROUNDING)
    whole = np.zeros((len(ids), len(source.avatar.canonical.rig.joint_names)))
    np.add.at(whole, (np.arange(len(ids))[:, None], ids), weights)
    wanted = source.avatar.canonical.template.weights[mesh.source.numpy()]
    # the template's own rows sum to 1 up to rounding
    np.testing.assert_allclose(whole, wanted, rtol=0, atol=1e-6)


def test_a_vertex_of_more_than_four_joints_has_a_second_set(tmp_path):
    avatar = small_avatar()
    weights = np.random.default_rng(0).random(avatar.canonical.template.weights.shape).astype(np.float32)
    weights /= weights.sum(axis=1, keepdims=True)
    with_template(avatar, weights=weights)
    write(made_source(avatar, frames=1, texture_size=SIZE), tmp_path / "head.glb")
    glb = Glb(tmp_path / "head.glb")
    first, second = glb.attribute("WEIGHTS_0"), glb.attribute("WEIGHTS_1")
    np.testing.assert_allclose((first + second).sum(axis=1), 1.0, rtol=0, atol=8 * ROUNDING)
    assert (first.min(axis=1) >= second.max(axis=1)).all()
    assert (second[:, 1:] == 0.0).all()


def test_morph_targets_are_the_templates_by_name(source, glb, mesh):
    template = source.avatar.canonical.template
    names = glb.document.meshes[0].extras["targetNames"]
    expressions = list(template.expression_names)
    assert names[: len(expressions)] == expressions
    assert names[len(expressions)] == "neck 00"
    shapes = np.concatenate([template.shapedirs[:, :, template.n_shape :], template.posedirs], axis=2)
    assert len(names) == shapes.shape[2]
    np.testing.assert_array_equal(glb.targets(), shapes.transpose(2, 0, 1)[:, mesh.source.numpy()])


def test_normals_of_targets_are_those_of_the_shaped_head(source, glb, mesh):
    canonical = source.avatar.canonical
    shape = torch.from_numpy(canonical.template.shapedirs[:, :, canonical.template.n_shape].copy())
    shaped = vertex_normals(canonical.vertices + shape, mesh.head_faces)[mesh.source]
    found = glb.attribute("NORMAL") + glb.targets("NORMAL")[0]
    lit = shaped.norm(dim=1) > 0.5
    # two float32 unit vectors were subtracted, and added again
    np.testing.assert_allclose(found[lit], shaped[lit].numpy(), rtol=0, atol=4 * ROUNDING)


def test_trimesh_reads_the_same_head(source, path, mesh):
    (read,) = trimesh.load(path, process=False).geometry.values()
    np.testing.assert_array_equal(read.vertices, source.avatar.canonical.vertices[mesh.source].numpy())
    np.testing.assert_array_equal(read.faces, mesh.faces.numpy())
    np.testing.assert_allclose(read.visual.uv, mesh.uv.numpy(), rtol=0, atol=ROUNDING)
    material = read.visual.material
    assert material.metallicFactor == 0.0
    assert material.roughnessFactor == 1.0
    assert material.baseColorTexture.size == (SIZE, SIZE)


def test_tangents_are_unit_and_across_the_normals(glb):
    tangents, normals = glb.attribute("TANGENT"), glb.attribute("NORMAL")
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1.0, rtol=0, atol=1e-6)
    np.testing.assert_allclose((tangents[:, :3] * normals).sum(axis=1), 0.0, rtol=0, atol=1e-5)
    assert set(np.unique(tangents[:, 3])) <= {-1.0, 1.0}


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangent_frames_of_a_plane(mirrored):
    """A square in x and z whose u grows along x, or against it, and v along -z: its normal is y."""
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    faces = torch.tensor([[0, 2, 1], [0, 3, 2]])
    u = 1.0 - vertices[:, 0] if mirrored else vertices[:, 0]
    mesh = SplitMesh(torch.arange(4), torch.stack([u, 1.0 - vertices[:, 2]], dim=1), faces, faces)
    frames = tangent_frames(vertices, mesh)
    along = -1.0 if mirrored else 1.0
    assert frames.normals.tolist() == [[0.0, 1.0, 0.0]] * 4
    assert frames.tangents.tolist() == [[along, 0.0, 0.0]] * 4
    assert frames.bitangents.tolist() == [[0.0, 0.0, -1.0]] * 4


def test_textures_of_an_even_avatar_are_even(mesh):
    """One material on every Gaussian and normals of the mesh: all texels have that, and (0, 0, 1)."""
    avatar = small_avatar(gaussians=600, residual=False)
    with torch.no_grad():
        avatar.gaussians.albedo_logits[:] = torch.tensor([0.5, -0.5, -1.0])
        avatar.gaussians.roughness_logits[:] = 0.3
        avatar.gaussians.specular_logits[:] = -1.0
    textures = bake(avatar, made_source(avatar).frames, mesh, size=SIZE)
    own = avatar.gaussians
    for found, value in (
        (decode_srgb(textures.base_color), own.albedo[0]),
        (textures.roughness, own.roughness[0]),
        (textures.specular, own.specular[0]),
    ):
        # sums of the blended weights end in other bits than alpha, and are divided by it
        torch.testing.assert_close(found, value.detach().expand_as(found), rtol=1e-4, atol=1e-5)
    # facets of 10 degrees on a coarse ball: Gaussians blend over several of them, and over edges of charts
    assert textures.normal[..., 2].median() > np.cos(np.radians(20.0))
    # barycentric weights sum to 1 up to rounding
    assert float(textures.occlusion.min()) >= 0.05 - 4 * ROUNDING
    assert float(textures.occlusion.max()) <= 1.0 + 4 * ROUNDING


def test_a_texture_has_its_colours_in_their_places(mesh):
    """Albedo that rises with the height at rest: texels have that of their own place on the mesh."""
    from samira_warp.export.baking import Texels

    avatar = small_avatar(gaussians=3000, residual=False)
    canonical = avatar.canonical

    def ramp(height):
        low, high = canonical.vertices[:, 1].min(), canonical.vertices[:, 1].max()
        return 0.2 + 0.6 * (height - low) / (high - low)

    with torch.no_grad():
        centers = canonical.vertices[canonical.topology.faces.long()].mean(dim=1)
        red = ramp(centers[avatar.gaussians.faces.long(), 1])
        avatar.gaussians.albedo_logits[:] = torch.logit(red[:, None]).expand(-1, 3)
    textures = bake(avatar, made_source(avatar).frames, mesh, size=SIZE)
    texels = Texels.of(mesh, size=SIZE)
    wanted = ramp(texels.of_vertices(canonical.vertices[mesh.source])[:, 1])
    found = decode_srgb(textures.base_color).flatten(0, 1)[texels.numbers, 0]
    error = (found - wanted).abs()
    # a face is a thirteenth of the ball high, 0.05 of the ramp, and a Gaussian about as wide
    assert float(error.median()) < 0.05
    assert float(error.quantile(0.95)) < 0.15


def test_the_material_is_the_textures(source, glb, mesh):
    material = glb.document.materials[0]
    color = glb.texture(material.pbrMetallicRoughness.baseColorTexture.index) / 255.0
    textures = bake(source.avatar, source.frames, mesh, size=SIZE)
    np.testing.assert_allclose(color, textures.base_color.clamp(0.0, 1.0), rtol=0, atol=0.51 / 255)
    packed = glb.texture(material.occlusionTexture.index) / 255.0
    np.testing.assert_allclose(packed[..., 0], textures.occlusion, rtol=0, atol=0.51 / 255)
    np.testing.assert_allclose(packed[..., 1], textures.roughness, rtol=0, atol=0.51 / 255)
    specular = material.extensions["KHR_materials_specular"]
    tint = decode_srgb(torch.from_numpy(glb.texture(specular["specularColorTexture"]["index"]) / 255.0))
    f0 = 0.04 * specular["specularColorFactor"][0] * tint[..., 0]
    torch.testing.assert_close(f0.float(), textures.specular, rtol=0.01, atol=0)


def test_frames_to_look_at_begin_with_the_most_neutral_and_differ(source):
    chosen = chosen_frames(source.frames, 5)
    assert len({frame.name for frame in chosen}) == len(chosen) == 2  # the training frames
    assert chosen[0].part == "train"


def test_the_verb_writes_it_under_no_light(saved, tmp_path, capsys):
    path = tmp_path / "head.glb"
    options = ["--avatar", str(saved), "--format", "glb", "--texture-size", "64", "--out", str(path)]
    assert command(options) == 0
    assert Glb(path).document.animations[0].name == "sequence"
    assert [file.name for file in tmp_path.iterdir()] == ["head.glb"]
    capsys.readouterr()
    for more, named in (
        (["--exposure", "2"], "--exposure: expected a format of colours under a light, found --format glb"),
        (["--texture-size", "9"], "--texture-size: expected 64 to 4096, found 9"),
        (["--frame", "1"], "--frame: expected one frame's export"),
    ):
        assert command([*options, *more]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert named in line
    ply = ["--avatar", str(saved), "--texture-size", "64", "--out", str(tmp_path / "head.ply")]
    assert command(ply) == 2
    assert "--texture-size: expected a format with textures" in capsys.readouterr().err
