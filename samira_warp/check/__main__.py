"""``python -m samira_warp.check``: reads a dataset as training would and says what it holds."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from samira_warp.cli import run
from samira_warp.data import Sequence, open_sequence


@dataclass(frozen=True)
class CheckConfig:
    """Read a dataset folder with the checks of training, and say what it holds."""

    data: Path
    """Folder of the dataset."""

    split: str = "dataset"
    """How to divide it: train or test (both the dataset's own), a fraction, or last:N."""

    flame: Path | None = None
    """FLAME's file (.pkl or .npz, with its UV coordinates and masks beside it), or a template.npz, for a dataset without one."""


def main(config: CheckConfig) -> None:
    """Read, check and print."""
    print(describe(open_sequence(config.data, split=config.split, flame=config.flame)))


def describe(sequence: Sequence) -> str:
    """What a sequence holds, one fact a line."""
    frames = sequence.frames
    sizes = sorted({(frame.camera.width, frame.camera.height) for frame in frames})
    template = sequence.template
    facts = {
        "folder": sequence.root,
        "format": sequence.format,
        "frames": f"{len(frames)} at {len({frame.timestep for frame in frames})} timesteps",
        "split": f"{sequence.split.text}: {len(sequence.train)} train, {len(sequence.test)} test",
        "size": ", ".join(f"{width} x {height}" for width, height in sizes),
        "template": f"{sequence.template_path}: {len(template.v_template)} vertices, {len(template.faces)} faces, "
        f"{template.n_shape} identity and {template.n_expression} expression coefficients",
        "static offset": "none" if sequence.canonical_static_offset is None else "present",
        "masks": f"{sum(frame.mask_path is not None for frame in frames)} of {len(frames)} frames",
        "albedo": f"{sum(frame.albedo_path is not None for frame in frames)} of {len(frames)} frames",
    }
    return "\n".join(f"{name + ':':<15}{value}" for name, value in [*facts.items(), *(("note", note) for note in sequence.notes)])


if __name__ == "__main__":
    sys.exit(run(main, CheckConfig, program="python -m samira_warp.check"))
