"""Long films in windows, so that memory does not grow with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from samira_warp.tracker.unknowns import Unknowns

WINDOW = 750
"""Frames that are solved for together: half a minute."""

OVERLAP = 30
"""Frames that two windows share; each keeps its half of them, where what lies beyond its end is not felt."""


def windows(frames: int) -> list[tuple[slice, slice]]:
    """Which frames are solved for together, and which of them are kept."""
    found, first = [], 0
    while True:
        end = min(first + WINDOW, frames)
        kept_first = first if first == 0 else first + OVERLAP // 2
        kept_end = end if end == frames else end - OVERLAP // 2
        found.append((slice(first, end), slice(kept_first, kept_end)))
        if end == frames:
            return found
        first = end - OVERLAP


def in_windows(unknowns: Unknowns, fit: Callable[[slice, Unknowns], Unknowns]) -> Unknowns:
    """Fit a film's frames window by window, the subject held."""
    frames = unknowns.frames.clone()
    for solved, kept in windows(len(frames)):
        found = fit(solved, replace(unknowns, frames=frames[solved]))
        frames[kept] = found.frames[kept.start - solved.start : kept.stop - solved.start]
    return replace(unknowns, frames=frames)
