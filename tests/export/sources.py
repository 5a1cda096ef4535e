"""What a format is written from, made without a run: the made-up head and frames of it."""

from dataclasses import replace
from pathlib import Path

from subjects import camera, parameters, small_avatar

from samira_warp.avatar import DrivingFrame
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
