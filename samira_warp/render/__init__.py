"""Rendering avatars to files."""

from samira_warp.render.config import RenderConfig
from samira_warp.render.render import render

__all__ = ["RenderConfig", "render"]
