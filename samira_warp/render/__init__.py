"""Rendering avatars to files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.render.config import RenderConfig
    from samira_warp.render.run import render

__all__ = ["RenderConfig", "render"]

__getattr__ = lazily(__name__, {"RenderConfig": "config", "render": "run"})
