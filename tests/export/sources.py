"""What a format is written from, made without a run: the made-up head and frames of it."""

from dataclasses import replace
from pathlib import Path

import torch
from subjects import camera, parameters, small_avatar

from samira_warp.avatar import DrivingFrame, write_frames
from samira_warp.export.config import ExportConfig
from samira_warp.export.source import ExportSource


def made_source(avatar=None, *, frames=3, size=48, **options):
    """The source of an avatar, a made-up one unless given, under no light."""
    avatar = avatar or small_avatar(perturb=0.2)
    driving = tuple(
        DrivingFrame(f"{seed:05d}", parameters(seed), camera(size), "test" if seed == 0 else "train")
        for seed in range(frames)
    )
    config = ExportConfig(avatar=Path("run"), out=Path("out"), albedo=True, **options)
    return ExportSource(
        config, Path("run/avatar"), avatar, driving, driving, light=None, shadows=False, tone_map="none"
    )


def with_template(avatar, **changed):
    """Change arrays of an avatar's template, and its rig with them."""
    canonical = avatar.canonical
    template = replace(canonical.template, **changed)
    avatar.canonical = type(canonical).build(
        template, shape=canonical.shape, static_offset=None, uv_size=canonical.atlas.size
    )
    avatar.set_gaussians(avatar.gaussians)
    return avatar


def saved_avatar(folder):
    """Save an avatar whose colours go over the head evenly, with two test frames and two training frames."""
    avatar = small_avatar(gaussians=1500)
    canonical, own = avatar.canonical, avatar.gaussians
    low, high = canonical.vertices.amin(dim=0), canonical.vertices.amax(dim=0)
    centers = canonical.vertices[canonical.topology.faces.long()].mean(dim=1)
    with torch.no_grad():
        own.albedo_logits[:] = torch.logit(0.1 + 0.6 * ((centers - low) / (high - low))[own.faces.long()])
    folder.mkdir()
    avatar.save(folder, record={"subject": "tiny", "split": "dataset"})
    parts = ("test", "test", "train", "train")
    frames = [
        DrivingFrame(f"{seed:05d}", parameters(seed), camera(48), part) for seed, part in enumerate(parts)
    ]
    write_frames(folder, frames)
