"""Which stages of a preparation are done, from what.

One small file a stage, written when its output is whole.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from samira_warp.io.files import read_json, replace_file
from samira_warp.support.errors import UserError

ORDER = ("crop", "frames", "faces", "mattes", "tracking", "dataset", "albedo", "refined")
"""Each stage follows from those before it."""

MARKERS = "stages"
"""Folder of the files."""

_BLOCKS, _BLOCK = 64, 1 << 16
"""How many pieces of a file are looked at, and their bytes: all of a small one."""


@dataclass(frozen=True)
class Stage:
    """One stage in one folder.

    Attributes:
        root: The folder of the preparation.
        name: One of ORDER.
        inputs: What it is made from, as JSON values: equal inputs give equal output.
    """

    root: Path
    name: str
    inputs: dict[str, Any]

    @property
    def marker(self) -> Path:
        """The file that says how far the stage is."""
        return self.root / MARKERS / f"{self.name}.json"

    @property
    def unfinished(self) -> Path:
        """A folder for parts of what the stage makes, until it is finished."""
        return self.root / MARKERS / self.name

    def done(self, *outputs: Path) -> dict[str, Any] | None:
        """What the stage found, if it was finished with these inputs and the outputs are still there."""
        record = self._record()
        whole = record.get("inputs") == self.inputs and all(output.exists() for output in outputs)
        return record.get("result") if whole else None

    def changed(self) -> bool:
        """Whether the stage was begun before, with other inputs."""
        return self._record().get("inputs", self.inputs) != self.inputs

    def result(self) -> dict[str, Any]:
        """What the stage found: it is done with these inputs."""
        found = self.done()
        if found is None:
            raise RuntimeError(f"the stage {self.name} is asked for its result before it is done")
        return found

    def finished(self) -> dict[str, Any]:
        """The inputs that the stage was last finished with, whatever they were; empty if it never was."""
        record = self._record()
        return (
            record["inputs"]
            if record.get("result") is not None and isinstance(record.get("inputs"), dict)
            else {}
        )

    def begin(self, *outputs: Path) -> None:
        """Go on with what was begun with these inputs, or clear the outputs for a new start.

        Later stages have to follow.

        Args:
            outputs: Files and folders of this stage alone.
        """
        for later in ORDER[ORDER.index(self.name) + 1 :]:
            (self.root / MARKERS / f"{later}.json").unlink(missing_ok=True)
        if self._record().get("inputs") != self.inputs:
            self.marker.unlink(missing_ok=True)
            for output in outputs:
                if output.is_dir():
                    shutil.rmtree(output)
                output.unlink(missing_ok=True)
        self._write(None)

    def finish(self, result: dict[str, Any]) -> dict[str, Any]:
        """Say that the output is whole, and what was found."""
        self._write(result)
        return result

    def key(self) -> str:
        """Digest of what the stage was made from and what it found: an input of the stages that follow."""
        return hashlib.sha256(json.dumps([self.inputs, self.done()], sort_keys=True).encode()).hexdigest()[
            :16
        ]

    def _record(self) -> dict[str, Any]:
        return read_json(self.marker) if self.marker.is_file() else {}

    def _write(self, result: dict[str, Any] | None) -> None:
        self.marker.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.marker, json.dumps({"inputs": self.inputs, "result": result}, indent=1))


def check_root(root: Path, outputs: tuple[str, ...]) -> None:
    """Raise UserError if a folder holds, under names of ours, what no preparation has made."""
    if root.exists() and not root.is_dir():
        raise UserError(root, expected="a folder", found="a file")
    foreign = [name for name in outputs if (root / name).exists()]
    if foreign and not (root / MARKERS).is_dir():
        raise UserError(
            root,
            expected="a new folder, or one that prepare has made",
            found=f"{foreign[0]} of another origin in it",
        )


def content_of(path: Path) -> str:
    """What tells a file from another by its content, whatever its name and time say.

    A digest of its size and of blocks from its beginning to its end: a film of hours is not read whole.
    """
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        for number in range(_BLOCKS):
            file.seek(max(size - _BLOCK, 0) * number // (_BLOCKS - 1))
            digest.update(file.read(_BLOCK))
    return digest.hexdigest()[:16]


def is_file(path: Path, identity: object) -> bool:
    """Whether a file is the one of which a marker speaks; earlier ones hold name, size and time."""
    if isinstance(identity, list):
        return identity[:2] == [path.name, path.stat().st_size]
    return identity == content_of(path)


def folder_identity(pictures: dict[str, Path]) -> str:
    """Digest of the names and contents of a folder's pictures."""
    listed = [(name, content_of(path)) for name, path in sorted(pictures.items())]
    return hashlib.sha256(json.dumps(listed).encode()).hexdigest()[:16]
