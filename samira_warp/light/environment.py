"""Environments: the distant light all around a head, read from maps or taken from a learned light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from samira_warp.geometry.camera import Camera
from samira_warp.io.images import write_exr
from samira_warp.kernels.cubemap.layout import check_cubemap, texel_solid_angles
from samira_warp.light.cross import cube_to_cross
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure, check_exposure

DIFFUSE_FILE = "light_diffuse.exr"
SPECULAR_FILE = "light_specular.exr"
"""Names of the two maps of a learned light in an avatar folder."""

DIFFUSE_MULTIPLE, SPECULAR_MULTIPLE = 2, 16
"""What the sizes of the two cubemaps must be divisible by, to be filtered (`FilteredLight.of`)."""

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""


@dataclass(frozen=True, eq=False)
class Environment:
    """A distant light all around.

    Attributes:
        diffuse: (6, S, S, 3) float32 linear radiance that diffuse surfaces see.
        specular: (6, S', S', 3) float32 linear radiance that shiny surfaces see. A real light has one map for
            both.
        backdrop: What the camera sees of it, at its file's own resolution; None is ``specular``.
    """

    diffuse: torch.Tensor
    specular: torch.Tensor
    backdrop: RadianceMap | None = None

    @classmethod
    def load(
        cls,
        path: str | Path,
        specular: str | Path | None = None,
        *,
        rotate: float = 0.0,
        exposure: Exposure = 1.0,
        size: int = 256,
        ldr: bool = False,
    ) -> Environment:
        """Read one map, or the two maps of a learned light.

        A map is an equirectangular panorama (2:1) or a cube cross (4:3 or 3:4, see
        `samira_warp.light.cross`). A cross no finer than ``size`` whose texels can be filtered as they are is
        not resampled, so a learned light that was saved comes back bit by bit.

        Args:
            path: The map; the diffuse map where ``specular`` is given; or an avatar's folder, for its learned
                light.
            specular: The map that shiny surfaces and the camera see; default the same as ``path``.
            rotate: Degrees: direction d sees column 0.5 + atan2(d.x, -d.z) / (2 pi) + rotate / 360 of a
                panorama.
            exposure: Factor of at least 0 on the radiance, or auto.
            size: Texels along a face of the resampled map, divisible by 16.
            ldr: Also take 8-bit pictures, decoded from sRGB.

        Raises:
            UserError: An argument is out of its range; a file is missing, unreadable, 8-bit, of another
                shape, or holds values that are not finite; or auto is asked of a black map.
        """
        check_exposure(exposure)
        if not math.isfinite(rotate):
            raise UserError("rotate", expected="degrees", found=rotate)
        if not isinstance(size, int) or size <= 0 or size % SPECULAR_MULTIPLE:
            raise UserError("size", expected=f"a positive multiple of {SPECULAR_MULTIPLE}", found=size)
        if specular is None and Path(path).is_dir():
            path, specular = learned_pair(path)
        diffuse_map = replace(RadianceMap.read(path, ldr=ldr), rotate=rotate)
        specular_map = (
            diffuse_map if specular is None else replace(RadianceMap.read(specular, ldr=ldr), rotate=rotate)
        )
        specular_cube = _filterable(specular_map, size=size, multiple=SPECULAR_MULTIPLE)
        diffuse_cube = (
            specular_cube
            if specular is None
            else _filterable(diffuse_map, size=size, multiple=DIFFUSE_MULTIPLE)
        )
        return cls(diffuse_cube, specular_cube, specular_map).exposed(exposure, name=path)

    @classmethod
    def from_cubemaps(cls, diffuse: torch.Tensor, specular: torch.Tensor) -> Environment:
        """A light of two maps (6, S, S, 3) of linear radiance, such as a learned one: S even, and divisible
        by 16 for ``specular``.

        Raises:
            UserError: A map is of another shape or dtype, or they are on two devices.
        """
        for name, cubemap, multiple in (
            ("diffuse", diffuse, DIFFUSE_MULTIPLE),
            ("specular", specular, SPECULAR_MULTIPLE),
        ):
            check_cubemap(name, cubemap, channels=3, device=diffuse.device)
            if cubemap.shape[1] % multiple:
                raise UserError(
                    name, expected=f"faces whose size is a multiple of {multiple}", found=cubemap.shape[1]
                )
        return cls(diffuse, specular)

    def save(self, folder: Path) -> None:
        """Write the two cubemaps into a folder as crosses of 32-bit floats, which `load` gives back bit by
        bit.
        """
        for name, cubemap in ((DIFFUSE_FILE, self.diffuse), (SPECULAR_FILE, self.specular)):
            write_exr(folder / name, cube_to_cross(cubemap.detach()).cpu().numpy())

    def filtered(self) -> FilteredLight:
        """Irradiance and prefiltered mips. Takes a second or two for a map of 256: keep the result."""
        light = FilteredLight.of(self.diffuse, self.specular)
        # Sums over the cube's parities round to some 1e-7 of the brightest light, which may fall below 0
        # where no light is.
        return FilteredLight(light.irradiance.clamp(min=0), tuple(mip.clamp(min=0) for mip in light.specular))

    def background(self, camera: Camera, *, rotate: float = 0.0) -> torch.Tensor:
        """(H, W, 3) linear radiance that the camera sees behind the head, the light turned by so many degrees
        more.
        """
        return self.visible.behind(camera, rotate=rotate)

    @property
    def visible(self) -> RadianceMap:
        """What the camera sees of the light."""
        return self.backdrop or RadianceMap(self.specular)

    def exposed(self, exposure: Exposure, *, name: object = "environment") -> Environment:
        """The light times a factor, or at the exposure ``auto``.

        Raises:
            UserError: The exposure is none, or the automatic one of a light without light is asked for;
                ``name`` is what it is called.
        """
        check_exposure(exposure)
        if exposure == "auto":
            luminance = float(
                self.mean_irradiance() @ self.diffuse.new_tensor(LUMINANCE, dtype=torch.float64)
            )
            if luminance <= 0.0:
                raise UserError(name, expected="some light, to expose automatically", found="a black map")
            exposure = 1.0 / luminance
        backdrop = None if self.backdrop is None else self.backdrop.exposed(exposure)
        return Environment(self.diffuse * exposure, self.specular * exposure, backdrop)

    def mean_irradiance(self) -> torch.Tensor:
        """(3,) float64 mean over all directions of E_d, which is the mean of the radiance that diffuse
        surfaces see.
        """
        areas = texel_solid_angles(self.diffuse.shape[1], dtype=torch.float64, device=self.diffuse.device)
        return (self.diffuse.double() * areas[..., None]).sum(dim=(0, 1, 2)) / (4.0 * math.pi)

    def to(self, device: torch.device | str) -> Environment:
        """The same light on ``device``."""
        backdrop = None if self.backdrop is None else self.backdrop.to(device)
        return Environment(self.diffuse.to(device), self.specular.to(device), backdrop)


def learned_pair(folder: str | Path) -> tuple[Path, Path]:
    """The diffuse and the specular map in an avatar's folder, or in the run folder that it is in.

    Raises:
        UserError: They are not there.
    """
    for candidate in (Path(folder), Path(folder) / "avatar"):
        pair = candidate / DIFFUSE_FILE, candidate / SPECULAR_FILE
        if all(path.is_file() for path in pair):
            return pair
    raise UserError(folder, expected=f"a learned light, {DIFFUSE_FILE} and {SPECULAR_FILE}", found="none")


def _filterable(radiance: RadianceMap, *, size: int, multiple: int) -> torch.Tensor:
    """The cubemap of a map: as it is where it can be, else at ``size``."""
    own = radiance.face_size
    as_it_is = own is not None and own <= size and own % multiple == 0 and radiance.rotate == 0.0
    return radiance.to_cube(own if as_it_is else size)
