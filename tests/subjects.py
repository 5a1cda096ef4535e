"""Small subjects that tests pose, train and render.

``python tests/subjects.py OPTIONS`` is ``python -m samira_warp.train OPTIONS`` with a preset that takes a
fraction of a second a step.
"""

import contextlib
import functools
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

TESTS = Path(__file__).resolve().parent
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

from data.tiny import N_EXPRESSION, N_SHAPE, tiny_template  # noqa: E402

from samira_warp.avatar import Avatar, AvatarSettings, CanonicalHead, conditions_of  # noqa: E402
from samira_warp.evaluate.lpips import _BACKBONES, _backbone_shapes, _head_shapes  # noqa: E402
from samira_warp.geometry.camera import Camera  # noqa: E402
from samira_warp.head import FLAME_JOINTS, FrameParameters, read_template  # noqa: E402
from samira_warp.light import LearnableLight  # noqa: E402
from samira_warp.nets import ConditionStatistics, MotionSettings  # noqa: E402
from samira_warp.render.__main__ import main as render_main  # noqa: E402
from samira_warp.render.config import RenderConfig  # noqa: E402
from samira_warp.support.cli import run  # noqa: E402
from samira_warp.train.__main__ import main as train_main  # noqa: E402
from samira_warp.train.config import PRESETS, Preset, TrainConfig  # noqa: E402
from samira_warp.train.initialize import initial_gaussians  # noqa: E402

SMALL = Preset(
    resolution=32,
    uv_size=32,
    gaussians=300,
    gaussian_cap=400,
    width=8,
    region_width=4,
    epochs=10,
    least_steps=1,
)
STEPS = 6


@contextlib.contextmanager
def small_preset():
    before, PRESETS["cpu"] = PRESETS["cpu"], SMALL
    try:
        yield
    finally:
        PRESETS["cpu"] = before


def train_arguments(data, out, *more):
    """Options of a run of STEPS steps with a checkpoint in its middle."""
    sizes = ["--max-steps", str(STEPS), "--checkpoint-every", "3", "--preview-every", "3"]
    return [
        "--data",
        str(data),
        "--out",
        str(out),
        "--preset",
        "cpu",
        "--device",
        "cpu",
        "--encoder",
        "random",
        *sizes,
        *map(str, more),
    ]


def train_command(*arguments):
    """The train verb in this process, with the small preset; its exit status."""
    with small_preset():
        return run(
            train_main, TrainConfig, program="python -m samira_warp.train", arguments=[*map(str, arguments)]
        )


@functools.cache
def small_template():
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "template.npz", **tiny_template())
        return read_template(Path(folder) / "template.npz")


@functools.cache
def small_canonical(uv_size=32):
    return CanonicalHead.build(
        small_template(), shape=torch.full((N_SHAPE,), 0.1), static_offset=None, uv_size=uv_size
    )


def parameters(seed, *, turn=0.3, device="cpu"):
    """A frame with every parameter in play."""
    generator = torch.Generator().manual_seed(seed)

    def draw(size, scale):
        return (scale * torch.randn(size, generator=generator)).to(device)

    translation = draw(3, 0.01)
    poses = [draw(3, turn), draw(3, turn), draw(3, 0.1), draw(6, 0.1)]
    return FrameParameters(translation, torch.cat(poses).view(-1, 3), draw(N_EXPRESSION, 0.7))


def posed(frame, **rotations):
    """The parameters with other rotations of some of FLAME's joints, by name."""
    changed = frame.rotations.clone()
    for name, rotation in rotations.items():
        changed[..., FLAME_JOINTS.index(name), :] = torch.as_tensor(rotation).to(changed)
    return replace(frame, rotations=changed)


def pose_of(frame, name):
    """(3,) rotation of one of FLAME's joints."""
    return frame.rotations[..., FLAME_JOINTS.index(name), :]


def camera(size=32, *, height=None, device="cpu"):
    """A camera at one metre, in front of the head."""
    world_to_camera = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    world_to_camera[2, 3] = 1.0
    height = height or size
    return Camera(world_to_camera.to(device), 2.8 * size, 2.8 * size, 0.5 * size, 0.5 * height, size, height)


def small_avatar(*, gaussians=200, perturb=0.0, motion=None, light_sizes=None, device="cpu", **settings):
    """An avatar on the made-up template, with random albedo and image features.

    ``perturb`` is the scale of random weights in the last layer, which gives the motion network something to
    say; ``light_sizes`` makes the learnable cubemaps smaller than an avatar that is saved may have them.
    """
    generator = torch.Generator().manual_seed(7)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        canonical = small_canonical()
        size = canonical.atlas.size
        start = initial_gaussians(
            canonical,
            count=gaussians,
            opacity=0.7,
            albedo=torch.rand(size, size, 3, generator=generator),
            smooth_normals=True,
            generator=generator,
        )
        features = [
            torch.randn(1, channels, width, width, generator=generator)
            for channels, width in zip((4, 6, 8), (16, 8, 4), strict=True)
        ]
        avatar = Avatar(
            canonical,
            AvatarSettings(
                uv_size=size,
                motion=motion
                or MotionSettings(width=8, region_width=4, condition_width=8, bands=3, displacement_bands=3),
                **settings,
            ),
            gaussians=start,
            image_features=features,
            statistics=ConditionStatistics.of(
                conditions_of(FrameParameters.stack([parameters(seed) for seed in range(6)]))
            ),
            light=LearnableLight(
                torch.tensor([1.0, 0.9, 0.8]), tied=settings.get("tied_light", False), **(light_sizes or {})
            ),
        )
        if perturb:
            torch.nn.init.normal_(avatar.motion.residual.weight, std=perturb)
            torch.nn.init.normal_(avatar.motion.residual.bias, std=perturb)
    return avatar.to(device)


def render_command(*arguments, device="cpu"):
    """The render verb in this process; its exit status."""
    program = "python -m samira_warp.render"
    return run(
        render_main, RenderConfig, program=program, arguments=[*map(str, arguments), "--device", device]
    )


def write_lpips_weights(folder, net):
    """Files of the right layout with random weights."""
    generator = torch.Generator().manual_seed(0)
    folder.mkdir()
    for name, shapes in (
        (_BACKBONES[net].file, _backbone_shapes(net)),
        (_BACKBONES[net].head_file, _head_shapes(net)),
    ):
        torch.save(
            {key: 0.05 * torch.rand(shape, generator=generator) for key, shape in shapes.items()},
            folder / name,
        )
    return folder


SMALL_LIGHT = {"diffuse_size": 8, "specular_size": 16}


if __name__ == "__main__":
    sys.exit(train_command(*sys.argv[1:]))
