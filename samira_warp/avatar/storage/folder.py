"""The avatar's files: its description, tensors in safetensors, the head template, its light as two maps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from samira_warp.avatar.canonical import CanonicalHead
from samira_warp.avatar.gaussians import Gaussians
from samira_warp.avatar.settings import AvatarSettings
from samira_warp.avatar.storage.description import (
    DESCRIPTION_FILE,
    Description,
    read_description,
    write_description,
)
from samira_warp.avatar.storage.frames import FRAMES_FILE, read_frames
from samira_warp.avatar.storage.older import UNSMOOTHED
from samira_warp.head import HeadTemplate, read_template, save_template
from samira_warp.io.files import save_tensors
from samira_warp.light import Environment, LearnableLight
from samira_warp.nets import ConditionStatistics
from samira_warp.support.constants import SMOOTHING
from samira_warp.support.errors import UserError

TENSORS_FILE = "avatar.safetensors"
TEMPLATE_FILE = "template.npz"

_FEATURES = "motion.image_features_"
"""What precedes the levels of the reference features among the state's names."""


class StoredAvatar(NamedTuple):
    """The parts that an avatar is made of again, on the CPU.

    Attributes:
        settings: Its settings.
        canonical: The subject's head at rest.
        gaussians: Its Gaussians.
        image_features: The reference features, finest first.
        statistics: Of the right sizes; the state brings the values.
        light: Likewise.
        state: The module's state by name.
    """

    settings: AvatarSettings
    canonical: CanonicalHead
    gaussians: Gaussians
    image_features: list[Tensor]
    statistics: ConditionStatistics
    light: LearnableLight
    state: dict[str, Tensor]


def write_avatar(
    folder: Path,
    *,
    canonical: CanonicalHead,
    settings: AvatarSettings,
    state: dict[str, Tensor],
    light: Environment,
    record: dict[str, Any],
) -> None:
    """Write the files of an avatar into an existing folder.

    Args:
        folder: Where.
        canonical: The subject's head at rest; template, shape and static offset are kept.
        settings: The avatar's settings.
        state: The module's state by name.
        light: The learned light as it is rendered with.
        record: How it was made; plain JSON values.
    """
    tensors = {**state, "shape": canonical.shape}
    if canonical.static_offset is not None:
        tensors["static_offset"] = canonical.static_offset
    write_description(folder, settings=settings, record={**record, "template": canonical.template.hash})
    save_tensors(tensors, folder / TENSORS_FILE)
    save_template(canonical.template, folder / TEMPLATE_FILE)
    light.save(folder)


def read_avatar(folder: Path) -> StoredAvatar:
    """Read an avatar folder of any readable version.

    Raises:
        UserError: A file is missing, broken, or of an unknown version; the template is not the one that the
            avatar was made with.
        KeyError: A tensor is missing.
        TypeError: A setting is of another kind than it should be.
        RuntimeError: Tensors do not fit the settings.
    """
    description = read_description(folder)
    try:
        state = load_file(folder / TENSORS_FILE)
    except (OSError, SafetensorError) as error:
        raise UserError(folder / TENSORS_FILE, expected="the avatar's tensors", found=error) from error
    if description.version <= UNSMOOTHED:
        state["gaussians.guessed"] = torch.zeros(len(state["gaussians.faces"]), dtype=torch.bool)
    template = _read_template(folder, str(description.record.get("template")))
    settings = description.settings
    canonical = CanonicalHead.build(
        template,
        shape=state.pop("shape"),
        static_offset=state.pop("static_offset", None),
        uv_size=settings.uv_size,
    )
    if description.version <= UNSMOOTHED:
        settings = replace(settings, smoothing=_smoothing(folder, description, canonical))
    return StoredAvatar(
        settings=settings,
        canonical=canonical,
        gaussians=Gaussians({name: state[f"gaussians.{name}"] for name in Gaussians.NAMES}),
        image_features=[state[name] for name in sorted(state) if name.startswith(_FEATURES)],
        statistics=ConditionStatistics(
            expression_size=template.n_expression, pose_size=canonical.rig.pose_size
        ),
        light=_light(state, tied=settings.tied_light),
        state=state,
    )


def _smoothing(folder: Path, description: Description, canonical: CanonicalHead) -> float:
    """Metres by which to smooth an avatar that a wider low-pass was learned with, so that it looks as it did.

    0 where the folder does not say at which size it was trained, or has no frames.
    """
    resolution = description.record.get("settings", {}).get("resolution")
    if resolution is None or not (folder / FRAMES_FILE).is_file():
        return 0.0
    first = read_frames(folder)[0]
    camera = first.camera.with_longer_side(resolution)
    return SMOOTHING**0.5 * canonical.sampling_interval(first.parameters, camera)


@contextmanager
def naming_misfits(folder: Path) -> Iterator[None]:
    """A context that turns what an avatar's parts raise where they do not fit each other into a UserError."""
    try:
        yield
    except (KeyError, TypeError, RuntimeError) as error:
        misfit = str(error).splitlines()[-1].strip()
        raise UserError(
            folder / TENSORS_FILE, expected=f"tensors as {DESCRIPTION_FILE} describes them", found=misfit
        ) from error


def _read_template(folder: Path, recorded: str) -> HeadTemplate:
    template = read_template(folder / TEMPLATE_FILE)
    if template.hash != recorded:
        raise UserError(
            folder / TEMPLATE_FILE, expected=f"the template {recorded[:12]}", found=template.hash[:12]
        )
    return template


def _light(state: dict[str, Tensor], *, tied: bool) -> LearnableLight:
    """A light with maps of the stored ones' sizes."""
    sizes = {"specular_size": state["light.specular"].shape[1]}
    if not tied:
        sizes["diffuse_size"] = state["light.diffuse"].shape[1]
    return LearnableLight(torch.ones(3), tied=tied, **sizes)
