"""From an avatar's folder to a file or a folder for other programs."""

from __future__ import annotations

import torch

from samira_warp.export.config import ExportConfig
from samira_warp.export.source import ExportSource
from samira_warp.io.files import check_writable, provisional_folder, replace_folder, whole_file


@torch.no_grad()
def export(config: ExportConfig) -> str:
    """Write an avatar as its options say; whatever ends it, no file is left that is not whole.

    Returns:
        What was written, in a few words.

    Raises:
        UserError: The avatar, a frame, the light or an option cannot be used, or a library is missing.
    """
    config.check()
    check_writable(config.out.parent)
    source, kind = ExportSource.read(config), config.kind
    write = kind.writer()
    if kind.target == "files":
        with provisional_folder(config.out):
            return write(source, config.out)
    if kind.target == "folder":
        said: list[str] = []
        replace_folder(config.out, lambda fresh: said.append(write(source, fresh)))
        return said[0]
    with whole_file(config.out) as fresh:
        return write(source, fresh)
