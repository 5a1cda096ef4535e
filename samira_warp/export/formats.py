"""The formats of exported splats, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from samira_warp.export.config import Format
from samira_warp.export.ply import write_ply
from samira_warp.export.splats import Splats

FORMATS: dict[Format, Callable[[Splats, Path], None]] = {"ply": write_ply}
"""What writes splats to a file; another format is a module with such a function, a line here and its name in
`samira_warp.export.config.Format`."""
