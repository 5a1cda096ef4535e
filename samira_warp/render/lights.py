"""The light or lights that the options ask for."""

from __future__ import annotations

from pathlib import Path

from samira_warp.avatar import Avatar
from samira_warp.light import Environment
from samira_warp.light.environment import DIFFUSE_FILE, SPECULAR_FILE, learned_pair
from samira_warp.render.config import RenderConfig
from samira_warp.support.errors import UserError

MAP_SUFFIXES = (".hdr", ".exr")
"""Files of a folder that are environment maps."""

LDR_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
"""Files that are maps as well where 8-bit pictures are taken."""

SHEET_SIZE = 128
"""Texels along a face for a contact sheet: ten times as fast as the 256 of a single map, from which pictures
of 256 x 256 pixels differ by 0.02 of 255 levels on average, and by 3 at most."""


def one_light(config: RenderConfig, avatar: Avatar) -> Environment:
    """The light of an image sequence: the map or the pair that --env names, else the learned light.

    Raises:
        UserError: The maps cannot be used.
    """
    if len(config.env) > 2:
        raise UserError(
            "--env",
            expected="one map, two (diffuse and specular) or a folder",
            found=f"{len(config.env)} files",
        )
    if not config.env:
        return avatar.light.environment().exposed(config.exposure, name="the learned light")
    return Environment.load(*config.env, exposure=config.exposure, ldr=config.ldr)


def sheet_paths(config: RenderConfig) -> list[Path] | None:
    """The maps of a contact sheet, sorted by name, where --env is a folder of maps; None where it is
    something else.

    A folder with a learned light, of an avatar or of the run that holds it, is that light.

    Raises:
        UserError: The folder holds no maps.
    """
    if len(config.env) != 1 or not config.env[0].is_dir() or _holds_learned_light(config.env[0]):
        return None
    folder = config.env[0]
    suffixes = MAP_SUFFIXES + LDR_SUFFIXES if config.ldr else MAP_SUFFIXES
    paths = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith(".")
    )
    if not paths:
        kinds = f"environment maps ({', '.join(suffixes)}) or a learned light ({DIFFUSE_FILE} and {SPECULAR_FILE})"
        raise UserError(folder, expected=kinds, found="none")
    return paths


def sheet_labels(paths: list[Path]) -> list[str]:
    """What the pictures of a contact sheet are called: the maps' names, with the suffix where two would be
    called the same.
    """
    stems = [path.stem for path in paths]
    return [path.name if stems.count(path.stem) > 1 else path.stem for path in paths]


def sheet_light(config: RenderConfig, path: Path) -> Environment:
    """One light of a contact sheet.

    Raises:
        UserError: The map cannot be used.
    """
    return Environment.load(path, exposure=config.exposure, ldr=config.ldr, size=SHEET_SIZE)


def _holds_learned_light(folder: Path) -> bool:
    try:
        learned_pair(folder)
    except UserError:
        return False
    return True
