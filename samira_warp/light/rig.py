"""A light rig: lamps from a file or from Python, and what a cubemap or a panorama shows of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from samira_warp.io.files import read_json
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light.equirect import cube_to_equirect, equirect_directions, row_solid_angles
from samira_warp.light.lamps import AreaLight, DirectionalLight, Lamp, PointLight
from samira_warp.light.polygon_coverage import polygon_coverage
from samira_warp.support.errors import UserError

KINDS: dict[str, Callable[..., AreaLight | DirectionalLight | PointLight]] = {
    "area": AreaLight,
    "directional": DirectionalLight,
    "point": PointLight,
}
"""Lamps by the name that a file has for them."""

_FINEST_PANORAMA = 512
"""Rows of a panorama beyond which lamps are drawn no finer."""


@dataclass(frozen=True)
class LightRig:
    """Lamps about a head, which is lit as if every one were seen from its centre.

    Attributes:
        lamps: At least one `PointLight`, `DirectionalLight` or `AreaLight`.

    Raises:
        UserError: There is none, or a number in one of them cannot be used.
    """

    lamps: tuple[Lamp, ...]

    def __post_init__(self) -> None:
        if not self.lamps:
            raise UserError("lamps", expected="at least one lamp", found="none")
        for index, lamp in enumerate(self.lamps):
            lamp.check(f"lamp {index}")

    @classmethod
    def load(cls, path: str | Path) -> LightRig:
        """Read a rig from JSON: ``{"lamps": [{"kind": "area", "position": [0.6, 0.5, 1], ...}, ...]}``.

        A lamp's keys are ``kind`` (area, directional or point) and the attributes of its class; those that
        have a default may be left out, and a colour that is one number is a grey. An area light may have
        ``target``, the point that it faces, in place of its ``normal``.

        Raises:
            UserError: The file is missing or no JSON object of this form, or a lamp cannot be used.
        """
        path = Path(path)
        document = read_json(path)
        _check_keys(path, document, known={"lamps"}, needed={"lamps"})
        entries = document["lamps"]
        if not isinstance(entries, list) or not entries:
            raise UserError(f"{path}, lamps", expected="a list of at least one lamp", found=_kind_of(entries))
        return cls(tuple(_read_lamp(path, index, entry) for index, entry in enumerate(entries)))

    def to_cube(self, size: int) -> Tensor:
        """(6, size, size, 3) float32 radiance, as far from all lamps as the head's centre is.

        Each lamp covers its exact share of every texel; its irradiance on a surface that faces it is exact.
        """
        areas = texel_solid_angles(size, dtype=torch.float64)
        measure = areas[..., None] * texel_directions(size, dtype=torch.float64)
        texels = torch.zeros_like(measure)
        for lamp in self.lamps:
            texels += _leveled(polygon_coverage(lamp.outline(), size=size), measure, lamp)
        return texels.float()

    def to_panorama(self, height: int) -> Tensor:
        """(height, 2 height, 3) float32 radiance, not turned (`samira_warp.light.equirect`).

        Edges are as soft as a texel of the cubemap that it is looked up in, some 180 / height degrees. The
        irradiance is exact as that of `to_cube` is; beyond 512 rows, pixels are those of 512 repeated.
        """
        rows = min(height, _FINEST_PANORAMA)
        angles = row_solid_angles(rows, 2 * rows)[:, None, None]
        measure = angles * equirect_directions(rows).double()
        panorama = torch.zeros_like(measure)
        for lamp in self.lamps:
            covered = polygon_coverage(lamp.outline(), size=max(rows // 2, 16))
            seen = cube_to_equirect(covered[..., None].float(), height=rows)[..., 0]
            panorama += _leveled(seen.double(), measure, lamp)
        panorama = panorama.float()
        if rows == height:
            return panorama
        shape = (height, 2 * height)
        return torch.nn.functional.interpolate(panorama.permute(2, 0, 1)[None], shape)[0].permute(1, 2, 0)

    def like(self, texels: Tensor) -> Tensor:
        """The rig in the layout of a map's texels, (6, S, S, 3) or (H, 2 H, 3), and on its device."""
        seen = self.to_cube(texels.shape[1]) if texels.dim() == 4 else self.to_panorama(texels.shape[0])
        return seen.to(texels.device)


