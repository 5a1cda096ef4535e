"""A .glb of splats: glTF 2.0 with KHR_gaussian_splatting, in the kernel "ellipse".

The extension's text is Khronos' (https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos). Scales are
linear, opacities those after the sigmoid, rotations x, y, z, w. What does not know the extension draws points
in COLOR_0, which glTF has in linear light.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from samira_warp import __version__
from samira_warp.export.gltf import container
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats
from samira_warp.light import decode_srgb

EXTENSION = "KHR_gaussian_splatting"

_FLOAT, _UNSIGNED_SHORT, _ARRAY_BUFFER, _POINTS = 5126, 5123, 34962, 0
"""Numbers of the glTF specification."""

_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write(source: ExportSource, path: Path) -> str:
    """Write the chosen frame."""
    (frame,) = source.chosen
    splats = frame_splats(source, frame)
    path.write_bytes(encode(splats, name=frame.name))
    return f"{len(splats.means):,} splats of frame {frame.name}"


def encode(splats: Splats, *, name: str) -> bytes:
    """The bytes of a file, whose node has a name."""
    attributes = _attributes(splats)
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    offset = 0
    for values in attributes.values():
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": _ARRAY_BUFFER}
        )
        accessors.append(_accessor(values, view=len(accessors)))
        offset += values.nbytes
    positions = attributes["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    extension = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {semantic: index for index, semantic in enumerate(attributes)},
        "mode": _POINTS,
        "extensions": {EXTENSION: extension},
    }
    document = {
        "asset": {"version": "2.0", "generator": f"samira-warp {__version__}"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    return container(document, b"".join(values.tobytes() for values in attributes.values()))


def _attributes(splats: Splats) -> dict[str, np.ndarray]:
    """Arrays by attribute, whose rows have multiples of four bytes; positions first."""
    colors = decode_srgb(splats.colors.clamp(0.0, 1.0))
    fallback = torch.cat([colors, splats.opacities[:, None]], dim=1)
    values = {
        "POSITION": splats.means,
        f"{EXTENSION}:ROTATION": splats.quaternions.roll(-1, dims=1),
        f"{EXTENSION}:SCALE": splats.scales,
        f"{EXTENSION}:OPACITY": splats.opacities[:, None],
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": splats.harmonics,
    }
    arrays = {name: value.detach().cpu().numpy().astype("<f4") for name, value in values.items()}
    arrays["COLOR_0"] = np.rint(65535.0 * fallback.detach().cpu().double().numpy()).astype("<u2")
    return arrays


def _accessor(values: np.ndarray, *, view: int) -> dict[str, Any]:
    whole = values.dtype.kind == "u"
    return {
        "bufferView": view,
        "componentType": _UNSIGNED_SHORT if whole else _FLOAT,
        "count": len(values),
        "type": _TYPES[values.shape[1]],
    } | ({"normalized": True} if whole else {})
