"""The verb that trains the method without each of its parts, and says what they are worth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.ablate.config import AblateConfig
    from samira_warp.ablate.run import ablate

__all__ = [
    "AblateConfig",
    "ablate",
]

__getattr__ = lazily(
    __name__,
    {
        "AblateConfig": "config",
        "ablate": "run",
    },
)
