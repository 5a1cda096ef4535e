"""What a run says before its first step: what will be trained, what is missing, and what is uncertain."""

from __future__ import annotations

import sys

from samira_warp.data import TrackedSequence
from samira_warp.data.appearance import APPEARANCE_FILE
from samira_warp.data.pixels import unmatted_albedos
from samira_warp.evaluate import Lpips
from samira_warp.train.plan import TrainPlan
from samira_warp.train.setup import tracked_start
from samira_warp.train.skin import SKIN_LUMINANCE, skin_faces


def announce(plan: TrainPlan, sequence: TrackedSequence, lpips: Lpips | str, encoder: str) -> None:
    """Say what will be trained, and which optional parts are missing and why."""
    frames = f"{len(sequence.train)} training and {len(sequence.test)} test frames"
    lines = [f"{sequence.root.name}: {frames} on {plan.settings.device}", *sequence.notes]
    resolution = plan.settings.resolution
    smallest = min(
        (frame.camera for frame in sequence.frames), key=lambda camera: max(camera.width, camera.height)
    )
    own = max(smallest.width, smallest.height)
    if own < resolution:
        enlarged = smallest.with_longer_side(resolution)
        lines.append(
            f"pictures of {smallest.width} x {smallest.height} pixels are enlarged to {enlarged.width} x "
            f"{enlarged.height}, which adds no detail: --resolution {own} trains at their own size"
        )
    lines.append(f"image encoder: {encoder}")
    if isinstance(lpips, str):
        lines.append(f"no LPIPS term: {lpips}")
    lines += _albedo_notes(plan, sequence)
    print("\n".join(lines), file=sys.stderr)


def _albedo_notes(plan: TrainPlan, sequence: TrackedSequence) -> list[str]:
    """Which pseudo-albedo is not compared with, and what follows where none is."""
    if "no-albedo" in plan.settings.ablate:
        return []
    frames = [sequence.frames[index] for index in sequence.train]
    having = [frame for frame in frames if frame.albedo_path is not None]
    unmatted = unmatted_albedos(having)
    lines = []
    if unmatted:
        lines.append(
            f"{len(unmatted)} of {len(having)} albedo files are not compared with, the first is "
            f"{unmatted[0].albedo_path}: their frames have neither a mask nor an alpha channel, and albedo "
            "is compared inside a matte alone"
        )
    if len(unmatted) == len(having):
        lines += _uncertainty(plan, sequence)
    return lines


def _uncertainty(plan: TrainPlan, sequence: TrackedSequence) -> list[str]:
    """What nothing tells of albedo and light where there is no pseudo-albedo."""
    lines = []
    if tracked_start(plan, sequence) is not None:
        lines.append(f"albedo and light start from the tracker's, in {APPEARANCE_FILE}")
    if not (plan.skin_prior and skin_faces(sequence.template).any()):
        return [*lines, "no pseudo-albedo: the absolute brightness of a relit image is undefined"]
    low, high = SKIN_LUMINANCE
    return [
        *lines,
        f"no pseudo-albedo: how bright skin is against the light is known as far as skin was measured, "
        f"luminance {low:g} to {high:g}: relit images may be off by a factor of up to {high / low:.0f}, "
        "in practice by that of a camera's exposure",
        "hair and clothes have what albedo that light leaves them: nothing else is known of theirs",
    ]
