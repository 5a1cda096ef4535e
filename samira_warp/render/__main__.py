"""``samira-warp render``, or ``python -m samira_warp.render``: images, layers and videos of an avatar."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.render.config import RenderConfig
from samira_warp.support.cli import run


def main(config: RenderConfig) -> None:
    """Render, and say where."""
    from samira_warp.render.run import render

    count = render(config)
    print(f"{count} picture{'s' if count > 1 else ''} of each layer in {config.out}", file=sys.stderr)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.render") -> int:
    """The verb from its options to its exit status."""
    return run(main, RenderConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
