"""From a plan and its dataset to an avatar that is ready for its first step."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch

from samira_warp.avatar import Avatar, CanonicalHead
from samira_warp.data import PixelCache, TrackedSequence
from samira_warp.data.appearance import TrackedAppearance
from samira_warp.light import LearnableLight, decode_srgb
from samira_warp.nets import encode_reference
from samira_warp.support.constants import SMOOTHING
from samira_warp.train.appearance import initial_appearance
from samira_warp.train.initialize import (
    choose_reference,
    condition_statistics,
    image_view,
    initial_albedo,
    initial_gaussians,
    sampling_interval,
    unwrap_views,
)
from samira_warp.train.plan import TrainPlan
from samira_warp.train.schedule import SHORT_RUN

INITIAL_OPACITY = 0.1
SHORT_RUN_OPACITY = 0.5
"""In short runs: a head at 0.1 starts transparent, and white leaks through it for hundreds of steps."""

PIXEL_CACHE_BYTES = 1 << 28
"""Decoded training frames kept in memory: some 1,200 of 256 x 256, or a fourth as many of 512 x 512, and what
fits of a longer sequence."""


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


def start(plan: TrainPlan, sequence: TrackedSequence, pixels: PixelCache) -> Start:
    """Build the avatar of step 0: exactly the mesh-bound one (the residual is zero).

    Args:
        plan: The run.
        sequence: The dataset.
        pixels: Its frames at the training size.
    """
    settings = plan.settings
    torch.manual_seed(settings.seed)
    generator = torch.Generator().manual_seed(settings.seed)
    canonical = CanonicalHead.build(
        sequence.template,
        shape=sequence.shape,
        static_offset=sequence.static_offset,
        uv_size=settings.sizes.uv_size,
    )
    statistics = condition_statistics(sequence)
    index = choose_reference(sequence, canonical, statistics)
    view = image_view(sequence, pixels, canonical, index)
    unwrapped = unwrap_views([view], canonical)
    features, encoder = encode_reference(
        view.image if settings.reference == "screen" else unwrapped, encoder=settings.encoder
    )
    albedo, light = _albedo_and_light(plan, sequence, pixels, canonical, index, unwrapped)
    gaussians = initial_gaussians(
        canonical,
        count=settings.gaussians,
        opacity=SHORT_RUN_OPACITY if plan.schedule.steps < SHORT_RUN else INITIAL_OPACITY,
        albedo=albedo,
        smooth_normals=settings.normals == "vertex",
        generator=generator,
    )
    interval = sampling_interval(sequence, canonical, resolution=settings.resolution)
    avatar = Avatar(
        canonical,
        replace(settings.avatar, smoothing=SMOOTHING**0.5 * interval),
        gaussians=gaussians,
        image_features=features,
        statistics=statistics,
        light=light,
    )
    return Start(avatar.to(settings.device), sequence.frames[index].name, encoder)


def tracked_start(plan: TrainPlan, sequence: TrackedSequence) -> TrackedAppearance | None:
    """The tracker's albedo and light where a run starts from them.

    It starts from albedo files where there are any, and from the picture where that is shaded as it is.
    """
    files = any(sequence.frames[index].albedo_path for index in sequence.train)
    return None if files or plan.settings.color_space != "srgb" else sequence.appearance


def _albedo_and_light(
    plan: TrainPlan,
    sequence: TrackedSequence,
    pixels: PixelCache,
    canonical: CanonicalHead,
    reference: int,
    unwrapped: torch.Tensor,
) -> tuple[torch.Tensor, LearnableLight]:
    """(h, w, 3) albedo texture as it is shaded, and the light.

    They are the tracker's where it left any and there are no albedo files; else albedo is that of files, or
    the reference image, (h, w, 3) ``unwrapped``, and the light is uniform.
    """
    settings, tracked = plan.settings, tracked_start(plan, sequence)
    if tracked is not None:
        started = initial_appearance(sequence, pixels, canonical, tracked, reference=reference)
        return started.albedo, LearnableLight.from_harmonics(started.light, tied=settings.tie_light)
    decode = decode_srgb if settings.color_space == "srgb" else torch.clone
    appearance, albedo = decode(unwrapped), decode(initial_albedo(sequence, pixels, canonical, unwrapped))
    return albedo, LearnableLight(_mean_light(appearance, albedo, canonical), tied=settings.tie_light)


def _mean_light(appearance: torch.Tensor, albedo: torch.Tensor, canonical: CanonicalHead) -> torch.Tensor:
    """(3,) radiance of the uniform light under which (h, w, 3) albedo has the appearance's mean colour."""
    valid = canonical.atlas.valid
    return appearance[valid].mean(dim=0) / albedo[valid].mean(dim=0).clamp(min=1e-3)
