"""What the light is that paths name: a map, a pair of maps, a learned light, a folder of maps; and lamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from samira_warp.light import ColorSpace, Environment, LightRig
from samira_warp.light.environment import DIFFUSE_FILE, SPECULAR_FILE, learned_pair
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure
from samira_warp.support.tone_names import ToneMap

MAP_SUFFIXES = (".hdr", ".exr")
"""Files of a folder that are environment maps."""

LDR_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
"""Files that are maps as well where 8-bit pictures are taken."""

SHEET_SIZE = 128
"""Texels along a face for a contact sheet: ten times as fast as the 256 of a single map, from which pictures
of 256 x 256 pixels differ by 0.02 of 255 levels on average, and by 3 at most."""


def read_light(
    paths: Sequence[Path],
    *,
    rig: LightRig | None = None,
    rotate: float = 0.0,
    exposure: Exposure = 1.0,
    ldr: bool = False,
) -> Environment:
    """One light: a map, a diffuse map and a specular one, or a folder with a learned light; lamps; or both.

    Args:
        paths: One path or two; none where there is a rig.
        rig: Lamps that are added to the map.
        rotate: Degrees by which the whole light is turned.
        exposure: Factor on the whole light, or auto.
        ldr: Also take 8-bit pictures.

    Raises:
        UserError: There are none or more of them, or they cannot be used.
    """
    if not (1 <= len(paths) <= 2 or (rig is not None and not paths)):
        raise UserError(
            "--env", expected="one map, two (diffuse and specular) or a folder", found=f"{len(paths)} files"
        )
    if rig is None:
        return Environment.load(*paths, rotate=rotate, exposure=exposure, ldr=ldr)
    if not paths:
        return Environment.from_rig(rig).turned(rotate).exposed(exposure, name="the lamps")
    both = Environment.load(*paths, rotate=rotate, ldr=ldr).with_rig(rig)
    return both.exposed(exposure, name=paths[0])


def is_foreign(paths: Sequence[Path], *, rig: LightRig | None = None) -> bool:
    """Whether it is open how bright a light is: a map's and lamps' units are whoever's made them.

    A learned light, by its folder or its two maps, is as bright as the pictures that it was learned from.
    """
    if rig is not None:
        return True
    return len(paths) == 1 and not (paths[0].is_dir() and _holds_learned_light(paths[0]))


def suiting_exposure(
    asked: Exposure | None, paths: Sequence[Path], *, rig: LightRig | None = None
) -> Exposure:
    """The factor that is asked for, or what suits the light; without paths and rig a learned one."""
    if asked is not None:
        return asked
    return "auto" if is_foreign(paths, rig=rig) else 1.0


def suiting_tone_map(
    asked: Literal["auto"] | ToneMap,
    paths: Sequence[Path],
    *,
    rig: LightRig | None = None,
    color_space: ColorSpace,
) -> ToneMap:
    """The tone map that is asked for, or what suits the light; without paths and rig a learned one.

    Raises:
        UserError: It is asked of an avatar that works in image values.
    """
    raw = color_space == "raw"
    if asked == "auto":
        return "filmic" if is_foreign(paths, rig=rig) and not raw else "none"
    if raw and asked != "none":
        expected = "none for an avatar that shades in image values (train --color-space raw)"
        raise UserError("--tone-map", expected=expected, found=asked)
    return asked


def sheet_paths(paths: Sequence[Path], *, ldr: bool = False) -> list[Path] | None:
    """The maps of a contact sheet, by name, where ``paths`` is a folder of them; None where it is not.

    A folder with a learned light, of an avatar or of the run that holds it, is that light.

    Raises:
        UserError: The folder holds no maps.
    """
    if len(paths) != 1 or not paths[0].is_dir() or _holds_learned_light(paths[0]):
        return None
    folder = paths[0]
    suffixes = MAP_SUFFIXES + LDR_SUFFIXES if ldr else MAP_SUFFIXES
    maps = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith(".")
    )
    if not maps:
        learned = f"a learned light ({DIFFUSE_FILE} and {SPECULAR_FILE})"
        raise UserError(
            folder, expected=f"environment maps ({', '.join(suffixes)}) or {learned}", found="none"
        )
    return maps


def sheet_labels(maps: Sequence[Path]) -> list[str]:
    """What the pictures of a contact sheet are called.

    The maps' names, with the suffix where two would be called the same.
    """
    stems = [path.stem for path in maps]
    return [path.name if stems.count(path.stem) > 1 else path.stem for path in maps]


def read_sheet_light(
    path: Path,
    *,
    rig: LightRig | None = None,
    rotate: float = 0.0,
    exposure: Exposure = 1.0,
    ldr: bool = False,
) -> Environment:
    """One light of a contact sheet, at its size, with the lamps of a rig.

    Raises:
        UserError: The map cannot be used.
    """
    environment = Environment.load(path, rotate=rotate, ldr=ldr, size=SHEET_SIZE)
    return (environment if rig is None else environment.with_rig(rig)).exposed(exposure, name=path)


def _holds_learned_light(folder: Path) -> bool:
    try:
        learned_pair(folder)
    except UserError:
        return False
    return True
