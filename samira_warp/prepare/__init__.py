"""From a video to a dataset: frames, mattes, tracking, pseudo-albedo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.prepare.config import PrepareConfig
    from samira_warp.prepare.run import prepare

__all__ = [
    "PrepareConfig",
    "prepare",
]

__getattr__ = lazily(
    __name__,
    {
        "PrepareConfig": "config",
        "prepare": "run",
    },
)
