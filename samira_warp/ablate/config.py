"""Options of the ablate verb, and which variants the paper compares."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from samira_warp.support.device_names import DeviceName
from samira_warp.train.config import Ablation, Asked, PresetName

Variant = Literal["full", Ablation]
"""The method, or the method without a part."""

FULL: Variant = "full"
"""What the others are compared with."""

PAPER: tuple[Variant, ...] = (
    FULL,
    "no-residual",
    "no-routing",
    "no-displacement",
    "no-modulation",
    "no-response",
    "no-two-stage",
    "no-normal-prior",
    "no-albedo",
)
"""The paper's: of motion (its table and its figure of regions), then of illumination and decomposition."""


@dataclass(frozen=True)
class AblateConfig:
    """Train the method and the method without each of its parts, at equal steps, and compare their scores.

    Each run has a folder of its own, OUT/VARIANT_SEED. The same command again keeps what has finished and
    goes on with what has not; more seeds and variants may be asked for later. OUT/ablation.md has the tables,
    ablation.json what they are made of, regions.png the differences by region.
    """

    data: Path
    """Dataset folder: a VHAP export or any other format that samira_warp.check knows."""
    out: Path
    """Folder of the runs and the tables."""
    variants: tuple[Variant, ...] = PAPER
    """What to train; full, which the others are compared with, is among it in any case."""
    seeds: int = 1
    """Runs of each variant, with the seeds 42, 43 and so on. With one, the spread over seeds is not known."""
    max_steps: Asked[int] = None
    """Steps of each run; default the train verb's."""
    preset: Asked[PresetName] = None
    """Sizes: cpu (256 x 256, UV 128) or paper (512 x 512, UV 256); default cpu where there is no GPU."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""
    split: Asked[str] = None
    """Train and test frames: the dataset's own, a fraction that trains, or last:N that tests; default
    dataset."""
    regions: Asked[Path] = None
    """Folder of label images of the test frames, with their names in parse.json there or one folder up;
    default the dataset's gt/parse, where it has one."""
    flame: Asked[Path] = None
    """FLAME's file (.pkl or .npz, with its UV coordinates and masks beside it), or a template.npz, for a
    dataset without one."""
    encoder: Asked[str] = None
    """Image encoder of the reference image: a hub id, a local folder, or random; default
    microsoft/resnet-18."""
    lpips_weights: Asked[Path] = None
    """Folder with LPIPS backbone and linear-head files; default the hub cache or an installed lpips
    package."""
