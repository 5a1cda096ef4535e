"""Modules by the paths that they had in 0.1, until 0.3: the same module, and a DeprecationWarning."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

PACKAGE = "samira_warp"

MOVED = {
    "camera": "geometry.camera",
    "contact_sheet": "stage.sheet",
    "errors": "support.errors",
    "files": "io.files",
    "images": "io.images",
    "pickles": "io.pickles",
}
"""What a program may have imported: its path within the package then, and now."""


class MovedModules(MetaPathFinder, Loader):
    """Finds a module of `MOVED` where nothing else does."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """What the import system asks: a spec for an old path of this package, None for all else."""
        package, _, old = fullname.partition(".")
        return ModuleSpec(fullname, self) if package == PACKAGE and old in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module itself, by its new path."""
        name = f"{PACKAGE}.{MOVED[spec.name.partition('.')[2]]}"
        warnings.warn(
            f"{spec.name} is {name} now: the old path ends with 0.3", DeprecationWarning, stacklevel=2
        )
        module = importlib.import_module(name)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """It has run already; the import system gave it the old path's spec, which is taken back."""
        if module.__spec__ is not None:
            module.__spec__ = module.__spec__.loader_state


def keep_old_paths() -> None:
    """Let the old paths be imported."""
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.append(MovedModules())
