"""Every setting of a training run, the presets, and the rates that follow from the run's length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

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
]


@dataclass(frozen=True)
class Preset:
    """What a preset decides; any of it can be set by its own option.

    Attributes:
        resolution: Width and height of the training images, pixels.
        uv_size: Width and height of the UV maps.
        gaussians: Number of Gaussians at the start.
        gaussian_cap: Density control stops adding above this.
        width: Channels of the motion network's shared features.
        region_width: Channels of each region's features.
    """

    resolution: int
    uv_size: int
    gaussians: int
    gaussian_cap: int
    width: int
    region_width: int


PRESETS = {
    "cpu": Preset(
        resolution=256, uv_size=128, gaussians=20_000, gaussian_cap=40_000, width=24, region_width=8
    ),
    "paper": Preset(
        resolution=512, uv_size=256, gaussians=65_536, gaussian_cap=200_000, width=64, region_width=32
    ),
}


@dataclass(frozen=True)
class TrainConfig:
    """Train a relightable, animatable avatar from a tracked video of a head."""

    data: Path | None = None
    """Dataset folder: a VHAP export or any other format that samira_warp.check knows; default the built-in
    subject."""
    flame: Path | None = None
    """FLAME's file (.pkl or .npz, with its UV coordinates and masks beside it), or a template.npz, for a
    dataset without one."""
    out: Path | None = None
    """Run folder; default runs/ and the name of the dataset's folder, or runs/built_in."""
    preset: Literal["cpu", "paper"] | None = None
    """Sizes: cpu (256 x 256, UV 128) or paper (512 x 512, UV 256); default cpu where there is no GPU."""
    epochs: int = 10
    """Passes over the training frames."""
    max_steps: int | None = None
    """Stop after so many steps; all schedules follow the steps that will be run."""
    resolution: int | None = None
    """Image width and height in pixels; default the preset's."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""
    seed: int = 42
    """Seed of every random choice."""
    resume: bool = False
    """Go on from the run folder's last checkpoint."""
    split: str = "dataset"
    """Train and test frames: the dataset's own, a fraction that trains, or last:N that tests."""
    ablate: tuple[Ablation, ...] = ()
    """Parts of the method to leave out."""
    lpips_weights: Path | None = None
    """Folder with LPIPS backbone and linear-head files; default the hub cache or an installed lpips
    package."""
    color_space: Literal["srgb", "raw"] = "srgb"
    """Shade in linear light and encode to sRGB, or shade directly in image values."""
    tie_light: bool = False
    """Learn one light for diffuse and specular shading, as a real light is, instead of one for each."""
    encoder: str = "microsoft/resnet-18"
    """Image encoder of the reference image: a hub id, a local folder, or random."""
    reference: Literal["uv", "screen"] = "uv"
    """What the encoder sees: the reference frame unwrapped into UV, or the frame itself."""
    displacement: Literal["head", "world"] = "head"
    """Frame of the displacement map: without or with the head's rigid motion."""
    residual_frame: Literal["world", "head"] = "world"
    """Axes of the position and rotation residuals."""
    normals: Literal["vertex", "face"] = "vertex"
    """Initial normals: interpolated vertex normals, or the face's."""
    gaussians: int | None = None
    """Number of Gaussians at the start; default the preset's."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""
    preview_every: int = 250
    """Steps between preview grids."""


@dataclass(frozen=True)
class Rate:
    """A learning rate in a long run and in a short one, each from its start to its end, along a cosine."""

    long: tuple[float, float]
    short: tuple[float, float]


SHORT_RUN = 10_000
"""Steps; below it the short rates hold: Adam at 2e-4 moves a value by 0.3 at most in 3,000 steps."""

LONG_RUN = 30_000
"""Steps; from here on the paper's rates hold; between the two they are log-interpolated."""

WARM_UP = 0.02
"""Share of the run over which every rate rises from zero."""


def constant(value: float) -> Rate:
    """The same rate throughout, in every run."""
    return Rate((value, value), (value, value))