def _leveled(coverage: Tensor, measure: Tensor, lamp: Lamp) -> Tensor:
    """(..., 3) radiance of a lamp at the level of its irradiance, from the share (...) of texels it covers.

    ``measure`` (..., 3) is direction times solid angle; float64.
    """
    wanted = lamp.irradiance_vector()
    found = (coverage[..., None] * measure).flatten(0, -2).sum(dim=0)
    # along the lamp's own direction, from which texels' centres may stray a little
    levels = (wanted * wanted).sum(dim=1) / (wanted @ found)
    return coverage[..., None] * levels.nan_to_num(nan=0.0)  # a colour may be 0


def _read_lamp(path: Path, index: int, entry: object) -> Lamp:
    """One lamp of a file.

    Raises:
        UserError: It is none.
    """
    subject = f"{path}, lamp {index}"
    if not isinstance(entry, dict):
        raise UserError(subject, expected="an object with a kind", found=_kind_of(entry))
    values = dict(entry)
    name = values.get("name", "")
    if not isinstance(name, str):
        raise UserError(f"{subject}, name", expected="text", found=_kind_of(name))
    subject += f" ({name})" if name else ""
    kind = values.pop("kind", None)
    if not isinstance(kind, str) or kind not in KINDS:
        found = "none" if kind is None else repr(kind)
        raise UserError(f"{subject}, kind", expected=f"one of {', '.join(KINDS)}", found=found)
    lamp_type = KINDS[kind]
    attributes = fields(lamp_type)  # type: ignore[arg-type]
    known = {field.name for field in attributes} | ({"target"} if kind == "area" else set())
    _check_keys(subject, values, known=known, needed={f.name for f in attributes if f.default is MISSING})
    if "target" in values:
        values["normal"] = _towards(subject, values)
        del values["target"]
    lamp = lamp_type(**{key: _as_value(key, value) for key, value in values.items()})
    lamp.check(subject)
    return lamp


def _towards(subject: str, values: dict[str, Any]) -> list[float]:
    """The normal of a lamp that faces a point."""
    if "normal" in values:
        raise UserError(subject, expected="a normal or a target", found="both")
    target, position = values["target"], values["position"]
    try:
        towards = [there - here for there, here in zip(target, position, strict=True)]
    except (TypeError, ValueError):
        towards = []
    if not any(towards):
        expected = "a point, three numbers, other than the lamp's own"
        raise UserError(f"{subject}, target", expected=expected, found=f"{target} for a lamp at {position}")
    return towards


def _as_value(key: str, value: object) -> object:
    """A value of the file as its attribute has it: lists as tuples, one number for a colour as a grey."""
    if key in ("radiance", "irradiance", "intensity") and isinstance(value, (int, float)):
        return (value, value, value)
    return tuple(value) if isinstance(value, list) else value


def _check_keys(subject: object, values: dict[str, Any], *, known: set[str], needed: set[str]) -> None:
    """Raise UserError where a key is missing or not known."""
    for key in sorted(needed - set(values)):
        raise UserError(subject, expected=f"{key!r} in it", found=", ".join(map(repr, values)) or "nothing")
    for key in sorted(set(values) - known):
        raise UserError(subject, expected=f"only {', '.join(sorted(known))}", found=repr(key))


def _kind_of(value: object) -> str:
    """What a value of a JSON file is, shortly."""
    names = {dict: "an object", list: "a list", str: "text", bool: "true or false", type(None): "null"}
    return "an empty list" if value == [] else names.get(type(value), repr(value))
