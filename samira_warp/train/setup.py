"""From a configuration and a dataset to an avatar that is ready for its first step."""

from __future__ import annotations

import platform
from dataclasses import asdict, replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch

from samira_warp.avatar import Avatar, AvatarSettings, CanonicalHead, conditions_of
from samira_warp.data import PixelCache, Sequence
from samira_warp.data.split import parse_split
from samira_warp.light import LearnableLight, decode_srgb
from samira_warp.nets import MotionSettings, encode_reference
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError
from samira_warp.train.config import PRESETS, SHORT_RUN, LossWeights, TrainConfig
from samira_warp.train.initialize import (
    choose_reference,
    condition_statistics,
    image_view,
    initial_albedo,
    initial_gaussians,
    unwrap_views,
)

INITIAL_OPACITY = 0.1
SHORT_RUN_OPACITY = 0.5
"""In short runs: a head at 0.1 starts transparent, and white leaks through it for hundreds of steps."""

PIXEL_CACHE_BYTES = 1 << 30
"""Decoded training frames kept in memory: all of a short sequence, a share of a long one."""


class Start(NamedTuple):
    """What a run starts from.

    Attributes:
        avatar: The avatar, on its device.
        reference: Name of the reference frame.
        encoder: What made the reference features.
    """

    avatar: Avatar
    reference: str
    encoder: str


def resolve(config: TrainConfig) -> TrainConfig:
    """Fill in what the preset and the machine decide; ``data`` stays None where the built-in subject is
    meant.

    Raises:
        UserError: A value is out of range, or a GPU is asked for where there is none.
    """
    device = pick_device(config.device)
    preset = config.preset or ("paper" if device.type == "cuda" else "cpu")
    sizes = PRESETS[preset]
    config = replace(
        config,
        device=str(device),
        preset=preset,
        resolution=sizes.resolution if config.resolution is None else config.resolution,
        gaussians=sizes.gaussians if config.gaussians is None else config.gaussians,
    )
    for name in ("epochs", "max_steps", "resolution", "gaussians", "checkpoint_every", "preview_every"):
        value = getattr(config, name)
        if value is not None and value < 1:
            raise UserError(f"--{name.replace('_', '-')}", expected="a positive number", found=value)
    parse_split(config.split)
    subject = "built_in" if config.data is None else config.data.resolve().name
    return replace(config, out=config.out or Path("runs") / subject)


def image_size(sequence: Sequence, resolution: int) -> tuple[int, int]:
    """Width and height of the training images: the longer side is ``resolution``."""
    camera = sequence.frames[0].camera
    scale = resolution / max(camera.width, camera.height)
    return max(round(camera.width * scale), 1), max(round(camera.height * scale), 1)


def avatar_settings(config: TrainConfig) -> AvatarSettings:
    """The avatar's settings: the preset's sizes, less what is ablated."""
    sizes = PRESETS[config.preset]
    motion = MotionSettings(
        width=sizes.width,
        region_width=sizes.region_width,
        routing="no-routing" not in config.ablate,
        modulation="no-modulation" not in config.ablate,
        displacement="no-displacement" not in config.ablate,
    )
    return AvatarSettings(
        uv_size=sizes.uv_size,
        motion=motion,
        residual="no-residual" not in config.ablate,
        response="no-response" not in config.ablate,
        displacement_frame=config.displacement,
        residual_frame=config.residual_frame,
        color_space=config.color_space,
        tied_light=config.tie_light,
    )


def loss_weights(config: TrainConfig) -> LossWeights:
    """The objective's weights, less what is ablated."""
    weights = LossWeights()
    for ablation, term in (("no-normal-prior", "normal_prior"), ("no-albedo", "albedo"), ("no-mask", "mask")):
        if ablation in config.ablate:
            weights = replace(weights, **{term: 0.0})
    return weights


def start(config: TrainConfig, sequence: Sequence, pixels: PixelCache, *, steps: int) -> Start:
    """Build the avatar of step 0: exactly the mesh-bound one (the residual is zero).

    Args:
        config: Resolved settings.
        sequence: The dataset.
        pixels: Its frames at the training size.
        steps: Length of the run.
    """
    torch.manual_seed(config.seed)
    generator = torch.Generator().manual_seed(config.seed)
    settings = avatar_settings(config)
    canonical = CanonicalHead.build(
        sequence.template,
        shape=sequence.shape,
        static_offset=sequence.static_offset,
        uv_size=settings.uv_size,
    )
    statistics = condition_statistics(sequence)
    index = choose_reference(sequence, canonical, statistics)
    view = image_view(sequence, pixels, canonical, index)
    unwrapped = unwrap_views([view], canonical)
    features, encoder = encode_reference(
        view.image if config.reference == "screen" else unwrapped, encoder=config.encoder
    )
    decode = decode_srgb if config.color_space == "srgb" else torch.clone
    appearance, albedo = decode(unwrapped), decode(initial_albedo(sequence, pixels, canonical, unwrapped))
    gaussians = initial_gaussians(
        canonical,
        count=config.gaussians,
        opacity=SHORT_RUN_OPACITY if steps < SHORT_RUN else INITIAL_OPACITY,
        albedo=albedo,
        smooth_normals=config.normals == "vertex",
        generator=generator,
    )
    light = LearnableLight(_mean_light(appearance, albedo, canonical), tied=config.tie_light)
    avatar = Avatar(
        canonical, settings, gaussians=gaussians, image_features=features, statistics=statistics, light=light
    )
    return Start(avatar.to(config.device), sequence.frames[index].name, encoder)


def _mean_light(appearance: torch.Tensor, albedo: torch.Tensor, canonical: CanonicalHead) -> torch.Tensor:
    """(3,) radiance of the uniform light that gives the mean colour of (h, w, 3) appearance to (h, w, 3)
    albedo.
    """
    valid = canonical.atlas.valid
    return appearance[valid].mean(dim=0) / albedo[valid].mean(dim=0).clamp(min=1e-3)


def plain_settings(config: TrainConfig) -> dict[str, Any]:
    """A configuration as JSON values."""
    return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(config).items()}


def run_facts(config: TrainConfig, sequence: Sequence, *, steps: int, perceptual: bool) -> dict[str, Any]:
    """How a run is made: every setting, what it trains on, versions and threads, as plain JSON values."""
    packages = ("samira-warp", "torch", "warp-lang", "numpy", "kornia", "transformers")
    return {
        "subject": sequence.root.resolve().name,
        "split": config.split,
        "settings": plain_settings(config),
        "steps": steps,
        "train_frames": len(sequence.train),
        "test_frames": len(sequence.test),
        "frames_hash": _frames_hash(sequence),
        "perceptual": perceptual,
        "template_hash": sequence.template.hash,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "torch_threads": torch.get_num_threads(),
    }


def _frames_hash(sequence: Sequence) -> str:
    """Digest of the subject's shape and of every frame's name and tracked head: FLAME's template and a frame
    count are many subjects'.
    """
    digest = sha256(sequence.shape.numpy().tobytes())
    for index in (*sequence.train, *sequence.test):
        frame = sequence.frames[index]
        digest.update(frame.name.encode())
        for values in conditions_of(frame.parameters):
            digest.update(values.numpy().tobytes())
    return digest.hexdigest()
