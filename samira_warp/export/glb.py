"""A head as a mesh in a .glb (glTF 2.0): skinned, with expressions, textures and the avatar's frames.

Its material is glTF's metallic-roughness with KHR_materials_specular, which has a place for all that an
avatar's surface is made of: the base colour is the albedo, F0 the specular reflectance, and roughness is
perceptual in both. What a mesh does not have: Gaussians off its surface (hair is paint), the motion residual
and its wrinkles, response factors.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.export.baking import Textures, bake
from samira_warp.export.gltf import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GltfFile
from samira_warp.export.mesh import SplitMesh, tangent_frames
from samira_warp.export.rigging import RestJoints, has_correctives, joint_tracks, pose_weights, tell_offsets
from samira_warp.export.source import ExportSource
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.io.images import to_uint8
from samira_warp.light import encode_srgb

FRAMES_PER_SECOND = 25.0
"""Of the animation; `samira-warp render --video` has the same."""

TEXTURE_SIZE = 1024
"""Texels along a side, unless asked otherwise: on a face 0.4 mm, finer than what most pictures show."""

DIELECTRIC = 0.04
"""F0 of glTF's materials, which KHR_materials_specular multiplies."""

INFLUENCES = 4
"""Joints in one set of an attribute; a vertex with more has a second set, the least of them there."""


def write(source: ExportSource, path: Path) -> str:
    """Write the head with the chosen frames as its animation."""
    canonical = source.avatar.canonical
    mesh = SplitMesh.of(canonical.template)
    size = source.config.texture_size or TEXTURE_SIZE
    textures = bake(source.avatar, source.frames, mesh, size=size)
    parameters = FrameParameters.stack([frame.parameters for frame in source.chosen])
    tell_offsets(parameters)
    file = GltfFile()
    _add_head(file, canonical, mesh, textures)
    _add_animation(file, canonical, parameters)
    file.write(path)
    targets = len(target_shapes(canonical.template))
    return (
        f"{len(mesh.source):,} vertices, {len(canonical.rig.joint_names)} joints, {targets} morph targets, "
        f"{len(source.chosen)} frames, textures of {size} texels"
    )


def target_shapes(template: HeadTemplate) -> list[tuple[str, np.ndarray]]:
    """Name and (V, 3) metres of every morph target: expressions, then pose correctives if there are any.

    A corrective's weight is an entry of a joint's rotation less the identity's: "neck 01" is row 0, column 1.
    """
    expressions = template.shapedirs[:, :, template.n_shape :]
    shapes = [(name, expressions[:, :, i]) for i, name in enumerate(template.expression_names)]
    if has_correctives(template):
        places = [f"{row}{column}" for row in range(3) for column in range(3)]
        entries = [f"{name} {place}" for name in template.joint_names[1:] for place in places]
        shapes += [(name, template.posedirs[:, :, i]) for i, name in enumerate(entries)]
    return shapes


def _add_head(file: GltfFile, canonical: CanonicalHead, mesh: SplitMesh, textures: Textures) -> None:
    """The scene: nodes 0 to J - 1 are the joints, node J the mesh."""
    _add_joints(file, canonical)
    attributes, targets = _geometry(file, canonical, mesh)
    names = [name for name, _ in target_shapes(canonical.template)]
    primitive = {
        "attributes": attributes,
        "indices": file.numbers(mesh.faces.numpy().astype(np.uint32).ravel(), target=ELEMENT_ARRAY_BUFFER),
        "material": _add_material(file, textures),
    }
    shaped = {}
    if names:
        primitive["targets"] = targets
        shaped = {"weights": [0.0] * len(names), "extras": {"targetNames": names}}
    head = file.add("meshes", name="head", primitives=[primitive], **shaped)
    node = file.add("nodes", name="head mesh", mesh=head, skin=0)
    file.document["scene"] = file.add("scenes", name="avatar", nodes=[0, node])


def _add_joints(file: GltfFile, canonical: CanonicalHead) -> None:
    """The joints' nodes, the root first, and their skin."""
    rig = canonical.rig
    places = RestJoints.of(canonical).places.double()
    for joint, (name, parent) in enumerate(zip(rig.joint_names, rig.parents, strict=True)):
        place = places[joint] - (places[parent] if parent >= 0 else 0.0)
        children = [child for child, above in enumerate(rig.parents) if above == joint]
        file.add("nodes", name=name, translation=place.tolist(), children=children or None)
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(places), 1, 1))
    inverse[:, :3, 3] = -places.numpy()
    matrices = file.numbers(inverse)
    file.add("skins", joints=list(range(len(places))), skeleton=0, inverseBindMatrices=matrices)


