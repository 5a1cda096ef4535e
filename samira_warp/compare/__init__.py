"""The verb that puts training runs side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.compare.config import CompareConfig
    from samira_warp.compare.run import compare

__all__ = [
    "CompareConfig",
    "compare",
]

__getattr__ = lazily(
    __name__,
    {
        "CompareConfig": "config",
        "compare": "run",
    },
)
