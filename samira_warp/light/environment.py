"""Environment maps: read from a file, or taken from a learned light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO
import torch

from samira_warp.camera import Camera
from samira_warp.errors import UserError
from samira_warp.kernels.cubemap_lookup import sample_cubemap
from samira_warp.light.equirect import equirect_to_cube
from samira_warp.light.filtered import FilteredLight
from samira_warp.validation import check_tensor


@dataclass(frozen=True)
class Environment:
    """A distant light all around.

    Attributes:
        diffuse: (6, S, S, 3) float32 linear radiance that diffuse surfaces see.
        specular: (6, S', S', 3) float32 linear radiance that shiny surfaces and the camera see. A real light has one map for both.
    """

    diffuse: torch.Tensor
    specular: torch.Tensor

    @classmethod
    def load(cls, path: str | Path, *, rotate: float = 0.0, exposure: float = 1.0, size: int = 256) -> Environment:
        """Read an equirectangular .hdr or .exr.

        Args:
            path: The file; twice as wide as high, floating point.
            rotate: Degrees: direction d sees column 0.5 + atan2(d.x, -d.z) / (2 pi) + rotate / 360 of the map.
            exposure: Factor on the radiance.
            size: Texels along a face, divisible by 16.

        Raises:
            UserError: The file is missing, unreadable, 8-bit, not twice as wide as high, or holds values that are not finite.
        """
        radiance = equirect_to_cube(read_radiance(path), size=size, rotate=rotate) * exposure
        return cls(radiance, radiance)

    @classmethod
    def from_cubemaps(cls, diffuse: torch.Tensor, specular: torch.Tensor) -> Environment:
        """A light of two maps (6, S, S, 3) of linear radiance, such as a learned one: S even, and divisible by 16 for ``specular``."""
        check_tensor("diffuse", diffuse, shape=(6, "S", "S", 3))
        check_tensor("specular", specular, shape=(6, "S", "S", 3))
        return cls(diffuse, specular)

    def filtered(self) -> FilteredLight:
        """Irradiance and prefiltered mips. Takes a second or two for a map of 256: keep the result."""
        light = FilteredLight.of(self.diffuse, self.specular)
        # Sums over the cube's parities round to some 1e-7 of the brightest light, which may fall below 0 where no light is.
        return FilteredLight(light.irradiance.clamp(min=0), tuple(mip.clamp(min=0) for mip in light.specular))

    def background(self, camera: Camera) -> torch.Tensor:
        """(H, W, 3) linear radiance that the camera sees behind the head."""
        directions = camera.to(self.specular.device).ray_directions().to(torch.float32)
        return sample_cubemap(self.specular, directions.reshape(-1, 3)).view(directions.shape)

    def to(self, device: torch.device | str) -> Environment:
        """The same light on ``device``."""
        return Environment(self.diffuse.to(device), self.specular.to(device))


def read_radiance(path: str | Path) -> torch.Tensor:
    """(H, W, 3) float32 linear radiance of a .hdr or .exr; a single channel becomes grey, slightly negative values become 0.

    Raises:
        UserError: As `Environment.load`.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(path, expected="an .hdr or .exr file", found="no such file")
    image = OpenImageIO.ImageInput.open(str(path))
    if image is None:
        raise UserError(path, expected="an .hdr or .exr file", found=f"unreadable: {OpenImageIO.geterror()}")
    try:
        spec = image.spec()
        if spec.format.basetype not in (OpenImageIO.HALF, OpenImageIO.FLOAT, OpenImageIO.DOUBLE):
            raise UserError(
                path,
                expected="floating-point radiance (.hdr or .exr), because an 8-bit image clips the lamps and the sun that light a face",
                found=f"{spec.format} pixels",
            )
        pixels = image.read_image(0, 0, 0, spec.nchannels, OpenImageIO.FLOAT)
        if pixels is None:
            raise UserError(path, expected="a whole image", found=f"unreadable: {image.geterror()}")
    finally:
        image.close()
    if spec.width != 2 * spec.height:
        raise UserError(path, expected="an equirectangular map, twice as wide as high", found=f"{spec.width} x {spec.height}")
    radiance = torch.from_numpy(np.ascontiguousarray(_rgb(pixels, list(spec.channelnames), path), dtype=np.float32))
    if not radiance.isfinite().all():
        raise UserError(
            path, expected="finite radiance", found=f"{int((~radiance.isfinite()).sum())} values that are infinite or not numbers"
        )
    return radiance.clamp(min=0)


def _rgb(pixels: np.ndarray, names: list[str], path: Path) -> np.ndarray:
    """(H, W, 3) colour channels of pixels (H, W, channels)."""
    if all(name in names for name in "RGB"):
        return pixels[..., [names.index(name) for name in "RGB"]]
    if len(names) == 1:
        return np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=-1)
    raise UserError(path, expected="channels R, G, B or a single one", found=", ".join(names))
