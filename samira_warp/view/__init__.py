"""A viewer of avatars in the browser."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.view.config import ViewConfig
    from samira_warp.view.run import view

__all__ = ["ViewConfig", "view"]

__getattr__ = lazily(__name__, {"ViewConfig": "config", "view": "run"})
