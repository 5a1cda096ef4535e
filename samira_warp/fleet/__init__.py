"""Many subjects on many machines: prepare, train, evaluate and export what a manifest lists."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.fleet.config import FleetConfig
    from samira_warp.fleet.run import fleet

__all__ = ["FleetConfig", "fleet"]

__getattr__ = lazily(__name__, {"FleetConfig": "config", "fleet": "run"})
