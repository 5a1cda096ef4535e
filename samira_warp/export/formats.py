"""The formats of exported avatars, by name: what each writes, holds and needs. No torch."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from samira_warp.support.errors import UserError

if TYPE_CHECKING:
    from samira_warp.export.source import ExportSource

Format = Literal["ply", "ply-sequence", "spz", "gltf-splats", "usd", "glb", "avatar-web"]
"""Names of `FORMATS`."""

Writer = Callable[["ExportSource", Path], str]
"""What a format's module calls ``write``: it fills the file or folder that it is given, and says in a few
words what it wrote, such as "20,000 splats of frame 00012"."""


@dataclass(frozen=True)
class ExportFormat:
    """What the verb knows of a format before it is loaded.

    Attributes:
        name: As --format has it.
        module: The module of this room whose ``write`` is a `Writer`.
        suffixes: What its files' names end in, lower case; none for a folder.
        target: What ``write`` is given. "file" and "folder": one beside --out, which takes its name when it
            is whole. "files": --out itself, a folder that is there, each of whose files the format makes
            whole.
        frames: "one", "many", or "either": one, unless --frames or --split asks for a sequence.
        libraries: What it imports that may be missing, as pip calls it, by the import's name.
        extra: The extra of this package that installs them.
        lit: Whether it holds colours under a light; False holds materials, which what opens it lights.
        textures: Whether it has textures.
    """

    name: Format
    module: str
    suffixes: tuple[str, ...] = ()
    target: Literal["file", "folder", "files"] = "file"
    frames: Literal["one", "many", "either"] = "one"
    libraries: tuple[tuple[str, str], ...] = ()
    extra: str = ""
    lit: bool = True
    textures: bool = False

    def check_target(self, out: Path) -> None:
        """Raise UserError unless ``out`` is called as the format's files are, and can take its place."""
        if self.target == "file":
            if out.suffix.lower() not in self.suffixes:
                expected = f"a file name ending in {' or '.join(self.suffixes)} for --format {self.name}"
                raise UserError(out, expected=expected, found=out.suffix or "no suffix")
            if out.is_dir():
                raise UserError(out, expected="a file", found="a folder of this name")
        elif out.exists() and not out.is_dir():
            expected = f"a folder, which --format {self.name} makes"
            raise UserError(out, expected=expected, found="a file of this name")
        elif self.target == "folder" and out.is_dir() and any(out.iterdir()):
            raise UserError(out, expected="a new or an empty folder", found="one with something in it")
        if not out.parent.is_dir():
            raise UserError(out.parent, expected="an existing folder", found="no such folder")

    def check_installed(self) -> None:
        """Raise UserError unless everything that the format imports is there; nothing is imported."""
        for module, package in self.libraries:
            if not _is_there(module):
                expected = f"{package} (pip install 'samira-warp[{self.extra}]')"
                raise UserError(f"--format {self.name}", expected=expected, found="it is not installed")

    def writer(self) -> Writer:
        """The function that writes it."""
        loaded: Writer = importlib.import_module(f"samira_warp.export.{self.module}").write
        return loaded


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of what it is in
        return False


FORMATS: dict[Format, ExportFormat] = {
    entry.name: entry
    for entry in (
        ExportFormat("ply", "ply", (".ply",)),
        ExportFormat("ply-sequence", "ply_sequence", target="files", frames="many"),
        ExportFormat("spz", "spz", (".spz",), libraries=(("zstandard", "zstandard"),), extra="spz"),
        ExportFormat("gltf-splats", "gltf_splats", (".glb",)),
        ExportFormat(
            "usd", "usd", (".usdc", ".usda", ".usdz"), libraries=(("pxr.UsdVol", "usd-core"),), extra="usd"
        ),
        ExportFormat("glb", "glb", (".glb",), frames="many", lit=False, textures=True),
        ExportFormat("avatar-web", "avatar_web", target="folder", frames="many"),
    )
}
"""Another format is a module with a function `write`, a line here and its name in `Format`."""


def format_of(name: Format | None, out: Path) -> ExportFormat:
    """The format of a name, or the only one whose files are called as ``out`` is.

    Raises:
        UserError: There is none, or there are several.
    """
    if name is not None:
        return FORMATS[name]
    meant = [entry for entry in FORMATS.values() if out.suffix.lower() in entry.suffixes]
    if len(meant) == 1:
        return meant[0]
    names = [entry.name for entry in meant] or get_args(Format)
    found = f"none, and {'several' if meant else 'no'} formats whose files end in {out.suffix!r}"
    raise UserError("--format", expected=" or ".join(names), found=found)
