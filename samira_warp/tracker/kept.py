"""Parts of a fit, kept on disk as they are done: a fit that was interrupted goes on after them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from safetensors.torch import load_file
from torch import Tensor

from samira_warp.io.files import save_tensors


class Kept:
    """Tensors by the name of the part that made them, in a folder.

    Args:
        folder: Where to; it need not exist yet. What is in it is of the same fit.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, name: str, make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """What a part made when it was done before, else what it makes now.

        Raises:
            OSError: The file cannot be written.
        """
        target = self._folder / f"{name}.safetensors"
        if target.is_file():
            return load_file(target)
        made = make()
        self._folder.mkdir(parents=True, exist_ok=True)
        save_tensors(made, target)
        return made
