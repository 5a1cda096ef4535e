"""A tracked film as a dataset, in the layout of VHAP's export."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

from samira_warp.data.appearance import APPEARANCE_FILE
from samira_warp.data.joints import FLAME_KEYS, OTHER_KEY
from samira_warp.data.landmarks import LANDMARKS_FILE
from samira_warp.data.mattes import read_matte
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.head import FrameParameters, HeadTemplate, Rig
from samira_warp.head.joints import FLAME_JOINTS
from samira_warp.head.template import save_template
from samira_warp.io.images import write_png
from samira_warp.prepare.own_tracking import Filmed, Fit, camera_of
from samira_warp.vision.faces import FaceTrack
from samira_warp.vision.mattes import above_line

TEST_SHARE = 0.2
"""Of the frames, the last ones: they are not trained on."""

NECK_MASK = "boundary"
"""Vertices of a head's lower rim, where its neck ends."""

NECK_MARGIN = 0.06
"""Of the face's height above the rim, so that the rim's own shape does not show."""


def export(
    template: HeadTemplate,
    fit: Fit,
    filmed: Filmed,
    faces: FaceTrack,
    folder: Path,
    *,
    keep_shoulders: bool,
) -> None:
    """Write a dataset.

    Args:
        template: The head.
        fit: Its tracking.
        filmed: The film.
        faces: What is seen in its frames.
        folder: Where to; it exists, and is empty.
        keep_shoulders: Whether mattes keep what is below the neck.

    Raises:
        UserError: A picture cannot be read.
        OSError: A file cannot be written.
    """
    for name in ("images", "fg_masks", "flame_param"):
        (folder / name).mkdir()
    save_template(template, folder / "template.npz")
    subject: dict[str, Any] = {"shape": fit.shape.numpy(), "static_offset": fit.static_offset.numpy()[None]}
    rest = Rig.build(template).rest()
    np.savez(folder / CANONICAL_FILE, **parameter_arrays(template, rest), **subject)
    necks = None if keep_shoulders else _neck_lines(template, fit, filmed)
    for number, (picture, matte) in enumerate(zip(filmed.pictures, filmed.mattes, strict=True)):
        np.savez(
            folder / "flame_param" / f"{number:05d}.npz",
            **parameter_arrays(template, fit.parameters[number]),
            shape=subject["shape"],
        )
        shutil.copyfile(picture, folder / "images" / f"{_stem(number)}{picture.suffix}")
        coverage = read_matte(matte)
        if necks is not None:
            coverage = above_line(coverage, *necks[number])
        write_png(folder / "fg_masks" / f"{_stem(number)}.png", coverage)
    _write_lists(folder, filmed, fit)
    np.savez(
        folder / LANDMARKS_FILE,
        landmarks=faces.landmarks,
        irises=faces.irises[:, ::-1],
        seen=faces.seen,
        stems=np.array([_stem(number) for number in range(len(filmed.pictures))]),
    )
    np.savez(folder / APPEARANCE_FILE, albedo=fit.albedo.numpy(), light=fit.light.numpy())


def _stem(number: int) -> str:
    return f"{number:05d}_00"


def parameter_arrays(template: HeadTemplate, parameters: FrameParameters) -> dict[str, Any]:
    """A frame as VHAP writes it: numpy arrays by name; joints that FLAME lacks by their own."""
    turns = dict(zip(("root", *template.joint_names[1:]), parameters.rotations.numpy(), strict=True))
    zero = np.zeros(3, np.float32)
    poses = {
        key: np.concatenate([turns.get(name, zero) for name in names])[None]
        for key, names in FLAME_KEYS.items()
    }
    others = {f"{OTHER_KEY}{name}": turn[None] for name, turn in turns.items() if name not in FLAME_JOINTS}
    return {
        "translation": parameters.translation.numpy()[None],
        "expr": parameters.expression.numpy()[None],
        **poses,
        **others,
    }


def _write_lists(folder: Path, filmed: Filmed, fit: Fit) -> None:
    """transforms.json of all frames, and of those to train on and to test on."""
    camera = camera_of(filmed.view, fit.focal)
    to_world = torch.linalg.inv(camera.world_to_camera.double()).numpy()
    to_world[:, 1:3] *= -1.0  # OpenGL's axes
    shared = {
        "cx": camera.cx,
        "cy": camera.cy,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "w": camera.width,
        "h": camera.height,
        "camera_angle_x": 2.0 * math.atan(0.5 * camera.width / camera.fx),
        "camera_angle_y": 2.0 * math.atan(0.5 * camera.height / camera.fy),
    }
    entries = [
        {
            "timestep_index": number,
            "timestep_index_original": filmed.numbers[number],
            "timestep_id": f"{number:05d}",
            "camera_index": 0,
            "camera_id": "00",
            **shared,
            "transform_matrix": to_world.tolist(),
            "file_path": f"images/{_stem(number)}{picture.suffix}",
            "fg_mask_path": f"fg_masks/{_stem(number)}.png",
            "flame_param_path": f"flame_param/{number:05d}.npz",
        }
        for number, picture in enumerate(filmed.pictures)
    ]
    held = max(round(TEST_SHARE * len(entries)), 1)
    parts = {"": entries, "_train": entries[:-held], "_test": entries[-held:], "_val": []}
    for part, chosen in parts.items():
        text = json.dumps({**shared, "frames": chosen}, indent=1)
        (folder / f"transforms{part}.json").write_text(text, encoding="utf-8")


def _neck_lines(
    template: HeadTemplate, fit: Fit, filmed: Filmed
) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """Two points of the line under which each frame's matte ends; None where a head's rim is not known.

    The line is the one that best goes through the rim's near half, as it is seen, and a little above it.
    """
    rim = template.masks.get(NECK_MASK)
    face = template.masks.get("face")
    if rim is None or face is None:
        return None
    rig, lines = Rig.build(template), []
    for number in range(len(filmed.pictures)):
        head = rig.pose(fit.parameters[number], fit.shape, fit.static_offset)
        points = filmed.view.in_camera(head.vertices)
        pixels = filmed.view.project(points, fit.focal).double().numpy()
        depth = points[rim, 2].numpy()
        near = pixels[rim][depth <= np.median(depth)]
        slope, height = np.polyfit(near[:, 0], near[:, 1], 1)
        height -= NECK_MARGIN * np.ptp(pixels[face][:, 1])
        left, right = 0.0, float(filmed.view.width)
        lines.append((np.array([left, height]), np.array([right, slope * right + height])))
    return lines
