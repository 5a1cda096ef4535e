"""An avatar's surface beside the true one: normals by frequency, materials, and the light that it mirrors.

usage: python tools/surface_table.py --avatar DIR --data DIR [--every N] [--json]

Test frames that the dataset has gt/normal of are rendered. Rows that need more of the truth stand where it
is, as in the built-in subject: gt/roughness and gt/specular (16 bits over 0 to 1), gt/relight/lamp, and
gt/highlights/LIGHT, the mirrored light alone. Skin is the tracked mesh's forehead, nose and cheeks.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from relight_table import Light, at_size, matte_of, print_rows, read_lights
from scipy.ndimage import gaussian_filter
from torch import Tensor

from samira_warp.avatar import Avatar, CanonicalHead, GBuffer
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.evaluate.metrics import FOREGROUND, normal_angle_map, psnr_where
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import read_image, to_uint8
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.light import FilteredLight, decode_srgb, shade
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, Surface
from samira_warp.train.skin import skin_faces

WHOLE = 254.5 / 255.0
"""Coverage of a pixel that holds nothing but the head, in 8 bits."""

LAMP = "lamp"
"""The light under which a surface's bends show."""

NOISE_SIGMA = 1.0
"""Pixels of the low-pass over mirrored light: the ray caster's pictures of it are noisy."""


@dataclass(frozen=True)
class SurfaceConfig:
    """Compare an avatar's surface with the true one."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/normal."""
    every: int = 1
    """Score every such test frame."""
    sigma: float = 3.0
    """Pixels of the Gaussian low-pass that parts the normals' form from their detail."""
    resolution: int = 256
    """Width and height of the comparison, pixels."""
    json: bool = False
    """Print JSON rows instead of a table."""


class Comparison(NamedTuple):
    """One quantity of one frame.

    Attributes:
        error: Mean distance, or dB.
        avatar: Its mean over the avatar's pixels; None where that says nothing.
        truth: The same of the truth.
    """

    error: float
    avatar: float | None = None
    truth: float | None = None


@torch.no_grad()
def main(config: SurfaceConfig) -> None:
    """A row for each quantity: its error, and the means of avatar and truth."""
    if not (config.data / "gt" / "normal").is_dir():
        raise UserError(config.data / "gt" / "normal", expected="true normals of test frames", found="none")
    avatar, sequence = Avatar.load(find_avatar(config.avatar)), open_sequence(config.data)
    skin, found = SkinMask.of(sequence), defaultdict[str, list[Comparison]](list)
    frames = [sequence.frames[index] for index in sequence.test]
    frames = [frame for frame in frames if _path(config, "normal", frame).is_file()][:: config.every]
    for frame in frames:
        seen = Seen.of(frame, avatar, skin, resolution=config.resolution)
        for what, comparison in (*of_normals(config, seen), *of_materials(config, seen)):
            found[what].append(comparison)
    for light in _relit(config.data):
        filtered = light.environment.filtered()
        for frame in frames:
            if (light.truth / f"{frame.name}.png").is_file():
                seen = Seen.of(frame, avatar, skin, resolution=config.resolution, light=filtered)
                for what, comparison in of_light(config, seen, light, avatar):
                    found[what].append(comparison)
    print_rows([_row(what, comparisons) for what, comparisons in found.items()], as_json=config.json)


def _row(what: str, comparisons: list[Comparison]) -> dict[str, str | float]:
    """Means over frames."""
    row: dict[str, str | float] = {"what": what, "pictures": str(len(comparisons))}
    for name in Comparison._fields:
        values = [getattr(comparison, name) for comparison in comparisons]
        row[name] = "" if None in values else float(np.mean(values))
    return row


class SkinMask(NamedTuple):
    """Where the tracked mesh shows skin."""

    canonical: CanonicalHead
    faces: Tensor

    @classmethod
    def of(cls, sequence: TrackedSequence) -> SkinMask:
        """The mesh of a sequence."""
        canonical = CanonicalHead.build(
            sequence.template, shape=sequence.shape, static_offset=sequence.static_offset, uv_size=64
        )
        return cls(canonical, torch.from_numpy(skin_faces(sequence.template)))

    def pixels(self, frame: Frame, camera: Camera) -> Tensor:
        """(H, W) bool."""
        vertices = self.canonical.pose(frame.parameters).vertices
        seen = vertices @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        focal, center = seen.new_tensor([camera.fx, camera.fy]), seen.new_tensor([camera.cx, camera.cy])
        points = torch.cat([focal * seen[:, :2] / seen[:, 2:] + center, seen[:, 2:]], dim=1)[None]
        raster = rasterize_mesh(points, self.canonical.topology, width=camera.width, height=camera.height)
        face = raster.face[0].long()
        return (face >= 0) & self.faces[face.clamp(min=0)]


