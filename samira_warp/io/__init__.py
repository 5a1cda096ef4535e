"""Files in and out: pictures, folders, JSON, tensors, and pickles that run nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.io.images import read_image, write_exr, write_png

__all__ = [
    "read_image",
    "write_exr",
    "write_png",
]

__getattr__ = lazily(
    __name__,
    {
        "read_image": "images",
        "write_exr": "images",
        "write_png": "images",
    },
)
