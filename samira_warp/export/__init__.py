"""Avatars for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.export.config import ExportConfig
    from samira_warp.export.run import export

__all__ = ["ExportConfig", "export"]

__getattr__ = lazily(__name__, {"ExportConfig": "config", "export": "run"})
