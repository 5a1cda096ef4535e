"""A made-up subject in the layout of a VHAP export: a lit sphere with eyes, lips and hair that turns and
moves.

The pictures are ray-cast from the same sphere that the template's mesh approximates, so an avatar can be
trained on it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from samira_warp.io.images import read_rgba, resize_box, write_png

RADIUS = 0.1
N_SHAPE, N_EXPRESSION = 2, 4
RINGS, COLUMNS = 14, 20
# region: (direction of its centre, angle in radians within which a point belongs to it); first match wins
PATCHES = {
    "left_eye_region": ((0.4, 0.25, 0.9), 0.3),
    "right_eye_region": ((-0.4, 0.25, 0.9), 0.3),
    "mouth": ((0.0, -0.45, 0.9), 0.2),
    "lips": ((0.0, -0.45, 0.9), 0.4),
    "nose": ((0.0, 0.0, 1.0), 0.28),
    "forehead": ((0.0, 0.65, 0.75), 0.45),
    "left_ear": ((1.0, 0.0, 0.0), 0.35),
    "right_ear": ((-1.0, 0.0, 0.0), 0.35),
    "neck": ((0.0, -1.0, 0.0), 0.8),
    "face": ((0.0, -0.1, 1.0), 1.2),
    "scalp": ((0.0, 0.3, -1.0), 4.0),
}
COLOURS = {
    "left_eye_region": (0.15, 0.2, 0.3),
    "right_eye_region": (0.15, 0.2, 0.3),
    "lips": (0.6, 0.15, 0.15),
    "mouth": (0.3, 0.05, 0.05),
    "scalp": (0.2, 0.12, 0.06),
}
SKIN = (0.7, 0.45, 0.35)
LIGHT = np.array([0.4, 0.6, 0.7]) / np.linalg.norm([0.4, 0.6, 0.7])


def make_tiny_dataset(path: Path, frames: int = 6, size: int = 32, *, static_offset: bool = False) -> Path:
    """Write the dataset; the first 70 % of the frames train, and only those have a pseudo-albedo."""
    for folder in ("images", "fg_masks", "albedo", "flame_param"):
        (path / folder).mkdir(parents=True)
    template = tiny_template()
    np.savez(path / "template.npz", **template)
    rest = _parameters(
        np.zeros(3),
        np.zeros(3),
        np.zeros(N_EXPRESSION),
        len(template["v_template"]) if static_offset else None,
    )
    np.savez(path / "canonical_flame_param.npz", **rest)
    joint = template["J_regressor"][0] @ template["v_template"]
    train_count = int(0.7 * frames)
    entries = []
    for index in range(frames):
        phase = 2 * np.pi * index / frames
        rotation, translation = (
            np.array([0.1 * np.cos(phase), 0.5 * np.sin(phase), 0.0]),
            np.array([0.01, 0.005, 0.0]) * np.sin(2 * phase),
        )
        expression = 0.5 * np.sin(phase + np.arange(N_EXPRESSION))
        parameters = _parameters(
            rotation, translation, expression, len(template["v_template"]) if static_offset else None
        )
        np.savez(path / "flame_param" / f"{index:05d}.npz", **parameters)
        image, mask, albedo = _picture(size, _matrix(rotation), joint, translation)
        write_png(path / "images" / f"{index:05d}_00.png", image)
        write_png(path / "fg_masks" / f"{index:05d}_00.png", mask)
        if index < train_count:
            write_png(path / "albedo" / f"{index:05d}_00.png", albedo)
        entries.append(_entry(index, size))
    for name, part in {
        "": entries,
        "_train": entries[:train_count],
        "_test": entries[train_count:],
        "_val": [],
    }.items():
        document = {
            **_intrinsics(size),
            "timestep_indices": [entry["timestep_index"] for entry in part],
            "camera_indices": [0],
            "frames": part,
        }
        (path / f"transforms{name}.json").write_text(json.dumps(document))
    return path


def crop_to_two_shapes(path: Path) -> Path:
    """Cut a tiny dataset's pictures to three quarters: the even frames' height, the odd frames' width."""
    for listed in path.glob("transforms*.json"):
        document = json.loads(listed.read_text())
        for entry in document["frames"]:
            side, centre = ("w", "cx") if entry["timestep_index"] % 2 else ("h", "cy")
            entry[centre] -= entry[side] // 8
            entry[side] -= 2 * (entry[side] // 8)
        listed.write_text(json.dumps(document))
    for picture in sorted(path.glob("*/*.png")):
        pixels = read_rgba(picture)[0]
        cut = pixels.shape[0] // 8
        wide = int(picture.stem[:5]) % 2 == 0
        write_png(picture, pixels[cut:-cut] if wide else pixels[:, cut:-cut])
    return path


def tiny_template() -> dict[str, np.ndarray]:
    """FLAME's keys for an open sphere of RINGS x COLUMNS vertices and two small eyeballs beneath its
    surface."""
    head, head_faces, head_uv, head_uv_faces = _sphere(RINGS, COLUMNS, (0.02, 0.22, 0.98, 0.98))
    parts, faces, uvs, uv_faces = [head * RADIUS], [head_faces], [head_uv], [head_uv_faces]
    for side, chart in ((1, (0.05, 0.02, 0.25, 0.18)), (-1, (0.35, 0.02, 0.55, 0.18))):
        eye, eye_faces, eye_uv, eye_uv_faces = _sphere(4, 6, chart)
        faces.append(eye_faces + sum(map(len, parts)))
        uv_faces.append(eye_uv_faces + sum(map(len, uvs)))
        parts.append(eye * 0.012 + 0.085 * _unit(np.array([side * 0.35, 0.25, 0.9])))
        uvs.append(eye_uv)
    vertices = np.concatenate(parts)
    count, eye_count, head_count = len(vertices), len(parts[1]), len(head)
    ids = np.arange(count)
    eyeballs = {
        "left_eyeball": ids[head_count : head_count + eye_count],
        "right_eyeball": ids[head_count + eye_count :],
    }
    regions = _regions(head)
    masks = {name: ids[:head_count][regions == name] for name in PATCHES} | eyeballs
    joint_vertices = (
        masks["neck"],
        masks["neck"],
        ids[:head_count],
        masks["left_eyeball"],
        masks["right_eyeball"],
    )
    regressor, weights = np.zeros((5, count)), np.zeros((count, 5))
    for joint, members in enumerate(joint_vertices):
        regressor[joint, members] = 1 / len(members)
    weights[:, 1] = 1.0
    for joint, name in ((0, "neck"), (2, "lips"), (3, "left_eyeball"), (4, "right_eyeball")):
        weights[masks[name]] = np.eye(5)[joint]
    return {
        "v_template": vertices.astype(np.float32),
        "shapedirs": _shapes(vertices).astype(np.float32),
        "n_shape": np.int64(N_SHAPE),
        "posedirs": np.zeros((count, 3, 36), np.float32),
        "J_regressor": regressor.astype(np.float32),
        "kintree_table": np.array([[-1, 0, 1, 1, 1], [0, 1, 2, 3, 4]]),
        "weights": weights.astype(np.float32),
        "f": np.concatenate(faces),
        "vt": np.concatenate(uvs).astype(np.float32),
        "ft": np.concatenate(uv_faces),
        "expression_names": np.array([f"expression{index}" for index in range(N_EXPRESSION)]),
        **{f"mask_{name}": members.astype(np.int32) for name, members in masks.items()},
    }


def _sphere(rings: int, columns: int, chart: tuple[float, float, float, float]):
    """A unit sphere without its poles, seam at -z, denser round +z: vertices, outward faces, UVs in a chart
    (u0, v0, u1, v1), UV faces."""
    turns = np.linspace(-1, 1, columns + 1)
    polar, around = np.meshgrid(
        np.linspace(0.15, np.pi - 0.25, rings), np.pi * (0.6 * turns + 0.4 * turns**3), indexing="ij"
    )
    points = np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1
    )
    ring, column = (
        grid.ravel() for grid in np.meshgrid(np.arange(rings - 1), np.arange(columns), indexing="ij")
    )

    def triangles(stride: int, wrap: int):
        a, b = ring * stride + column, ring * stride + (column + 1) % wrap
        return np.concatenate([np.stack([a, a + stride, b + stride], 1), np.stack([a, b + stride, b], 1)])

    u, v = np.meshgrid(np.linspace(chart[0], chart[2], columns + 1), np.linspace(chart[3], chart[1], rings))
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    return (
        points[:, :-1].reshape(-1, 3),
        triangles(columns, columns),
        uvs,
        triangles(columns + 1, columns + 1),
    )


