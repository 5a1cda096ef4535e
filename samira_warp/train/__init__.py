"""Training: from a tracked sequence to an avatar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.train.config import TrainConfig
    from samira_warp.train.run import train

__all__ = [
    "TrainConfig",
    "train",
]

__getattr__ = lazily(
    __name__,
    {
        "TrainConfig": "config",
        "train": "run",
    },
)
