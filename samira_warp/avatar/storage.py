"""An avatar on disk: settings in JSON, tensors in safetensors, the head template beside them; no pickle
anywhere.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from samira_warp.head import HeadTemplate, read_template, save_template
from samira_warp.io.files import read_json, save_tensors
from samira_warp.support.errors import UserError

FORMAT = 2
"""Version of the folder's layout."""

UNTIED_FORMAT = 1
"""The version that did not say whether the learned light is one map or two: it always was two."""

DESCRIPTION_FILE = "avatar.json"
TENSORS_FILE = "avatar.safetensors"
TEMPLATE_FILE = "template.npz"


class StoredAvatar(NamedTuple):
    """What an avatar folder holds.

    Attributes:
        settings: The avatar's settings as plain values.
        record: How it was made (subject, split, versions, template hash).
        tensors: The state of the avatar by name.
        template: The head model.
    """

    settings: dict[str, Any]
    record: dict[str, Any]
    tensors: dict[str, torch.Tensor]
    template: HeadTemplate


def write_avatar(
    folder: Path,
    *,
    settings: Any,
    record: dict[str, Any],
    tensors: dict[str, torch.Tensor],
    template: HeadTemplate,
) -> None:
    """Write the files of an avatar into an existing folder.

    Args:
        folder: Where.
        settings: A dataclass of settings.
        record: How it was made; plain JSON values.
        tensors: State by name.
        template: The head model.
    """
    description = {
        "format": FORMAT,
        "settings": asdict(settings),
        "record": {**record, "template": template.hash},
    }
    (folder / DESCRIPTION_FILE).write_text(json.dumps(description, indent=1), encoding="utf-8")
    save_tensors(tensors, folder / TENSORS_FILE)
    save_template(template, folder / TEMPLATE_FILE)


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


def read_avatar(folder: Path, *, device: torch.device | str) -> StoredAvatar:
    """Read an avatar folder.

    Raises:
        UserError: A file is missing, broken, or of another format; the template is not the one that the
            avatar was made with.
    """
    description = read_json(folder / DESCRIPTION_FILE)
    if description.get("format") not in (UNTIED_FORMAT, FORMAT):
        raise UserError(
            folder / DESCRIPTION_FILE,
            expected=f"format {UNTIED_FORMAT} or {FORMAT}",
            found=description.get("format"),
        )
    for part in ("settings", "record"):
        if not isinstance(description.get(part), dict):
            raise UserError(
                folder / DESCRIPTION_FILE,
                expected=f"an object {part!r}",
                found=type(description.get(part)).__name__,
            )
    try:
        tensors = load_file(folder / TENSORS_FILE, device=str(device))
    except (OSError, SafetensorError) as error:
        raise UserError(folder / TENSORS_FILE, expected="the avatar's tensors", found=error) from error
    template = read_template(folder / TEMPLATE_FILE)
    recorded = str(description["record"].get("template"))
    if template.hash != recorded:
        raise UserError(
            folder / TEMPLATE_FILE, expected=f"the template {recorded[:12]}", found=template.hash[:12]
        )
    settings = description["settings"]
    if description["format"] == UNTIED_FORMAT:
        settings = {**settings, "tied_light": False}
    return StoredAvatar(settings, description["record"], tensors, template)