def _shapes(vertices: np.ndarray) -> np.ndarray:
    """(V, 3, N_SHAPE + N_EXPRESSION): wider, taller, then lips, brows and cheeks moved by some
    millimetres."""
    wide, tall = vertices * [0.1, 0, 0], vertices * [0, 0.1, 0]
    moved = []
    for centre, direction in (
        ((0, -0.4, 0.9), (0, -1, 0.3)),
        ((0, 0.6, 0.8), (0, 1, 0)),
        ((0.6, -0.2, 0.7), (0.5, 1, 0)),
        ((-0.6, -0.2, 0.7), (-0.5, 1, 0)),
    ):
        near = np.exp(-np.sum((vertices / RADIUS - _unit(np.array(centre, float))) ** 2, axis=1) / 0.1)
        moved.append(0.004 * near[:, None] * np.array(direction, float))
    return np.stack([wide, tall, *moved], axis=-1)


def _regions(directions: np.ndarray) -> np.ndarray:
    """Name of the region of each unit direction (..., 3)."""
    names = np.full(directions.shape[:-1], "scalp", dtype="U20")
    for name, (centre, angle) in reversed(PATCHES.items()):
        names[directions @ _unit(np.array(centre)) > np.cos(min(angle, np.pi))] = name
    return names


def _picture(size: int, rotation: np.ndarray, joint: np.ndarray, translation: np.ndarray):
    """Image, mask and albedo in display values: the head's sphere, turned about its root joint, four rays a
    pixel."""
    fine = 2 * size
    x, y = np.meshgrid(np.arange(fine) + 0.5 - size, np.arange(fine) + 0.5 - size)
    ray = _unit(np.stack([x, -y, np.full_like(x, -2 * 2.8 * size)], axis=-1))
    centre = rotation @ -joint + joint + translation
    from_eye = centre - np.array([0.0, 0.0, 1.0])
    along = ray @ from_eye
    under_root = along**2 - (from_eye @ from_eye - RADIUS**2)
    hit = under_root > 0
    normal = (ray * (along - np.sqrt(np.maximum(under_root, 0)))[..., None] - from_eye) / RADIUS
    names = _regions(normal @ rotation)
    albedo = np.broadcast_to(SKIN, (fine, fine, 3)).copy()
    for name, colour in COLOURS.items():
        albedo[names == name] = colour
    shading = 0.35 + 0.65 * np.maximum(normal @ LIGHT, 0.0)

    def on_white(linear: np.ndarray) -> np.ndarray:
        encoded = np.where(hit[..., None], np.maximum(linear, 0) ** (1 / 2.2), 1.0)
        return resize_box(encoded, width=size, height=size)

    return (
        on_white(albedo * shading[..., None]),
        resize_box(hit.astype(float), width=size, height=size),
        on_white(albedo),
    )


