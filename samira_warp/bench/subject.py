"""A stand-in subject for benchmarks: an ellipsoid head in FLAME's layout.

Its size is realistic, and it has everything an avatar needs.
"""

from __future__ import annotations

import numpy as np
import torch

from samira_warp.avatar import Avatar, AvatarSettings, CanonicalHead, conditions_of
from samira_warp.geometry.camera import Camera
from samira_warp.head import FLAME_JOINTS, FrameParameters, HeadTemplate
from samira_warp.light import LearnableLight
from samira_warp.nets import ConditionStatistics, MotionSettings, encode_reference
from samira_warp.train.config import PRESETS, PresetName
from samira_warp.train.initialize import initial_gaussians

RINGS, SEGMENTS = 70, 71
"""About 5,000 vertices and 10,000 faces, as FLAME has."""

HALF_AXES = (0.075, 0.11, 0.09)
"""Metres."""

EXPRESSIONS = 50

FOCAL_SHARE = 2.8
"""Focal length over image width: a head at 1 m fills the frame as a portrait does."""


def make_template() -> HeadTemplate:
    """An ellipsoid with 50 smooth random expressions, a rectangular atlas, and latitudes for regions."""
    generator = np.random.default_rng(0)
    v, u = np.meshgrid(np.linspace(0.0, 1.0, RINGS), np.linspace(0.0, 1.0, SEGMENTS), indexing="ij")
    polar, azimuth = np.pi * (0.02 + 0.96 * v.ravel()), 2.0 * np.pi * u.ravel()
    unit = np.stack(
        [-np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], axis=1
    )
    vertices = unit * HALF_AXES
    waves = generator.normal(scale=2.0, size=(EXPRESSIONS, 3))
    bumps = 1e-3 * np.sin(unit @ waves.T + generator.uniform(0, 6, EXPRESSIONS))
    shapedirs = unit[:, :, None] * bumps[:, None, :]
    index = np.arange(RINGS * SEGMENTS).reshape(RINGS, SEGMENTS)
    a, b, c, d = (
        index[:-1, :-1].ravel(),
        index[1:, :-1].ravel(),
        index[1:, 1:].ravel(),
        index[:-1, 1:].ravel(),
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    count, joints, neck = len(vertices), len(FLAME_JOINTS), FLAME_JOINTS.index("neck")
    weights = np.zeros((count, joints))
    weights[:, neck] = 1.0
    bands = ("scalp", "forehead", "left_eye_region", "nose", "lips", "face", "neck", "boundary")
    band = np.minimum((v.ravel() * len(bands)).astype(int), len(bands) - 1)
    return HeadTemplate(
        v_template=vertices.astype(np.float32),
        shapedirs=shapedirs.astype(np.float32),
        n_shape=0,
        posedirs=np.zeros((count, 3, 9 * (joints - 1)), np.float32),
        joint_regressor=np.full((joints, count), 1.0 / count, np.float32),
        parents=np.array([-1, 0, 1, 1, 1], np.int32),
        weights=weights.astype(np.float32),
        faces=faces,
        vt=np.stack([0.02 + 0.96 * u.ravel(), 0.98 - 0.96 * v.ravel()], axis=1).astype(np.float32),
        ft=faces.copy(),
        masks={name: np.flatnonzero(band == number).astype(np.int32) for number, name in enumerate(bands)},
        expression_names=tuple(f"expression_{number}" for number in range(EXPRESSIONS)),
        joint_names=FLAME_JOINTS,
        head_joint="neck",
    )


def make_parameters(seed: int, expressions: int = EXPRESSIONS) -> FrameParameters:
    """A random expression and a slight turn of the head, of FLAME's joints."""
    generator = torch.Generator().manual_seed(seed)
    rotations = torch.zeros(len(FLAME_JOINTS), 3)
    rotations[FLAME_JOINTS.index("neck")] = 0.2 * torch.randn(3, generator=generator)
    return FrameParameters(
        translation=torch.zeros(3),
        rotations=rotations,
        expression=torch.rand(expressions, generator=generator),
    )


def make_camera(size: int) -> Camera:
    """A square camera at one metre, looking at the head."""
    world_to_camera = torch.tensor([[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, 1.0], [0, 0, 0, 1.0]])
    return Camera(world_to_camera, FOCAL_SHARE * size, FOCAL_SHARE * size, 0.5 * size, 0.5 * size, size, size)


def make_avatar(
    preset: PresetName, *, device: torch.device | str, template: HeadTemplate | None = None
) -> Avatar:
    """An avatar of a preset's sizes, with opaque grey Gaussians and random reference features.

    Args:
        preset: Whose sizes.
        device: Where it is made.
        template: Its head, with FLAME's joints; None for `make_template`'s.
    """
    sizes, template = PRESETS[preset], template or make_template()
    canonical = CanonicalHead.build(
        template, shape=torch.zeros(template.n_shape), static_offset=None, uv_size=sizes.uv_size
    )
    grey = torch.full((sizes.uv_size, sizes.uv_size, 3), 0.5)
    gaussians = initial_gaussians(
        canonical,
        count=sizes.gaussians,
        opacity=0.7,
        albedo=grey,
        smooth_normals=True,
        generator=torch.Generator().manual_seed(0),
    )
    features, _ = encode_reference(grey, encoder="random")
    settings = AvatarSettings(
        uv_size=sizes.uv_size, motion=MotionSettings(width=sizes.width, region_width=sizes.region_width)
    )
    frames = FrameParameters.stack([make_parameters(seed, template.n_expression) for seed in range(8)])
    statistics = ConditionStatistics.of(conditions_of(frames))
    light = LearnableLight(torch.ones(3))
    return Avatar(
        canonical, settings, gaussians=gaussians, image_features=features, statistics=statistics, light=light
    ).to(device)
