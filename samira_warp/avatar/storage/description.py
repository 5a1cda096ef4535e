"""The description of an avatar folder: its version, the avatar's settings, and how it was made."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

from samira_warp.avatar.settings import AvatarSettings
from samira_warp.avatar.storage.older import FORMAT, READABLE, settings_of_version
from samira_warp.io.files import read_json
from samira_warp.nets import MotionSettings
from samira_warp.support.errors import UserError

DESCRIPTION_FILE = "avatar.json"


class Description(NamedTuple):
    """What an avatar folder says of itself.

    Attributes:
        version: Of the folder's layout.
        settings: The avatar's settings.
        record: How it was made (subject, split, versions, template hash), as plain JSON values.
    """

    version: int
    settings: AvatarSettings
    record: dict[str, Any]


def find_avatar(folder: Path) -> Path:
    """The avatar folder that ``folder`` is, or holds as a run folder does.

    Raises:
        UserError: There is none.
    """
    for candidate in (folder, folder / "avatar"):
        if (candidate / DESCRIPTION_FILE).is_file():
            return candidate
    found = (
        "no such folder" if not folder.is_dir() else f"no {DESCRIPTION_FILE} in it or in its avatar folder"
    )
    raise UserError(folder, expected="an avatar or a finished run", found=found)


def write_description(folder: Path, *, settings: AvatarSettings, record: dict[str, Any]) -> None:
    """Describe an avatar in the newest version's words."""
    values = {"format": FORMAT, "settings": asdict(settings), "record": record}
    (folder / DESCRIPTION_FILE).write_text(json.dumps(values, indent=1), encoding="utf-8")


def read_description(folder: Path) -> Description:
    """What an avatar folder of any readable version says of itself.

    Raises:
        UserError: The file is missing or broken, or of a version that is not known here.
    """
    path = folder / DESCRIPTION_FILE
    values = read_json(path)
    version = _version(path, values)
    for part in ("settings", "record"):
        if not isinstance(values.get(part), dict):
            raise UserError(path, expected=f"an object {part!r}", found=type(values.get(part)).__name__)
    settings = settings_of_version(values["settings"], version)
    _check_settings(path, settings)
    motion = MotionSettings(**settings["motion"])
    return Description(version, AvatarSettings(**{**settings, "motion": motion}), values["record"])


def read_record(folder: Path) -> dict[str, Any]:
    """How the avatar of a folder was made.

    Raises:
        UserError: As in read_description.
    """
    return read_description(folder).record


def _version(path: Path, values: dict[str, Any]) -> int:
    version = values.get("format")
    if version in READABLE and isinstance(version, int):
        return version
    newer = isinstance(version, int) and version > FORMAT
    raise UserError(
        path,
        expected=f"an avatar of format {READABLE[0]} to {READABLE[-1]}",
        found=f"format {version}, which a newer version of this package wrote" if newer else version,
    )


def _check_settings(path: Path, settings: dict[str, Any]) -> None:
    """Raise UserError unless every setting is there and no other.

    A default for one that is missing would be another avatar.
    """
    for kind, values in ((AvatarSettings, settings), (MotionSettings, settings.get("motion"))):
        expected = {setting.name for setting in fields(kind)}
        found = set(values) if isinstance(values, dict) else set()
        if found != expected:
            differing = ", ".join(sorted(found ^ expected))
            raise UserError(path, expected="an avatar's settings", found=f"others or none: {differing}")
