"""What is known of a video's focal length before anything is tracked."""

from __future__ import annotations

from pathlib import Path

import av

from samira_warp.data.video import VideoFacts
from samira_warp.prepare.crop import Crop
from samira_warp.tracker.lens import guessed_focal

FULL_FRAME = 36.0
"""Millimetres along the longer side of what 35 mm equivalents are measured on."""

EQUIVALENT_KEY = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
"""Where QuickTime films of telephones say it."""


def known_focal(video: Path, facts: VideoFacts, crop: Crop, *, side: int) -> tuple[float, str]:
    """Focal length in pixels of the frames, and where it is from.

    Args:
        video: The video file.
        facts: Of the video.
        crop: What is kept of its pictures.
        side: Of the frames, pixels.
    """
    scale = side / crop.side
    with av.open(str(video)) as container:
        said = {**container.metadata, **container.streams.video[0].metadata}.get(EQUIVALENT_KEY)
    longer = max(facts.width, facts.height)
    try:
        equivalent = float(said) if said is not None else 0.0
    except ValueError:
        equivalent = 0.0
    if equivalent > 0.0:
        return equivalent / FULL_FRAME * longer * scale, f"the film's {equivalent:g} mm"
    return guessed_focal(facts.width, facts.height) * scale, "a guess"
