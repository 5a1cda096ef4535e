"""The lights that can be picked: the learned one, the package's own, a folder's; and a lamp with each."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch

import samira_warp
from samira_warp.avatar import Avatar
from samira_warp.io.images import resize_box
from samira_warp.light import DirectionalLight, Environment, FilteredLight, LightRig, to_display
from samira_warp.light.equirect import cube_to_equirect
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.stage.lights import SHEET_SIZE, sheet_labels, sheet_paths
from samira_warp.support.errors import UserError
from samira_warp.view.recent import Recent
from samira_warp.view.state import LEARNED, Lamp, Light

PACKAGE_LIGHTS = Path(samira_warp.__file__).parent / "assets" / "lights"
"""Small maps that come with the package."""

Detail = Literal["quick", "rest", "full"]
"""How finely a map is filtered: while something moves, when it rests, and for what is kept."""

FULL_SIZE, LAMP_SIZE = 256, 64
"""Texels along a face of a map: as `Environment.load` takes it, and under a lamp that moves, for which it is
filtered in every picture."""

KEPT = 12
"""Lights that stay filtered, some megabytes each."""

THUMBNAIL = 96
"""Rows of a map's small picture."""


class Lit(NamedTuple):
    """A light as it is, before and after filtering.

    Attributes:
        environment: Turned and exposed; what is seen of it behind the head.
        filtered: What shading needs of it.
        key: Equal where the light is, but for its turn and its exposure.
    """

    environment: Environment
    filtered: FilteredLight
    key: tuple[object, ...]


class Lights:
    """Lights by name, read and filtered when they are first asked for."""

    def __init__(self, folder: Path | None = None, *, device: torch.device | str = "cpu") -> None:
        """Find the maps; none is read.

        Args:
            folder: Maps beside the package's own.
            device: Where to filter.

        Raises:
            UserError: The folder is none, or holds no maps.
        """
        self._device = torch.device(device)
        self.paths = _by_name([PACKAGE_LIGHTS, *([] if folder is None else [folder])])
        self._environments: Recent[Environment] = Recent(KEPT)
        self._filtered: Recent[tuple[Environment, FilteredLight]] = Recent(KEPT)
        self._thumbnails: dict[str, np.ndarray] = {}

    @property
    def names(self) -> list[str]:
        """The learned light and all maps."""
        return [LEARNED, *self.paths]

    def is_foreign(self, light: Light) -> bool:
        """Whether it is open how bright a light is, so that its exposure is automatic."""
        return light.name != LEARNED

    def exposure(self, avatar: Avatar, light: Light, *, detail: Detail = "full") -> float:
        """The factor on the map's radiance."""
        return self._plain(avatar, light.name, self._size(light, detail)).exposure * 2.0**light.stops

    def lit(self, avatar: Avatar, light: Light, *, detail: Detail, seen: bool = False) -> Lit:
        """A light, filtered.

        Args:
            avatar: Whose learned light is meant.
            light: Which.
            detail: How finely.
            seen: Whether it is shown behind the head as well.
        """
        size = self._size(light, detail)
        owner = avatar if light.name == LEARNED else None
        key = (owner, light.name, light.lamp, size, seen)

        def make() -> tuple[Environment, FilteredLight]:
            environment = self._with_lamp(self._plain(avatar, light.name, size), light.lamp, seen=seen)
            return environment, environment.filtered()

        environment, filtered = self._filtered.get(key, make)
        factor = 2.0**light.stops
        return Lit(
            environment.turned(light.rotate).exposed(factor),
            filtered.turned(light.rotate).exposed(factor),
            key,
        )

    def rig(self, avatar: Avatar, light: Light, *, detail: Detail = "full") -> LightRig:
        """The lamp of a light, which has one, as it is added to the map."""
        assert light.lamp is not None
        plain = self._plain(avatar, light.name, self._size(light, detail))
        return _rig(light.lamp, exposure=plain.exposure)

    def thumbnail(self, name: str, avatar: Avatar) -> np.ndarray:
        """(96, 192, 3) float32 display values of a map, as a panorama."""
        if name == LEARNED:
            learned = avatar.light.environment()
            return _panorama(RadianceMap(learned.specular.detach().cpu()))
        if name not in self._thumbnails:
            self._thumbnails[name] = _panorama(RadianceMap.read(self.paths[name]))
        return self._thumbnails[name]

    def forget(self) -> None:
        """Keep nothing of avatars that were replaced."""
        self._environments.clear()
        self._filtered.clear()

    def _size(self, light: Light, detail: Detail) -> int:
        if light.name == LEARNED:
            return 0  # its maps' own
        if detail == "full":
            return FULL_SIZE
        return LAMP_SIZE if light.lamp is not None and detail == "quick" else SHEET_SIZE

    def _plain(self, avatar: Avatar, name: str, size: int) -> Environment:
        """A map at the exposure that suits it, without a lamp, not turned."""
        if name == LEARNED:
            return self._environments.get((avatar, name), lambda: avatar.light.environment())
        path = self.paths[name]

        def read() -> Environment:
            return Environment.load(path, exposure="auto", size=size).to(self._device)

        return self._environments.get((name, size), read)

    def _with_lamp(self, environment: Environment, lamp: Lamp | None, *, seen: bool) -> Environment:
        if lamp is None:
            return environment
        if not seen:
            # the lamp need not be drawn into a map that nobody looks at
            environment = replace(environment, backdrop=None)
        return environment.with_rig(_rig(lamp, exposure=environment.exposure))


def _rig(lamp: Lamp, *, exposure: float) -> LightRig:
    """The lamp as part of a light that will be exposed by a factor."""
    azimuth, elevation = math.radians(lamp.azimuth), math.radians(lamp.elevation)
    direction = (
        math.sin(azimuth) * math.cos(elevation),
        math.sin(elevation),
        math.cos(azimuth) * math.cos(elevation),
    )
    irradiance = math.pi * lamp.strength / exposure
    return LightRig((DirectionalLight(direction, (irradiance,) * 3),))


def _by_name(folders: list[Path]) -> dict[str, Path]:
    """Maps by the names that they are picked by; a name that is taken has its folder's before it."""
    found: dict[str, Path] = {LEARNED: Path()}
    for folder in folders:
        if not folder.is_dir():
            raise UserError(folder, expected="a folder of environment maps", found="no such folder")
        maps = sheet_paths((folder,))
        if maps is None:
            raise UserError(folder, expected="a folder of environment maps", found="a learned light")
        for name, path in zip(sheet_labels(maps), maps, strict=True):
            found[name if name not in found else f"{folder.name}/{name}"] = path
    del found[LEARNED]
    return found


def _panorama(radiance: RadianceMap) -> np.ndarray:
    """A small panorama in display values, at an exposure that shows its middle tones."""
    texels = radiance.texels
    if texels.dim() == 4:
        texels = cube_to_equirect(texels, height=THUMBNAIL)
    small = resize_box(texels.numpy(), width=2 * THUMBNAIL, height=THUMBNAIL)
    grey = float(np.median(small.mean(axis=2))) or 1.0
    return (
        to_display(torch.from_numpy(0.2 / grey * small), color_space="srgb", tone_map="filmic")
        .clamp(0.0, 1.0)
        .numpy()
    )
