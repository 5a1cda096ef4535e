"""What a dataset holds, in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.check.views import View
from samira_warp.data import Listing, TrackedSequence
from samira_warp.support.constants import TRAINING_SIZES


def listing_facts(listing: Listing, *, divided: bool) -> dict[str, str]:
    """What is known without the tracked parameters.

    Args:
        listing: The frames.
        divided: Whether they are divided as the user wants; else nothing is said of it.
    """
    frames = listing.frames
    sizes = sorted({(frame.camera.width, frame.camera.height) for frame in frames})
    facts = {
        "folder": str(listing.root),
        "format": listing.format,
        "frames": f"{len(frames)} at {len({frame.timestep for frame in frames})} timesteps",
        "split": f"{listing.split.text}: {len(listing.train)} train, {len(listing.test)} test",
        "size": ", ".join(f"{width} x {height}" for width, height in sizes),
        "cameras": _cameras(listing),
        "masks": f"{sum(frame.mask_path is not None for frame in frames)} of {len(frames)} frames",
        "albedo": f"{sum(frame.albedo_path is not None for frame in frames)} of {len(frames)} frames",
    }
    return facts if divided else {name: fact for name, fact in facts.items() if name != "split"}


def size_notes(listing: Listing) -> tuple[str, ...]:
    """A note where pictures are smaller than what the presets of train make of them."""
    cameras = [frame.camera for frame in listing.frames]
    smallest = min(cameras, key=lambda camera: max(camera.width, camera.height))
    own = max(smallest.width, smallest.height)
    larger = [f"{size} (preset {name})" for name, size in TRAINING_SIZES.items() if size > own]
    if not larger:
        return ()
    return (
        f"train enlarges pictures of {smallest.width} x {smallest.height} to {' or '.join(larger)}, "
        f"which adds no detail: --resolution {own} trains at their own size",
    )


def head_facts(sequence: TrackedSequence, views: list[View]) -> dict[str, str]:
    """What is known of the head, its motion, and where it is.

    Args:
        sequence: The dataset.
        views: Some of its frames.
    """
    template = sequence.template
    parameters = sequence.batch(range(len(sequence.frames)))
    expression = parameters.expression.numpy()
    facts = {
        "template": _template(sequence.template_path, sequence),
        "static offset": "none" if sequence.static_offset is None else "present",
        "identity": f"coefficients {_range(sequence.shape.numpy())}",
    }
    if expression.size:
        frame, shape = np.unravel_index(np.abs(expression).argmax(), expression.shape)
        most = f"the largest is {template.expression_names[shape]} in {sequence.frames[frame].name}"
        facts["expression"] = f"coefficients {_range(expression)}, {most}"
    turns = parameters.rotations.norm(dim=2).amax(dim=0).rad2deg().tolist()
    moving = [(name, turn) for name, turn in zip(template.joint_names, turns, strict=True) if turn > 0]
    facts["turn"] = ", ".join(f"{name} up to {turn:.0f} degrees" for name, turn in moving) or "none"
    if views:
        depths = [float(np.median(view.points[:, 2])) for view in views]
        facts["distance"] = f"{min(depths):.2f} to {max(depths):.2f} metres from the camera"
    return facts


def _template(path: Path, sequence: TrackedSequence) -> str:
    template = sequence.template
    size = f"{len(template.v_template)} vertices, {len(template.faces)} faces"
    return f"{path}: {size}, {template.n_shape} identity and {template.n_expression} expression coefficients"


def _cameras(listing: Listing) -> str:
    """How many there are, and their focal lengths."""
    cameras = [frame.camera for frame in listing.frames]
    poses = {camera.world_to_camera.numpy().tobytes() for camera in cameras}
    focal = np.array([camera.fx for camera in cameras])
    shown = (
        f"{focal.min():.5g}"
        if np.ptp(focal) < 1e-3 * focal.max()
        else f"{focal.min():.5g} to {focal.max():.5g}"
    )
    return f"{len(poses)} pose{'s' * (len(poses) > 1)}, focal length {shown} pixels"


def _range(values: np.ndarray) -> str:
    return f"from {values.min():.2f} to {values.max():.2f}" if values.size else "none"