def _parameters(rotation, translation, expression, offset_vertices):
    arrays = {
        "translation": translation,
        "rotation": rotation,
        "neck_pose": np.zeros(3),
        "jaw_pose": np.zeros(3),
        "eyes_pose": np.zeros(6),
        "expr": expression,
    }
    arrays = {key: value[None].astype(np.float32) for key, value in arrays.items()} | {
        "shape": np.array([0.1, -0.1], np.float32)
    }
    if offset_vertices is not None:
        arrays["static_offset"] = np.full((1, offset_vertices, 3), 1e-4, np.float32)
    return arrays


def _intrinsics(size: int) -> dict[str, float]:
    angle = 2 * np.arctan(0.5 / 2.8)
    return {
        "cx": size / 2,
        "cy": size / 2,
        "fl_x": 2.8 * size,
        "fl_y": 2.8 * size,
        "h": size,
        "w": size,
        "camera_angle_x": angle,
        "camera_angle_y": angle,
    }


def _entry(index: int, size: int) -> dict[str, object]:
    return {
        "timestep_index": index,
        "timestep_index_original": index,
        "timestep_id": f"{index:05d}",
        "camera_index": 0,
        "camera_id": "00",
        **_intrinsics(size),
        "transform_matrix": [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 1.0],
            [0.0, 0.0, 0.0, 1.0],
        ],
        "file_path": f"images/{index:05d}_00.png",
        "fg_mask_path": f"fg_masks/{index:05d}_00.png",
        "flame_param_path": f"flame_param/{index:05d}.npz",
    }


def _matrix(axis_angle: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(axis_angle)
    if angle == 0:
        return np.eye(3)
    x, y, z = axis_angle / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