RATES = {
    "means": Rate((5e-3, 5e-5), (5e-3, 5e-5)),
    "log_scales": constant(0.017),
    "quaternions": constant(1e-3),
    "opacity_logits": constant(0.05),
    "albedo_logits": constant(5e-3),
    "roughness_logits": constant(5e-3),
    "specular_logits": constant(5e-3),
    "normals": constant(1e-3),
    "response": constant(1e-3),
    "network": Rate((1e-4, 1e-5), (2e-3, 1e-4)),
    "light": Rate((2e-4, 2e-5), (1e-2, 1e-3)),
    "expression": Rate((1e-3, 1e-3), (1e-5, 1e-5)),
    "pose": Rate((1e-5, 1e-5), (3e-5, 3e-5)),
    "translation": Rate((1e-6, 1e-6), (5e-6, 5e-6)),
}
"""By parameter group: GaussianAvatars' for geometry and tracking, HRAvatar's for materials, the paper's for
network and light.

In short runs, rigid tracking moves faster, so that its noise is out of the way before the network learns, and
expressions move slower, so that what repeats with an expression is left to the network instead of being tuned
away frame by frame (docs/measurements.md).
"""


def learning_rate(group: str, *, step: int, steps: int) -> float:
    """The rate of a parameter group at one step: warm-up, then a cosine from the rate's start to its end."""
    rate = RATES[group]
    share = min(max(math.log(steps / SHORT_RUN) / math.log(LONG_RUN / SHORT_RUN), 0.0), 1.0)
    first, last = (
        short ** (1.0 - share) * long**share for short, long in zip(rate.short, rate.long, strict=True)
    )
    warm_up = max(WARM_UP * steps, 1.0)
    cosine = 0.5 * (1.0 + math.cos(math.pi * min(step / steps, 1.0)))
    return min((step + 1) / warm_up, 1.0) * (last + (first - last) * cosine)


@dataclass(frozen=True)
class LossWeights:
    """Weights of the training objective (Eqs. rgb to total_loss), and the terms of our own."""

    ssim: float = 0.2
    """lambda_1 of Eq. rgb."""
    lpips: float = 0.05
    """lambda_2 of Eq. rgb."""
    normal_smoothness: float = 0.15
    """lambda_3 of Eq. normal_loss."""
    normal_prior: float = 0.1
    """lambda_4 of Eq. normal_loss."""
    albedo: float = 0.1
    """lambda_5 of Eq. albedo_loss."""
    mask: float = 0.1
    """L1 of alpha against the matte: on white, low opacity buys highlights, and relit faces would leak
    white."""
    residual: float = 0.1
    """Mean square of the UV residual as a share of its limits: without it the network drifts by millimetres
    that the Gaussians' means take back, and memorises the tracker's noise frame by frame
    (docs/measurements.md)."""
    response: float = 1e-3
    """Prior on the squared response logits: (albedo / c, c tau) looks the same until the light changes."""


@dataclass(frozen=True)
class Schedule:
    """Events of a run, as shares of its steps."""

    steps: int
    stage_two: float = field(default=0.3)
    """Canonical normals and response factors are frozen before this share of the run."""
    perceptual: float = 0.5
    """LPIPS is on from here, where its weights are to be had."""
    density: tuple[float, float] = (0.1, 0.6)
    """The window of density control."""
    density_every: float = 0.025
    """Share of the run between density control events."""
    density_pause: float = 0.05
    """No event for this share after stage two begins: normals and responses settle first."""
    opacity_reset_from: int = 20_000
    """Opacity is reset only in runs longer than this many steps; a shorter run never recovers."""
    opacity_reset_every: int = 3_000
    """Steps between opacity resets (3DGS)."""

    def in_stage_two(self, step: int) -> bool:
        """Whether normals and response factors learn at this step."""
        return step >= self.stage_two * self.steps

    def perceptual_on(self, step: int) -> bool:
        """Whether LPIPS is part of the loss at this step."""
        return step >= self.perceptual * self.steps

    def density_window(self, step: int) -> bool:
        """Whether density statistics are gathered at this step."""
        return self.density[0] * self.steps <= step < self.density[1] * self.steps

    def density_event(self, step: int) -> bool:
        """Whether Gaussians are added and removed after this step."""
        every = max(round(self.density_every * self.steps), 1)
        paused = 0 <= step - self.stage_two * self.steps < self.density_pause * self.steps
        return self.density_window(step) and (step + 1) % every == 0 and not paused

    def density_ends(self, step: int) -> bool:
        """Whether this is the last step of the density window."""
        return self.density_window(step) and not self.density_window(step + 1)

    def opacity_reset(self, step: int) -> bool:
        """Whether opacities are reset after this step."""
        return (
            self.steps > self.opacity_reset_from
            and self.density_window(step)
            and (step + 1) % self.opacity_reset_every == 0
        )
