"""A folder that any web server serves: a page that moves an avatar and draws it, with nothing to install.

The page is this package's own (`web/`), plain WebGL 2 without a library. The browser evaluates expressions,
joints and binding for every picture, as `head.rig` and `kernels.mesh` do; the light is baked into the colours
as the first frame's camera sees it. There is no network in it: of the motion residual its mean is kept.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from samira_warp.avatar import Avatar, CanonicalHead, DrivingFrame
from samira_warp.avatar.residual import quaternion_product
from samira_warp.export.rigging import RestJoints, has_correctives, tell_offsets
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import frame_splats
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.binding import bind
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.light import decode_srgb
from samira_warp.stage.face_controls import expression_controls, joint_controls
from samira_warp.stage.viewpoint import HeadPlace

FRAMES_PER_SECOND = 25.0
"""Of the sequence; `samira-warp render --video` has the same."""

AVERAGED = 16
"""Frames whose residuals are averaged."""

STEPS = 32767
"""Of a shape's greatest number, as int16: a micrometre of 30 mm."""

PAGE = ("index.html", "page.js", "avatar.js", "head.js", "splats.js")
"""The page's files, which are a part of this package."""


class BoundSplats(NamedTuple):
    """N Gaussians in the frames of their triangles.

    Attributes:
        means: (N, 3) in units of the triangle's k.
        quaternions: (N, 4) unit; w, x, y, z.
        scales: (N, 3) standard deviations in units of k.
    """

    means: Tensor
    quaternions: Tensor
    scales: Tensor


def write(source: ExportSource, folder: Path) -> str:
    """Write the page, and the avatar with the chosen frames as its sequence."""
    avatar = source.avatar
    parameters = FrameParameters.stack([frame.parameters for frame in source.chosen])
    tell_offsets(parameters)
    arrays = _head_arrays(avatar.canonical) | _splat_arrays(source) | _sequence_arrays(parameters)
    description = _description(source)
    with (folder / "avatar.bin").open("wb") as file:
        description["arrays"] = {}
        for name, values in arrays.items():
            entry = {"type": str(values.dtype), "offset": file.tell(), "shape": list(values.shape)}
            description["arrays"][name] = entry
            file.write(values.tobytes())
            file.write(bytes(-file.tell() % 4))
    (folder / "avatar.json").write_text(json.dumps(description, indent=1) + "\n", encoding="utf-8")
    for name in PAGE:
        page = resources.files("samira_warp.export") / "web" / name
        (folder / name).write_bytes(page.read_bytes())
    return f"a page of {len(avatar.gaussians):,} splats and {len(source.chosen)} frames, for any web server"


def bound_splats(avatar: Avatar, frames: Sequence[DrivingFrame]) -> BoundSplats:
    """The Gaussians of an avatar on their triangles, with the mean of its motion residual over frames."""
    means: list[torch.Tensor] = []
    quaternions: list[torch.Tensor] = []
    scales: list[torch.Tensor] = []
    for frame in frames:
        motion = avatar.move(frame.parameters)
        faces = triangle_frames(motion.head.vertices, avatar.canonical.topology)
        own = avatar.gaussians.faces.long()
        moved, k = motion.gaussians, faces.scale[own, None].clamp(min=1e-12)
        away = (moved.means - faces.translation[own]) / k
        means.append((away[:, None] @ faces.rotation[own])[:, 0])
        # what a Gaussian that is not turned in its triangle is turned by is the triangle's own turn
        still = torch.zeros_like(moved.quaternions)
        still[:, 0] = 1.0
        triangle = bind(moved.means, still, moved.scales, moved.normals, avatar.binding, faces).quaternions
        back = triangle * triangle.new_tensor([1.0, -1.0, -1.0, -1.0])
        turn = quaternion_product(back, normalize(moved.quaternions, dim=1))
        first = quaternions[0] if quaternions else turn
        quaternions.append(torch.where((turn * first).sum(dim=1, keepdim=True) < 0.0, -turn, turn))
        scales.append(moved.scales / k)
    return BoundSplats(
        torch.stack(means).mean(dim=0),
        normalize(torch.stack(quaternions).mean(dim=0), dim=1),
        torch.stack(scales).mean(dim=0),
    )


