"""How radiance is brought into the range of a display: the names, for options that load no torch."""

from __future__ import annotations

from typing import Literal

ToneMap = Literal["none", "filmic"]
"""none clips what is brighter than a display's white; filmic bends it below (`samira_warp.light.tone`)."""
