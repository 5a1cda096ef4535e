"""``python -m samira_warp.render``: images, layers and videos of an avatar, re-animated and relit."""

from __future__ import annotations

import sys

from samira_warp.render.config import RenderConfig
from samira_warp.render.render import render
from samira_warp.support.cli import run


def main(config: RenderConfig) -> None:
    """Render, and say where."""
    count = render(config)
    print(f"{count} picture{'s' if count > 1 else ''} of each layer in {config.out}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(run(main, RenderConfig, program="python -m samira_warp.render"))
