"""A training run as it is asked for: the options of the train verb, and the presets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import tyro

from samira_warp.support.constants import TRAINING_SIZES
from samira_warp.support.device_names import DeviceName

Ablation = Literal[
    "no-residual",
    "no-routing",
    "no-displacement",
    "no-modulation",
    "no-response",
    "no-two-stage",
    "no-normal-prior",
    "no-albedo",
    "no-mask",
    "no-visibility",
    "no-wrinkles",
]

PresetName = Literal["cpu", "paper"]


@dataclass(frozen=True)
class Preset:
    """What a preset decides; image size and number of Gaussians have options of their own.

    Attributes:
        resolution: Width and height of the training images, pixels.
        uv_size: Width and height of the UV maps.
        gaussians: Number of Gaussians at the start.
        gaussian_cap: Density control stops adding above this.
        width: Channels of the motion network's shared features.
        region_width: Channels of each region's features.
        epochs: Passes over the training frames.
        least_steps: A run has at least so many.
    """

    resolution: int
    uv_size: int
    gaussians: int
    gaussian_cap: int
    width: int
    region_width: int
    epochs: int
    least_steps: int

    def steps(self, frames: int) -> int:
        """Length of a run on so many training frames, where nothing else is asked for."""
        return max(self.epochs * frames, self.least_steps)


PRESETS: dict[PresetName, Preset] = {
    "cpu": Preset(
        resolution=TRAINING_SIZES["cpu"],
        uv_size=128,
        gaussians=20_000,
        gaussian_cap=40_000,
        width=24,
        region_width=8,
        # of `ict_a`'s 300 frames these make what ten passes do (docs/measurements.md)
        epochs=4,
        least_steps=1_200,
    ),
    "paper": Preset(
        resolution=TRAINING_SIZES["paper"],
        uv_size=256,
        gaussians=65_536,
        gaussian_cap=200_000,
        width=64,
        region_width=32,
        epochs=10,
        least_steps=1_200,
    ),
}

Value = TypeVar("Value")

Asked = Annotated[Value | None, tyro.conf.arg(help_behavior_hint=""), tyro.conf.DisallowNone]
"""An option that need not be given: None where it is not.

Then the run that goes on decides, or the default that its help names: an option that is asked for can be told
from one that is not, even where it asks for the default.
"""


@dataclass(frozen=True)
class TrainConfig:
    """Train a relightable, animatable avatar from a tracked video of a head.

    With --resume, what is not asked for is taken from the run's config.json, and what is asked for must agree
    with it, unless it says where things are or how long the run is to be.
    """

    data: Asked[Path] = None
    """Dataset folder: a VHAP export or any other format that samira_warp.check knows; or a video file, which
    is prepared first, in OUT/prepared; default the built-in subject."""
    flame: Asked[Path] = None
    """FLAME's file (.pkl or .npz, with its UV coordinates and masks beside it), or a template.npz, for a
    dataset without one."""
    out: Asked[Path] = None
    """Run folder; default runs/ and the name of the dataset's folder or of the video, or runs/built_in."""
    preset: Asked[PresetName] = None
    """Sizes: cpu (256 x 256, UV 128) or paper (512 x 512, UV 256); default cpu where there is no GPU."""
    epochs: Asked[int] = None
    """Passes over the training frames; default 4 with the cpu preset and 10 with the paper's, or as many as
    1,200 steps take."""
    max_steps: Asked[int] = None
    """Length of the run in steps, or, with --epochs, where it stops at the latest; all schedules follow the
    steps that will be run. With --resume, more steps (or epochs) than the run was to have extend it: from the
    step reached on, rates and density control are those of a run of the new length, and what has begun by
    then, such as normals and LPIPS, stays on."""
    resolution: Asked[int] = None
    """Image width and height in pixels; default the preset's."""
    device: Asked[DeviceName] = None
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one; default auto."""
    seed: Asked[int] = None
    """Seed of every random choice; default 42."""
    resume: bool = False
    """Go on from the run folder's last checkpoint, on whatever device; from the beginning if there is none
    yet."""
    split: Asked[str] = None
    """Train and test frames: the dataset's own, a fraction that trains, or last:N that tests; default
    dataset."""
    ablate: Asked[tuple[Ablation, ...]] = None
    """Parts of the method to leave out; default none."""
    lpips_weights: Asked[Path] = None
    """Folder with LPIPS backbone and linear-head files; default the hub cache or an installed lpips
    package."""
    color_space: Asked[Literal["srgb", "raw"]] = None
    """Shade in linear light and encode to sRGB, or shade directly in image values; default srgb."""
    tie_light: Asked[bool] = None
    """Learn one light for diffuse and specular shading, as a real light is; default one for each."""
    jitter: Asked[bool] = None
    """Let the motion network see each frame with another draw of the tracker's noise at every step, as large
    as the trajectory shows it; default not."""
    encoder: Asked[str] = None
    """Image encoder of the reference image: a hub id, a local folder, or random; default
    microsoft/resnet-18."""
    reference: Asked[Literal["uv", "screen"]] = None
    """What the encoder sees: the reference frame unwrapped into UV, or the frame itself; default uv."""
    displacement: Asked[Literal["head", "world"]] = None
    """Frame of the displacement map: without or with the head's rigid motion; default head."""
    residual_frame: Asked[Literal["world", "head"]] = None
    """Axes of the position and rotation residuals; default world."""
    normals: Asked[Literal["vertex", "face"]] = None
    """Initial normals: interpolated vertex normals, or the face's; default vertex."""
    gaussians: Asked[int] = None
    """Number of Gaussians at the start; default the preset's."""
    checkpoint_every: Asked[int] = None
    """Steps between checkpoints; default 500."""
    preview_every: Asked[int] = None
    """Steps between preview grids; default 250."""