class Seen(NamedTuple):
    """A frame as the avatar shows it.

    Attributes:
        frame: Which.
        camera: The view.
        gbuffer: The avatar's surface, with what of the light arrives there.
        image: (H, W, 3) display values on white.
        mask: (H, W) true coverage.
        skin: (H, W) bool: nothing but skin there, of the mesh, the truth and the avatar.
        light: What it is lit by; None is the learned light.
    """

    frame: Frame
    camera: Camera
    gbuffer: GBuffer
    image: Tensor
    mask: Tensor
    skin: Tensor
    light: FilteredLight | None

    @classmethod
    def of(
        cls,
        frame: Frame,
        avatar: Avatar,
        skin: SkinMask,
        *,
        resolution: int,
        light: FilteredLight | None = None,
    ) -> Seen:
        """Render a frame."""
        camera = frame.camera.resized(width=resolution, height=resolution)
        rendering, mask = avatar.render(frame.parameters, camera, light), matte_of(frame, resolution)
        whole = (mask > WHOLE) & (rendering.gbuffer.alpha[..., 0] > FOREGROUND)
        return cls(
            frame,
            camera,
            rendering.gbuffer,
            rendering.image,
            mask,
            skin.pixels(frame, camera) & whole,
            light,
        )


def of_normals(config: SurfaceConfig, seen: Seen) -> Iterator[tuple[str, Comparison]]:
    """Angles in degrees over the foreground: of the whole, of its low-pass, and of what that takes away."""
    stored = read_image(_path(config, "normal", seen.frame), channels=3)
    truth = torch.nn.functional.normalize(2.0 * at_size(stored, config.resolution) - 1.0, dim=-1)
    normal, inside = seen.gbuffer.normal, seen.mask > FOREGROUND
    yield "normals, degrees", Comparison(float(normal_angle_map(normal, truth)[inside].mean()))
    ours, theirs = (low_pass(layer, inside, config.sigma) for layer in (normal, truth))
    low = normal_angle_map(ours, theirs)[inside].mean()
    yield f"normals below {config.sigma:g} px, degrees", Comparison(float(low))
    detail, true_detail = normal - ours, truth - theirs
    lengths = (_degrees(layer, inside) for layer in (detail - true_detail, detail, true_detail))
    yield "what that takes away, degrees", Comparison(*lengths)


def of_materials(config: SurfaceConfig, seen: Seen) -> Iterator[tuple[str, Comparison]]:
    """Roughness and reflectance at normal incidence over skin, times 100."""
    for layer, name in (("roughness", "roughness"), ("specular", "reflectance")):
        path = _path(config, layer, seen.frame)
        if path.is_file():
            truth = at_size(read_image(path, channels=1), config.resolution)
            yield f"{name} of skin, x 100", _over_skin(seen, getattr(seen.gbuffer, layer), truth)


def of_light(
    config: SurfaceConfig, seen: Seen, light: Light, avatar: Avatar
) -> Iterator[tuple[str, Comparison]]:
    """What relit skin looks like, and what of it is mirrored."""
    if light.name == LAMP:
        truth = at_size(read_image(light.truth / f"{seen.frame.name}.png", channels=3), config.resolution)
        shown = torch.from_numpy(to_uint8(seen.image.numpy())).float() / 255.0
        yield "skin under the lamp, dB", Comparison(float(psnr_where(shown, truth, seen.skin)))
    path = config.data / "gt" / "highlights" / light.truth.name / f"{seen.frame.name}.png"
    if path.is_file():
        truth = decode_srgb(at_size(read_image(path, channels=3), config.resolution))
        mirrored = mirrored_light(seen).clamp(0.0, 1.0)
        smooth = (low_pass(layer, seen.skin, NOISE_SIGMA) for layer in (mirrored, truth))
        yield f"light that skin mirrors, {light.name}, x 100", _over_skin(seen, *smooth)


def mirrored_light(seen: Seen) -> Tensor:
    """(H, W, 3) linear specular radiance: the shading of a black surface."""
    flat = {name: getattr(seen.gbuffer, name).flatten(0, 1) for name in CHANNELS}
    flat["albedo"] = torch.zeros_like(flat["albedo"])
    assert seen.light is not None
    views = -seen.camera.ray_directions().flatten(0, 1)
    return shade(Surface.of(**flat), views, seen.light).color.unflatten(0, seen.mask.shape)


def low_pass(layer: Tensor, where: Tensor, sigma: float) -> Tensor:
    """(H, W, C) Gaussian means over the pixels (H, W) that count; 0 where none is near."""
    weights = where.float()[..., None].numpy()
    spread = (sigma, sigma, 0.0)
    blurred = gaussian_filter(layer.numpy() * weights, spread)
    return torch.from_numpy(blurred / np.maximum(gaussian_filter(weights, spread), 1e-6))


def _over_skin(seen: Seen, ours: Tensor, theirs: Tensor) -> Comparison:
    """Mean distance and means over skin, times 100."""
    of_ours, of_theirs = ours[seen.skin], theirs[seen.skin]
    means = ((of_ours - of_theirs).abs().mean(), of_ours.mean(), of_theirs.mean())
    return Comparison(*(100.0 * float(mean) for mean in means))


def _degrees(difference: Tensor, where: Tensor) -> float:
    """Mean length of differences of unit vectors, as small angles."""
    return float(torch.rad2deg(difference.norm(dim=-1)[where].mean()))


def _relit(data: Path) -> Iterator[Light]:
    """The lights that are not the film's own and that a row is about."""
    if (data / "gt" / "relight").is_dir():
        for light in read_lights(data):
            if light.name == LAMP or (data / "gt" / "highlights" / light.truth.name).is_dir():
                yield light


def _path(config: SurfaceConfig, layer: str, frame: Frame) -> Path:
    return config.data / "gt" / layer / f"{frame.name}.png"


if __name__ == "__main__":
    sys.exit(run(main, SurfaceConfig, program="python tools/surface_table.py"))