def _averaged(frames: Sequence[DrivingFrame]) -> list[DrivingFrame]:
    """Some frames, evenly through the training frames by their names."""
    known = [frame for frame in frames if frame.part == "train"] or list(frames)
    known = sorted(known, key=lambda frame: frame.name)
    places = np.linspace(0, len(known) - 1, min(AVERAGED, len(known))).round().astype(int)
    return [known[place] for place in places]


def _head_arrays(canonical: CanonicalHead) -> dict[str, np.ndarray]:
    """What poses the head, as `head.js` reads it."""
    template, rig = canonical.template, canonical.rig
    shapes = template.shapedirs[:, :, template.n_shape :]
    if has_correctives(template):
        shapes = np.concatenate([shapes, template.posedirs], axis=2)
    steps = np.abs(shapes).max(axis=(0, 1)).astype(np.float64) / STEPS
    rounded = np.round(shapes / np.where(steps > 0.0, steps, 1.0)).astype(np.int16)
    joints = RestJoints.of(canonical)
    return {
        "vertices": _float32(canonical.vertices),
        "faces": template.faces.astype(np.uint32),
        "weights": _float32(rig.weights),
        "shapes": np.ascontiguousarray(rounded.transpose(2, 0, 1)),
        "shape_scales": steps.astype(np.float32),
        "joint_places": _float32(joints.places),
        "joint_shifts": _float32(joints.shifts),
    }


def _splat_arrays(source: ExportSource) -> dict[str, np.ndarray]:
    """The Gaussians, as `splats.js` reads them; colours are blended before they are encoded."""
    avatar = source.avatar
    bound = bound_splats(avatar, _averaged(source.frames))
    shown = frame_splats(source, source.chosen[0]).colors
    encoded = avatar.settings.color_space == "srgb"
    return {
        "splat_faces": avatar.gaussians.faces.numpy().astype(np.uint32),
        "splat_means": _float32(bound.means),
        "splat_quaternions": _float32(bound.quaternions),
        "splat_scales": _float32(bound.scales),
        "splat_opacities": _float32(avatar.gaussians.opacities),
        "splat_colors": _float32(decode_srgb(shown) if encoded else shown),
    }


def _sequence_arrays(parameters: FrameParameters) -> dict[str, np.ndarray]:
    return {
        "frame_translations": _float32(parameters.translation),
        "frame_rotations": _float32(parameters.rotations),
        "frame_expressions": _float32(parameters.expression),
    }


def _description(source: ExportSource) -> dict[str, Any]:
    """What the page's files read beside the numbers."""
    avatar, rig, first = source.avatar, source.avatar.canonical.rig, source.chosen[0]
    template = avatar.canonical.template
    main, more = expression_controls(source.frames, template)
    center = HeadPlace.of(avatar.canonical, avatar.canonical.pose(first.parameters)).center
    return {
        "name": source.folder.resolve().parent.name,
        "fps": FRAMES_PER_SECOND,
        "frames": [frame.name for frame in source.chosen],
        "joints": [
            {"name": name, "parent": parent}
            for name, parent in zip(rig.joint_names, rig.parents, strict=True)
        ],
        "expressions": list(template.expression_names),
        "correctives": has_correctives(template),
        "controls": [
            control._asdict() | {"joints": [rig.joint(name) for name in control.joints]}
            for control in joint_controls(template)
        ],
        "sliders": {
            "main": [control._asdict() for control in main],
            "more": [control._asdict() for control in more],
        },
        "camera": _camera(first.camera),
        "center": center.tolist(),
        "background": [1.0, 1.0, 1.0],
        "encoded": avatar.settings.color_space == "srgb",
    }


def _camera(camera: Camera) -> dict[str, Any]:
    """A camera as `avatar.js` knows one: x right, y down, z forward, its transform by rows."""
    return {
        "worldToCamera": camera.world_to_camera.flatten().tolist(),
        **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")},
    }


def _float32(values: Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.detach().cpu().numpy(), np.float32)
