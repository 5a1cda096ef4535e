"""Environments: the distant light all around a head, read from maps or taken from a learned light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.io.images import write_exr
from samira_warp.kernels.cubemap.layout import check_cubemap, texel_solid_angles
from samira_warp.light.color import LUMINANCE, ColorSpace, to_display
from samira_warp.light.cross import cube_to_cross, resample_cube
from samira_warp.light.equirect import VALUES_AT_ONCE, check_degrees
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.light.rig import LightRig
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure, check_exposure
from samira_warp.support.tone_names import ToneMap
from samira_warp.support.validation import check_tensor

DIFFUSE_FILE = "light_diffuse.exr"
SPECULAR_FILE = "light_specular.exr"
"""Names of the two maps of a learned light in an avatar folder."""

DIFFUSE_MULTIPLE, SPECULAR_MULTIPLE = 2, 16
"""What the sizes of the two cubemaps must be divisible by, to be filtered (`FilteredLight.of`)."""


@dataclass(frozen=True, eq=False)
class Environment:
    """A distant light all around.

    Its maps are the light's as it was read; how it is turned and how bright it is are two numbers beside
    them. So `turned` and `exposed` copy no texel, and neither has to filter the light anew.

    Attributes:
        diffuse: (6, S, S, 3) float32 linear radiance that diffuse surfaces see.
        specular: (6, S', S', 3) float32 linear radiance that shiny surfaces see. A real light has one map for
            both.
        backdrop: What the camera sees of it, at its file's own resolution; None is ``specular``.
        rotate: Degrees by which the light is turned about the vertical: direction d sees column
            0.5 + atan2(d.x, -d.z) / (2 pi) + rotate / 360 of a panorama.
        exposure: Factor on its radiance.
    """

    diffuse: Tensor
    specular: Tensor
    backdrop: RadianceMap | None = None
    rotate: float = 0.0
    exposure: float = 1.0

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
            rotate: Degrees by which the light is turned.
            exposure: Factor of at least 0 on the radiance, or auto.
            size: Texels along a face of the resampled map, divisible by 16.
            ldr: Also take 8-bit pictures, decoded from sRGB.

        Raises:
            UserError: An argument is out of its range; a file is missing, unreadable, 8-bit, of another
                shape, or holds values that are not finite; or auto is asked of a black map.
        """
        check_exposure(exposure)
        check_degrees(rotate)
        _check_size(size)
        if specular is None and Path(path).is_dir():
            path, specular = learned_pair(path)
        diffuse_map = RadianceMap.read(path, ldr=ldr)
        specular_map = diffuse_map if specular is None else RadianceMap.read(specular, ldr=ldr)
        specular_cube = _filterable(specular_map, size=size, multiple=SPECULAR_MULTIPLE)
        diffuse_cube = (
            specular_cube
            if specular is None
            else _filterable(diffuse_map, size=size, multiple=DIFFUSE_MULTIPLE)
        )
        return cls(diffuse_cube, specular_cube, specular_map, rotate).exposed(exposure, name=path)

    @classmethod
    def from_panorama(cls, radiance: Tensor, *, size: int = 256) -> Environment:
        """A light that is a panorama in memory; what `load` makes of a file that holds it.

        Args:
            radiance: (H, 2 H, 3) float32, linear, finite, at least 0.
            size: Texels along a face of the resampled map, divisible by 16.

        Raises:
            UserError: An argument is none of these.
        """
        _check_size(size)
        check_tensor("radiance", radiance, shape=("H", "2 H", 3))
        if radiance.shape[1] != 2 * radiance.shape[0]:
            raise UserError("radiance", expected="(H, 2 H, 3)", found=tuple(radiance.shape))
        if not bool((radiance.isfinite() & (radiance >= 0)).all()):
            raise UserError("radiance", expected="finite values of at least 0", found="others")
        panorama = RadianceMap(radiance)
        cubemap = panorama.to_cube(size)
        return cls(cubemap, cubemap, panorama)

    @classmethod
    def from_cubemaps(cls, diffuse: Tensor, specular: Tensor) -> Environment:
        """A light of two maps (6, S, S, 3) of linear radiance, such as a learned one.

        S is even, and divisible by 16 for ``specular``.

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

    @classmethod
    def from_rig(cls, rig: LightRig, *, size: int = 256) -> Environment:
        """A light that is lamps alone, as far from all of them as the head's centre is.

        Args:
            rig: The lamps.
            size: Texels along a face of the map, divisible by 16.

        Raises:
            UserError: The size is none.
        """
        _check_size(size)
        cubemap = rig.to_cube(size)
        return cls(cubemap, cubemap)

    def with_rig(self, rig: LightRig) -> Environment:
        """The light with lamps added to it, which are turned and exposed as it is.

        The lamps stand where the rig says before the turn: `rotate` turns the whole light.
        """
        one_for_both = self.diffuse is self.specular
        specular = self.specular + rig.like(self.specular)
        diffuse = specular if one_for_both else self.diffuse + rig.like(self.diffuse)
        behind = self.backdrop and RadianceMap(self.backdrop.texels + rig.like(self.backdrop.texels))
        return replace(self, diffuse=diffuse, specular=specular, backdrop=behind)

    def save(self, folder: Path) -> None:
        """Write the two cubemaps as crosses of 32-bit floats, which `load` gives back bit by bit.

        A light that is turned or exposed is written so: files have texels alone.
        """
        for name, cubemap in ((DIFFUSE_FILE, self.diffuse), (SPECULAR_FILE, self.specular)):
            turned = resample_cube(cubemap.detach(), size=cubemap.shape[1], rotate=self.rotate)
            write_exr(folder / name, cube_to_cross(self.exposure * turned).cpu().numpy())

    def filtered(self) -> FilteredLight:
        """Irradiance and prefiltered mips. Takes a second or two for a map of 256: keep the result."""
        light = FilteredLight.of(self.diffuse, self.specular).with_spots(self.diffuse)
        # Sums over the cube's parities round to some 1e-7 of the brightest light, which may fall below 0
        # where no light is.
        maps = light.irradiance.clamp(min=0), tuple(mip.clamp(min=0) for mip in light.specular)
        return FilteredLight(*maps, light.radiance, self.rotate, self.exposure, light.spots)

    def background(
        self, camera: Camera, *, color_space: ColorSpace = "srgb", tone_map: ToneMap = "none"
    ) -> Tensor:
        """(H, W, 3) display values that the camera sees behind the head, 0 to 1: a background to render with.

        To see one light through many cameras, or from many sides, keep its `display_map`.

        Args:
            camera: The view, on any device.
            color_space: What the avatar's shading works in (``avatar.settings.color_space``).
            tone_map: What the avatar is shown by, so that head and light are shown alike.
        """
        shown = self.display_map(color_space=color_space, tone_map=tone_map)
        return shown.behind(camera, rotate=self.rotate)

    def display_map(self, *, color_space: ColorSpace = "srgb", tone_map: ToneMap = "none") -> RadianceMap:
        """What the camera sees of the light as display values, 0 to 1, exposed but not turned.

        Values are clipped and encoded before they are interpolated: in radiance, a texel of a lamp would
        cover all the pixels between it and its neighbours, in steps.
        """
        texels = self.visible.texels
        shown, at_once = torch.empty_like(texels), max(VALUES_AT_ONCE // texels[0].numel(), 1)
        for first in range(0, len(texels), at_once):
            some = self.exposure * texels[first : first + at_once]
            values = to_display(some, color_space=color_space, tone_map=tone_map)
            shown[first : first + at_once] = values.clamp(0.0, 1.0)
        return RadianceMap(shown)

    @property
    def visible(self) -> RadianceMap:
        """What the camera sees of the light, neither turned nor exposed."""
        return self.backdrop or RadianceMap(self.specular)

    def turned(self, degrees: float) -> Environment:
        """The light turned by so many degrees more.

        Raises:
            UserError: They are not finite.
        """
        check_degrees(degrees)
        return replace(self, rotate=self.rotate + degrees)

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
        return replace(self, exposure=self.exposure * exposure)

    def mean_irradiance(self) -> Tensor:
        """(3,) float64 mean over all directions of E_d: that of the radiance that diffuse surfaces see."""
        areas = texel_solid_angles(self.diffuse.shape[1], dtype=torch.float64, device=self.diffuse.device)
        total = (self.diffuse.double() * areas[..., None]).sum(dim=(0, 1, 2))
        return self.exposure * total / (4.0 * math.pi)

    def to(self, device: torch.device | str) -> Environment:
        """The same light on ``device``."""
        backdrop = None if self.backdrop is None else self.backdrop.to(device)
        diffuse, specular = self.diffuse.to(device), self.specular.to(device)
        return replace(self, diffuse=diffuse, specular=specular, backdrop=backdrop)


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


def _check_size(size: int) -> None:
    if not isinstance(size, int) or size <= 0 or size % SPECULAR_MULTIPLE:
        raise UserError("size", expected=f"a positive multiple of {SPECULAR_MULTIPLE}", found=size)


def _filterable(radiance: RadianceMap, *, size: int, multiple: int) -> Tensor:
    """The cubemap of a map: as it is where it can be, else at ``size``."""
    own = radiance.face_size
    as_it_is = own is not None and own <= size and own % multiple == 0
    return radiance.texels if as_it_is else radiance.to_cube(size)