def _geometry(
    file: GltfFile, canonical: CanonicalHead, mesh: SplitMesh
) -> tuple[dict[str, int], list[dict[str, int]]]:
    """The accessors of the head at rest, and of what each morph target adds to it."""
    vertices = canonical.vertices

    def added(values: Tensor, *, bounds: bool = False) -> int:
        return file.numbers(values.float().numpy(), bounds=bounds, target=ARRAY_BUFFER)

    rest = tangent_frames(vertices, mesh)
    attributes = {
        "POSITION": added(vertices[mesh.source], bounds=True),
        "NORMAL": added(rest.normals),
        "TANGENT": added(torch.cat([rest.tangents, rest.signs[:, None]], dim=1)),
        # v goes down in glTF
        "TEXCOORD_0": added(torch.stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]], dim=1)),
    }
    for number, (ids, weights) in enumerate(_skinning(canonical.rig.weights[mesh.source])):
        joints = file.numbers(ids.numpy().astype(np.uint16), target=ARRAY_BUFFER)
        attributes |= {f"JOINTS_{number}": joints, f"WEIGHTS_{number}": added(weights)}
    targets = []
    for _, shape in target_shapes(canonical.template):
        delta = torch.tensor(shape)
        turned = tangent_frames(vertices + delta, mesh).normals - rest.normals
        targets.append({"POSITION": added(delta[mesh.source], bounds=True), "NORMAL": added(turned)})
    return attributes, targets


def _skinning(weights: Tensor) -> Iterable[tuple[Tensor, Tensor]]:
    """(M, 4) ids of joints and (M, 4) weights, the greatest first, in as many sets as it takes."""
    most = int((weights > 0.0).sum(dim=1).max())
    sets = max(-(-most // INFLUENCES), 1)
    padded = torch.nn.functional.pad(weights, (0, max(sets * INFLUENCES - weights.shape[1], 0)))
    values, ids = padded.sort(dim=1, descending=True, stable=True)
    values, ids = values[:, : sets * INFLUENCES], ids[:, : sets * INFLUENCES]
    values = values.double() / values.double().sum(dim=1, keepdim=True)
    ids = torch.where(values > 0.0, ids, 0)
    return zip(ids.split(INFLUENCES, dim=1), values.float().split(INFLUENCES, dim=1), strict=True)


def _add_material(file: GltfFile, textures: Textures) -> int:
    """The material of the textures; its index."""

    def texture(values: Tensor, name: str) -> dict[str, int]:
        return {"index": file.texture(to_uint8(values.numpy()), name=name)}

    no_metal = torch.zeros_like(textures.roughness)
    packed = torch.stack([textures.occlusion, textures.roughness, no_metal], dim=-1)
    rough = texture(packed, "occlusion, roughness, metallic")
    strongest = float(textures.specular.max())
    f0 = encode_srgb(textures.specular / strongest)[..., None].expand(-1, -1, 3)
    specular = {
        "specularColorFactor": [strongest / DIELECTRIC] * 3,
        "specularColorTexture": texture(f0.contiguous(), "specular color"),
    }
    file.document["extensionsUsed"] = ["KHR_materials_specular"]
    return file.add(
        "materials",
        name="head",
        pbrMetallicRoughness={
            "baseColorFactor": [1.0] * 4,
            "baseColorTexture": texture(textures.base_color, "base color"),
            # a factor that is left out counts as 1: a head of metal
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
            "metallicRoughnessTexture": rough,
        },
        normalTexture=texture(0.5 * textures.normal + 0.5, "normal"),
        occlusionTexture=rough,
        # heads are open at the neck, and some at the mouth and the eyes
        doubleSided=True,
        extensions={"KHR_materials_specular": specular},
    )


def _add_animation(file: GltfFile, canonical: CanonicalHead, parameters: FrameParameters) -> None:
    """The frames, one after the other, as turns and places of the joints and weights of the morph targets."""
    tracks = joint_tracks(canonical, parameters)
    weights = parameters.expression.double()
    if has_correctives(canonical.template):
        weights = torch.cat([weights, pose_weights(parameters)], dim=1)
    times = file.numbers(
        np.arange(len(parameters), dtype=np.float32) / np.float32(FRAMES_PER_SECOND), bounds=True
    )
    mesh_node = len(canonical.rig.joint_names)
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def animate(node: int, path: str, values: Tensor) -> None:
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        output = file.numbers(values.float().numpy())
        samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})

    for joint in range(mesh_node):
        animate(joint, "rotation", tracks.rotations[:, joint])
        animate(joint, "translation", tracks.translations[:, joint])
    if weights.shape[1]:
        animate(mesh_node, "weights", weights.flatten())
    file.add("animations", name="sequence", channels=channels, samplers=samplers)
