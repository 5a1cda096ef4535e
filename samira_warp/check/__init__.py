"""Checking a dataset folder before anything is trained on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.check.config import CheckConfig
    from samira_warp.check.findings import Finding
    from samira_warp.check.opening import open_checked
    from samira_warp.check.report import Report, check_dataset

__all__ = [
    "CheckConfig",
    "Finding",
    "Report",
    "check_dataset",
    "open_checked",
]

__getattr__ = lazily(
    __name__,
    {
        "CheckConfig": "config",
        "Finding": "findings",
        "Report": "report",
        "check_dataset": "report",
        "open_checked": "opening",
    },
)
