"""What libraries of others read in the splats that ``samira-warp export`` writes, in the avatar's axes.

Each function needs its library, reads a file, and gives what it understood: for tests, and for
tools/export_table.py, which draws it.
"""

from __future__ import annotations

import json
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

SH_DEGREE_0 = 0.5 / np.sqrt(np.pi)


class ReadSplats(NamedTuple):
    """N splats in the avatar's axes: x to the head's left, y up, z to the front.

    Attributes:
        means: (N, 3) metres.
        quaternions: (N, 4) w, x, y, z.
        scales: (N, 3) metres.
        opacities: (N,) 0 to 1.
        colors: (N, 3) display values.
    """

    means: np.ndarray
    quaternions: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray


def _activated(
    means: np.ndarray,
    quaternions: np.ndarray,
    log_scales: np.ndarray,
    logits: np.ndarray,
    harmonics: np.ndarray,
) -> ReadSplats:
    """Splats from the values that are kept before their activations, as .ply and most libraries have them."""
    opacities = 1.0 / (1.0 + np.exp(-np.asarray(logits, np.float64)))
    return ReadSplats(means, quaternions, np.exp(log_scales), opacities, 0.5 + SH_DEGREE_0 * harmonics)


def _up_back(splats: ReadSplats) -> ReadSplats:
    """From y down and z to the back: every rotation matrix is multiplied by diag(1, -1, -1) from the left."""
    w, x, y, z = splats.quaternions.T
    turned = np.stack([-x, w, -z, y], axis=1)
    return splats._replace(means=splats.means * [1, -1, -1], quaternions=turned)


def gsply_ply(path: Path) -> ReadSplats:
    """A .ply by gsply."""
    import gsply

    read = gsply.plyread(str(path))
    return _up_back(_activated(read.means, read.quats, read.scales, read.opacities, read.sh0))


def plyfile_ply(path: Path) -> ReadSplats:
    """A .ply with the columns of 3D Gaussian splatting, by plyfile."""
    from plyfile import PlyData

    vertex = PlyData.read(str(path))["vertex"]

    def columns(stem: str, names: str) -> np.ndarray:
        return np.stack([vertex[f"{stem}{name}"] for name in names], axis=1).astype(np.float64)

    harmonics, scales = columns("f_dc_", "012"), columns("scale_", "012")
    return _up_back(
        _activated(columns("", "xyz"), columns("rot_", "0123"), scales, vertex["opacity"], harmonics)
    )


def gsply_spz(path: Path) -> ReadSplats:
    """A .spz by gsply, which turns nothing."""
    import gsply

    threads = torch.get_num_threads()
    read = gsply.read_spz(path)
    torch.set_num_threads(threads)  # numba takes as many as there are cores, for torch as well
    return _activated(read.means, read.quats, read.scales, read.opacities, read.sh0)


def splat_transform(path: Path, program: str = "splat-transform") -> ReadSplats:
    """A .ply or .spz by PlayCanvas' splat-transform, which turns neither on its way to a .ply."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.ply"
        command = [program, "--quiet", str(path), str(copy)]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        read = plyfile_ply(copy)
    # of a .spz it hands on RUB as it is, for which `plyfile_ply` took RDF: that turn is its own inverse
    return read if path.suffix == ".ply" else _up_back(read)


def pygltflib_glb(path: Path) -> ReadSplats:
    """A .glb with KHR_gaussian_splatting by pygltflib, as the extension's text says what is in it."""
    import pygltflib

    document = pygltflib.GLTF2.load_binary(str(path))
    primitive = document.meshes[0].primitives[0]
    binary = document.binary_blob()

    def values(semantic: str) -> np.ndarray:
        accessor = document.accessors[getattr(primitive.attributes, semantic)]
        view = document.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        kind = {pygltflib.FLOAT: "<f4", pygltflib.UNSIGNED_SHORT: "<u2"}[accessor.componentType]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        flat = np.frombuffer(binary, kind, accessor.count * width, start)
        return flat.reshape(-1, width).astype(np.float64)

    prefix = "KHR_gaussian_splatting:"
    x, y, z, w = values(f"{prefix}ROTATION").T
    return ReadSplats(
        values("POSITION"),
        np.stack([w, x, y, z], axis=1),
        values(f"{prefix}SCALE"),
        values(f"{prefix}OPACITY")[:, 0],
        0.5 + SH_DEGREE_0 * values(f"{prefix}SH_DEGREE_0_COEF_0"),
    )


def glb_document(path: Path) -> dict[str, object]:
    """The JSON of a .glb, by its header alone."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document: dict[str, object] = json.loads(content[20 : 20 + length])
    return document


def usd_stage(path: Path) -> ReadSplats:
    """A .usdc, .usda or .usdz by usd-core's typed getters, value by value, not by its buffers."""
    from pxr import Usd, UsdVol

    stage = Usd.Stage.Open(str(path))
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    prim = field.GetPrim()
    turns = [(q.real, *q.imaginary) for q in prim.GetAttribute("orientations").Get()]
    harmonics = np.array(prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    return ReadSplats(
        np.array(prim.GetAttribute("positions").Get()),
        np.array(turns),
        np.array(prim.GetAttribute("scales").Get()),
        np.array(prim.GetAttribute("opacities").Get()),
        0.5 + SH_DEGREE_0 * harmonics,
    )
