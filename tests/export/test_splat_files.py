"""Splats of every format, read by libraries of others: values, axes, pictures."""

import importlib.util
import json
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from plyfile import PlyData
from subjects import TESTS

from samira_warp.evaluate.metrics import psnr
from samira_warp.export import ExportConfig
from samira_warp.export.__main__ import command
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats
from samira_warp.light import decode_srgb

FRAME = 1

FILES = {
    "head.ply": (),
    "two.spz": ("--spz-version", "2"),
    "three.spz": ("--spz-version", "3"),
    "four.spz": ("--spz-version", "4"),
    "head.glb": ("--format", "gltf-splats"),
    "head.usdc": (),
    "head.usda": (),
    "head.usdz": (),
}


def tool(name):
    """A module of tools/."""
    sys.path.insert(0, str(TESTS.parent / "tools"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


readers = tool("splat_readers")

READERS = [
    ("head.ply", "gsply", readers.gsply_ply),
    ("head.ply", "plyfile", readers.plyfile_ply),
    ("head.ply", "splat-transform", readers.splat_transform),
    *((f"{version}.spz", "gsply", readers.gsply_spz) for version in ("two", "three", "four")),
    *((f"{version}.spz", "splat-transform", readers.splat_transform) for version in ("two", "three", "four")),
    ("head.glb", "pygltflib", readers.pygltflib_glb),
    *((f"head.{kind}", "pxr", readers.usd_stage) for kind in ("usdc", "usda", "usdz")),
]


class Exported(NamedTuple):
    """The files, and what they are of."""

    folder: Path
    splats: Splats
    own: torch.Tensor
    camera: object


@pytest.fixture(scope="module")
def exported(tiny_run, tmp_path_factory):
    """A frame of the tiny avatar under its learned light, in every kind of file."""
    folder = tmp_path_factory.mktemp("splats")
    for name, options in FILES.items():
        if name.startswith("head.usd") and importlib.util.find_spec("pxr") is None:
            continue
        words = ["--avatar", str(tiny_run), "--frame", str(FRAME), "--out", str(folder / name), *options]
        assert command(words) == 0
    with torch.no_grad():
        source = ExportSource.read(ExportConfig(avatar=tiny_run, out=folder / "head.ply", frame=FRAME))
        (frame,) = source.chosen
        own = source.avatar.render(frame.parameters, frame.camera).image
        splats = Splats(*(values.detach() for values in frame_splats(source, frame)))
        return Exported(folder, splats, own, frame.camera)


def installed(name):
    """Skip unless what reads is there."""
    if name == "splat-transform":
        if shutil.which(name) is None:
            pytest.skip("splat-transform (npm) is not installed")
    else:
        pytest.importorskip(name)


def covariances(quaternions, scales):
    """(N, 3, 3) by Rodrigues' formula of the quaternion: v + 2 w (u x v) + 2 u x (u x v), of each axis."""
    quaternions = np.asarray(quaternions, np.float64)
    quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    w, u = quaternions[:, :1, None], quaternions[:, None, 1:]
    axes = np.eye(3)[None] * np.asarray(scales, np.float64)[:, :, None]
    crossed = np.cross(u, axes)
    axes = axes + 2.0 * (w * crossed + np.cross(u, crossed))
    return np.einsum("nki,nkj->nij", axes, axes)


SPZ_SCALE = 1.0 / 32.0
"""Half a step of the logarithm of a scale."""

SPZ_TURN = {"two": 0.028, "three": 0.0042, "four": 0.0042}
"""Radians. Twice the error of the quaternion: in version 2 that of x, y, z is 1/255 each, and of w at most
(|x| + |y| + |z|) / 255 / w, which at w = 1/2 is 0.0118; 2 (3 / 255^2 + 0.0118^2)^(1/2) = 0.0272. Else that of
three is 1 / (2 sqrt(2) 511) = 0.00069, and of the largest at most 3 of it: 2 (12)^(1/2) 0.00069 = 0.0048,
which it never is, as the three cannot all be as large as the fourth but for one quaternion."""


@pytest.mark.parametrize(
    ("name", "library", "reader"), READERS, ids=[f"{name}-{by}" for name, by, _ in READERS]
)
def test_others_read_what_was_written(exported, name, library, reader):
    installed(library)
    read, splats = reader(exported.folder / name), exported.splats
    packed = name.endswith(".spz")
    # .spz: half a step of 2^-22, and float32's own; else the very numbers
    np.testing.assert_allclose(read.means, splats.means.numpy(), atol=2.4e-7 if packed else 0, rtol=0)
    logs = np.log(read.scales) - splats.scales.log().numpy()
    assert np.abs(logs).max() <= (SPZ_SCALE + 1e-5 if packed else 1e-5)
    # a level of 255, and half of another where the ends are left out
    np.testing.assert_allclose(
        read.opacities, splats.opacities.numpy(), atol=1.01 / 255 if packed else 1e-6, rtol=0
    )
    # half a byte's step, 1 / (2 0.15 255), times the harmonic
    step = 0.2821 / (2 * 0.15 * 255)
    np.testing.assert_allclose(
        read.colors, splats.colors.numpy(), atol=1.01 * step if packed else 1e-6, rtol=0
    )
    # turned by an angle t and scaled by exp(s), a covariance of largest scale L differs by (2 t + 2 s) L^2
    turn = SPZ_TURN[name.split(".")[0]] if packed else 0.0
    allowed = 2.0 * (turn + (SPZ_SCALE if packed else 0.0)) * 1.05 + 1e-4
    largest = splats.scales.numpy().max(axis=1)[:, None, None] ** 2
    difference = covariances(read.quaternions, read.scales) - covariances(splats.quaternions, splats.scales)
    assert (np.abs(difference) <= allowed * largest).all()


@pytest.mark.parametrize(
    ("name", "library", "reader"), READERS, ids=[f"{name}-{by}" for name, by, _ in READERS]
)
def test_what_others_read_draws_the_avatars_picture(exported, name, library, reader):
    installed(library)
    table = tool("export_table")
    plain = table.picture(table.before_any_file(exported.splats), exported.camera)
    drawn = table.picture(reader(exported.folder / name), exported.camera)
    # what is in bytes is off by 1/255 at most: 48 dB, and 42 if opacities do as much harm as colours
    assert psnr(drawn, plain) > (42.0 if name.endswith(".spz") else 90.0)
    # files lose less than what shading splats instead of pixels does
    own = exported.own.clamp(0.0, 1.0)
    assert psnr(drawn, own) > psnr(plain, own) - 0.3
    # and it is this head, the right way up: not its mirror image, nor upside down
    for wrong in (own.flip(0), own.flip(1)):
        assert psnr(drawn, own) > psnr(drawn, wrong) + 3.0


def test_a_ply_is_down_and_forward_and_says_so(exported):
    path = exported.folder / "head.ply"
    vertex = PlyData.read(str(path))["vertex"]
    means, normals = exported.splats.means.numpy(), exported.splats.normals.numpy()
    for column, sign, axis in (("x", 1, 0), ("y", -1, 1), ("z", -1, 2)):
        np.testing.assert_array_equal(vertex[column], sign * means[:, axis])
        np.testing.assert_array_equal(vertex[f"n{column}"], sign * normals[:, axis])
    header = path.read_bytes().split(b"end_header")[0].decode().splitlines()
    assert header[1] == "format binary_little_endian 1.0"
    assert "comment axes: x to the head's left, y down, z to the back" in header
    assert "comment SplatRenderMode: mip" in header
    assert all(line.startswith("property float ") for line in header if line.startswith("property"))


def test_the_face_of_a_file_with_y_up_looks_along_z(exported):
    """Of the splats whose normals look to the front, most lie in front: none of the axes is turned."""
    splats = exported.splats
    front = splats.normals[:, 2] > 0.7
    assert splats.means[front, 2].mean() > splats.means[~front, 2].mean()


def test_a_gltf_says_what_the_extension_asks_for(exported):
    document = readers.glb_document(exported.folder / "head.glb")
    assert document["asset"]["version"] == "2.0"
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    assert set(primitive["attributes"]) == {
        "POSITION",
        "COLOR_0",
        *(
            f"KHR_gaussian_splatting:{name}"
            for name in ("ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0")
        ),
    }
    positions = document["accessors"][primitive["attributes"]["POSITION"]]
    means = exported.splats.means.numpy()
    np.testing.assert_array_equal(np.float32(positions["min"]), means.min(axis=0))
    np.testing.assert_array_equal(np.float32(positions["max"]), means.max(axis=0))
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
    content = (exported.folder / "head.glb").read_bytes()
    assert struct.unpack_from("<4sII", content) == (b"glTF", 2, len(content))


def test_a_gltf_shows_points_in_linear_light(exported):
    """glTF's own COLOR_0 is linear, whatever the extension's colours are."""
    pygltflib = pytest.importorskip("pygltflib")
    document = pygltflib.GLTF2.load_binary(str(exported.folder / "head.glb"))
    accessor = document.accessors[document.meshes[0].primitives[0].attributes.COLOR_0]
    view = document.bufferViews[accessor.bufferView]
    assert accessor.normalized
    assert accessor.componentType == pygltflib.UNSIGNED_SHORT
    values = np.frombuffer(document.binary_blob(), "<u2", 4 * accessor.count, view.byteOffset).reshape(-1, 4)
    linear = decode_srgb(exported.splats.colors.clamp(0.0, 1.0)).numpy()
    np.testing.assert_allclose(values[:, :3] / 65535, linear, atol=1e-5)
    np.testing.assert_allclose(values[:, 3] / 65535, exported.splats.opacities.numpy(), atol=1e-5)


@pytest.mark.parametrize("kind", ["usdc", "usda", "usdz"])
def test_usd_says_its_axes_degree_bounds_and_colours(exported, kind):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(exported.folder / f"head.{kind}"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.HasAuthoredMetadata("upAxis")
    assert stage.HasAuthoredMetadata("metersPerUnit")
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree")
    assert degree.HasAuthoredValue()
    assert degree.Get() == 0
    assert len(prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get()) == len(
        exported.splats.means
    )
    assert prim.GetAttribute("colorSpace:name").Get() == "srgb_rec709_display"
    assert prim.HasAPI(Usd.ColorSpaceAPI)
    low, high = np.array(prim.GetAttribute("extent").Get())
    spread = 3 * np.sqrt(
        covariances(exported.splats.quaternions, exported.splats.scales)[:, range(3), range(3)]
    )
    means = exported.splats.means.numpy()
    np.testing.assert_allclose(low, (means - spread).min(axis=0), atol=1e-6)
    np.testing.assert_allclose(high, (means + spread).max(axis=0), atol=1e-6)
    bounds = (
        UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"]).ComputeWorldBound(prim).ComputeAlignedRange()
    )
    np.testing.assert_allclose(bounds.GetMin(), low, atol=1e-6)


def test_usd_writes_the_real_part_of_a_rotation_first(exported):
    """By the text of a .usda, without USD: arrays that are handed to it have it last."""
    pytest.importorskip("pxr")
    text = (exported.folder / "head.usda").read_text()
    (found,) = re.findall(r"quatf\[\] orientations = (\[.*?\])\n", text, flags=re.DOTALL)
    written = np.array(json.loads(found.replace("(", "[").replace(")", "]")))
    np.testing.assert_allclose(written, exported.splats.quaternions.numpy(), atol=1e-6)


def test_splat_transform_knows_how_splats_are_widened(exported, tmp_path):
    """The comment of a .ply survives it, as "mip", and so does the flag of a .spz."""
    installed("splat-transform")
    for name in ("head.ply", "two.spz", "four.spz"):
        copy = tmp_path / f"{name}.ply"
        words = ["splat-transform", "--quiet", str(exported.folder / name), str(copy)]
        subprocess.run(words, check=True, timeout=300, capture_output=True)
        assert b"SplatRenderMode: mip" in copy.read_bytes().split(b"end_header")[0]
