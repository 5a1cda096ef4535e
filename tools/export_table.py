"""Export an avatar as splats of every format, read each file by a library of others, draw what it read.

usage: python tools/export_table.py --avatar DIR [--frame N] [--pictures DIR]

Prints a table: bytes a splat, and the PSNR of the picture that this package's rasteriser draws of what was
read, against the avatar's own picture of that frame and against that of the same splats before any file. A
reader that is not installed is left out, by name. --splat-transform names its program where it is not on the
path.
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import splat_readers
import torch
from splat_readers import ReadSplats
from torch import Tensor

from samira_warp.evaluate.metrics import psnr
from samira_warp.export import ExportConfig
from samira_warp.export.formats import Format
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import write_png
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.support.cli import run


@dataclass(frozen=True)
class TableConfig:
    """Say what of a picture each splat format keeps."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    frame: int = 0
    """Which of its own frames, test frames first."""
    resolution: int = 512
    """Longer side of the pictures, pixels."""
    splat_transform: str = "splat-transform"
    """The program of that name."""
    pictures: Path | None = None
    """Also write the pictures there."""


class Row(NamedTuple):
    """A file and what reads it: its format, name, and the libraries by name."""

    format: Format
    name: str
    spz_version: Literal[2, 3, 4] | None
    readers: dict[str, Callable[[Path], ReadSplats]]


def rows(program: str) -> Iterator[Row]:
    """Every kind of file, with the readers of it that are installed; the others are said."""
    missing = {name for name in ("gsply", "pygltflib", "pxr") if importlib.util.find_spec(name) is None}
    if shutil.which(program) is None:
        missing.add("splat-transform")
    for name in sorted(missing):
        print(f"note: {name} is not installed, and left out", file=sys.stderr)

    def transformed(path: Path) -> ReadSplats:
        return splat_readers.splat_transform(path, program)

    def there(**readers: Callable[[Path], ReadSplats]) -> dict[str, Callable[[Path], ReadSplats]]:
        named = {name.replace("_", "-"): reader for name, reader in readers.items()}
        return {name: reader for name, reader in named.items() if name not in missing}

    yield Row("ply", "avatar.ply", None, there(gsply=splat_readers.gsply_ply, splat_transform=transformed))
    versions: tuple[Literal[2, 3, 4], ...] = (2, 3, 4)
    for version in versions:
        read = there(gsply=splat_readers.gsply_spz, splat_transform=transformed)
        yield Row("spz", f"version_{version}.spz", version, read)
    yield Row("gltf-splats", "avatar.glb", None, there(pygltflib=splat_readers.pygltflib_glb))
    for kind in ("usdc", "usda", "usdz"):
        yield Row("usd", f"avatar.{kind}", None, there(pxr=splat_readers.usd_stage))


def picture(splats: ReadSplats, camera: Camera) -> Tensor:
    """(H, W, 3) display values of splats on white, by this package's rasteriser."""
    values = (torch.as_tensor(value, dtype=torch.float32) for value in splats)
    means, quaternions, scales, opacities, colors = (value.contiguous() for value in values)
    blended = rasterize(means, quaternions, scales, opacities, colors.clamp(0.0, 1.0), camera)
    return blended.features + (1.0 - blended.alpha[..., None])


def before_any_file(splats: Splats) -> ReadSplats:
    """The splats of an export as a reader that loses nothing would give them."""
    values = (splats.means, splats.quaternions, splats.scales, splats.opacities, splats.colors)
    return ReadSplats(*(value.detach().numpy() for value in values))


@torch.no_grad()
def main(config: TableConfig) -> None:
    """Write, read, draw and print."""
    options = ExportConfig(avatar=config.avatar, out=Path("avatar.ply"), frame=config.frame)
    source = ExportSource.read(options)
    (frame,) = source.chosen
    camera = frame.camera.with_longer_side(config.resolution)
    own = source.avatar.render(frame.parameters, camera).image.clamp(0.0, 1.0)
    splats = frame_splats(source, frame)
    plain = picture(before_any_file(splats), camera)
    pictures = {"avatar": own, "splats": plain}
    print(f"splats before any file: {psnr(plain, own):.2f} dB against the avatar's own picture\n")
    print("| file | bytes a splat | read by | against the avatar, dB | against the splats, dB |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(config.splat_transform):
            path = Path(folder) / row.name
            _write(source, row, path)
            size = path.stat().st_size / len(splats.means)
            for name, reader in row.readers.items():
                drawn = picture(reader(path), camera)
                pictures[f"{row.name}.{name}"] = drawn
                scores = f"{psnr(drawn, own):.2f} | {psnr(drawn, plain):.1f}"
                print(f"| `{row.name}` | {size:.1f} | {name} | {scores} |", flush=True)
    if config.pictures is not None:
        config.pictures.mkdir(parents=True, exist_ok=True)
        for name, image in pictures.items():
            write_png(config.pictures / f"{name}.png", image.numpy())


def _write(source: ExportSource, row: Row, path: Path) -> None:
    """As the verb does, of an avatar that is read once."""
    options = replace(source.config, out=path, format=row.format, spz_version=row.spz_version)
    options.check()
    options.kind.writer()(replace(source, config=options), path)


if __name__ == "__main__":
    sys.exit(run(main, TableConfig, program="python tools/export_table.py"))
