"""Checking a dataset folder before anything is trained on it."""

from samira_warp.check.findings import Finding
from samira_warp.check.opening import open_checked

__all__ = ["Finding", "open_checked"]
