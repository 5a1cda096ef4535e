"""A .usdc, .usda or .usdz with a ParticleField3DGaussianSplat, which OpenUSD has since 26.03.

Y is up and the unit a metre, both written, as USD's own defaults are y and a centimetre. Scales are linear
and opacities those after the sigmoid. The prim says that its colours are display values of sRGB: without a
word, USD takes colours for linear light.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch
from pxr import Sdf, Tf, Usd, UsdGeom, UsdUtils, UsdVol, Vt
from torch import Tensor

from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats
from samira_warp.geometry.rotation import quaternion_to_matrix

PRIM = "/avatar"

COLOR_SPACE = "srgb_rec709_display"
"""As the Color Interop Forum names it, and with it USD and glTF."""

REACH = 3.0
"""Standard deviations of a splat that its bounds hold."""


def write(source: ExportSource, path: Path) -> str:
    """Write the chosen frame in the kind of file that the suffix says."""
    (frame,) = source.chosen
    splats = frame_splats(source, frame)
    stage = make_stage(splats, name=frame.name)
    try:
        if path.suffix.lower() == ".usdz":
            _package(stage, path)
        else:
            stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        raise OSError(f"{path}: cannot be written ({str(error).splitlines()[-1].strip()})") from error
    return f"{len(splats.means):,} splats of frame {frame.name}"


def make_stage(splats: Splats, *, name: str) -> Usd.Stage:
    """A stage in memory with one prim, which says of which frame it is."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
    prim = field.GetPrim()
    stage.SetDefaultPrim(prim)
    prim.SetDocumentation(f"frame {name}; x to the head's left, y up, z to the front")
    Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(COLOR_SPACE)
    values = {
        "positions": Vt.Vec3fArray.FromNumpy(_array(splats.means)),
        # rows of numpy are imaginary parts first, whatever USD prints
        "orientations": Vt.QuatfArray.FromNumpy(_array(splats.quaternions.roll(-1, dims=1))),
        "scales": Vt.Vec3fArray.FromNumpy(_array(splats.scales)),
        "opacities": Vt.FloatArray.FromNumpy(_array(splats.opacities)),
        "radiance:sphericalHarmonicsDegree": 0,
        "radiance:sphericalHarmonicsCoefficients": Vt.Vec3fArray.FromNumpy(_array(splats.harmonics)),
        "extent": Vt.Vec3fArray.FromNumpy(_array(bounds(splats))),
    }
    with Sdf.ChangeBlock():
        for attribute, value in values.items():
            prim.GetAttribute(attribute).Set(value)
    return stage


def bounds(splats: Splats) -> Tensor:
    """(2, 3) the least and the greatest coordinates of what lies within `REACH` of a splat."""
    axes = quaternion_to_matrix(splats.quaternions) * splats.scales[:, None, :]
    reach = REACH * axes.square().sum(dim=2).sqrt()
    return torch.stack([(splats.means - reach).amin(dim=0), (splats.means + reach).amax(dim=0)])


def _package(stage: Usd.Stage, path: Path) -> None:
    """A .usdz: an archive, not compressed, with the stage as avatar.usdc in it."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}") as folder:
        layer = Path(folder) / "avatar.usdc"
        stage.GetRootLayer().Export(str(layer))
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(layer)), str(path))


def _array(values: Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.detach().cpu().numpy(), np.float32)
