"""Every option of a training run with its value: as asked, else as the run was begun, else by default."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from samira_warp.avatar import AvatarSettings
from samira_warp.data.split import parse_split
from samira_warp.nets import MotionSettings
from samira_warp.support.devices import DeviceName, pick_device
from samira_warp.support.errors import UserError
from samira_warp.support.image_size import check_side
from samira_warp.train.config import PRESETS, Ablation, Preset, PresetName, TrainConfig

WHERE = ("data", "flame", "out", "device", "lpips_weights", "checkpoint_every", "preview_every")
"""Settings that may differ when a run goes on: where things are, not what is computed. Other data and another
head are known by their hashes."""

LENGTH = ("epochs", "max_steps")
"""Settings that may grow when a run goes on."""

POSITIVE = ("epochs", "max_steps", "resolution", "gaussians", "checkpoint_every", "preview_every")


@dataclass(frozen=True)
class Settings:
    """Every option of `TrainConfig` with its value; config.json keeps them.

    None is left where it is a value of its own: a ``flame`` of None is the dataset's own template,
    ``epochs`` and ``max_steps`` of None leave the length to each other, and both to the preset;
    ``lpips_weights`` of None is wherever they are usually kept.
    """

    data: Path
    out: Path
    device: str
    preset: PresetName
    resolution: int
    gaussians: int
    flame: Path | None = None
    epochs: int | None = None
    max_steps: int | None = None
    seed: int = 42
    split: str = "dataset"
    ablate: tuple[Ablation, ...] = ()
    lpips_weights: Path | None = None
    color_space: Literal["srgb", "raw"] = "srgb"
    tie_light: bool = False
    jitter: bool = False
    encoder: str = "microsoft/resnet-18"
    reference: Literal["uv", "screen"] = "uv"
    displacement: Literal["head", "world"] = "head"
    residual_frame: Literal["world", "head"] = "world"
    normals: Literal["vertex", "face"] = "vertex"
    checkpoint_every: int = 500
    preview_every: int = 250

    @property
    def sizes(self) -> Preset:
        """What the preset decides."""
        return PRESETS[self.preset]

    def steps(self, frames: int) -> int:
        """Length of a run on so many training frames."""
        limits = [self.max_steps, None if self.epochs is None else self.epochs * frames]
        return min((limit for limit in limits if limit is not None), default=self.sizes.steps(frames))

    @property
    def gaussian_cap(self) -> int:
        """Density control stops adding above this."""
        return max(self.sizes.gaussian_cap, self.gaussians)

    @property
    def avatar(self) -> AvatarSettings:
        """The avatar's settings: the preset's sizes, less what is ablated."""
        motion = MotionSettings(
            width=self.sizes.width,
            region_width=self.sizes.region_width,
            routing="no-routing" not in self.ablate,
            modulation="no-modulation" not in self.ablate,
            displacement="no-displacement" not in self.ablate,
            wrinkles="no-wrinkles" not in self.ablate,
        )
        return AvatarSettings(
            uv_size=self.sizes.uv_size,
            motion=motion,
            residual="no-residual" not in self.ablate,
            response="no-response" not in self.ablate,
            displacement_frame=self.displacement,
            residual_frame=self.residual_frame,
            color_space=self.color_space,
            tied_light=self.tie_light,
            visibility="no-visibility" not in self.ablate,
        )

    def as_json(self) -> dict[str, Any]:
        """JSON values by name; paths are absolute, for a run may go on from another working directory."""
        values = {
            name: str(value.absolute()) if isinstance(value, Path) else value
            for name, value in asdict(self).items()
        }
        return values | {"ablate": list(self.ablate)}


DEFAULTS: dict[str, Any] = {
    field.name: field.default for field in fields(Settings) if field.default is not MISSING
}
"""Values of options that were not asked for, where neither the preset nor the machine decides."""


def check_config(config: TrainConfig) -> None:
    """Raise UserError if an option is out of its range; nothing is looked at but the options."""
    for name in POSITIVE:
        value = getattr(config, name)
        if value is not None and value < 1:
            raise UserError(option(name), expected="a positive number", found=value)
    if config.resolution is not None:
        check_side(option("resolution"), config.resolution)
    if config.split is not None:
        parse_split(config.split)


def option(name: str) -> str:
    """A setting's name as it is typed."""
    return f"--{name.replace('_', '-')}"


def resolve(
    config: TrainConfig, *, data: Path, out: Path, begun: Mapping[str, Any] | None = None
) -> Settings:
    """Give every option its value: as it is asked for, else as the run was begun, else by default.

    Args:
        config: The options as asked.
        data: The dataset's folder.
        out: The run folder.
        begun: The settings by name of the run that goes on, None for a new one.

    Raises:
        UserError: An option contradicts the run that goes on, or a GPU is asked for where there is none.
    """
    asked = {name: value for name, value in vars(config).items() if name != "resume" and value is not None}
    for name, value in asked.items():
        if begun is not None and name not in (*WHERE, *LENGTH) and value != begun[name]:
            expected = f"{_typed(begun[name])} as the run was begun"
            raise UserError(f"{out}: {option(name)}", expected=expected, found=_typed(value))
    chosen = {**DEFAULTS, **(begun or {}), **asked}
    device = _device(config.device, None if begun is None else begun["device"])
    preset: PresetName = chosen.get("preset") or ("cpu" if device == "cpu" else "paper")
    sizes = {"resolution": PRESETS[preset].resolution, "gaussians": PRESETS[preset].gaussians}
    places = {"data": data, "out": out, "device": device, "preset": preset}
    return Settings(**{**sizes, **chosen, **places})


def settings_of(values: Mapping[str, Any], *, source: object) -> dict[str, Any]:
    """Read the settings of a run that was begun out of JSON values, as `Settings.as_json` writes them.

    Settings of other versions are left out, and those that were new since then have their defaults.

    Args:
        values: By name.
        source: Where they come from, for the message.

    Raises:
        UserError: A value is of another type than its setting, or missing without a default.
    """
    hints = get_type_hints(Settings)
    read = {
        **DEFAULTS,
        **{name: _read(value, hints[name]) for name, value in values.items() if name in hints},
    }
    for name, hint in hints.items():
        if not _fits(read.get(name), hint):
            raise UserError(
                f"{source}: {name}",
                expected="the setting that the run was begun with",
                found=repr(values.get(name)),
            )
    return read


def _read(value: Any, hint: Any) -> Any:
    """A JSON value as the type that a setting has."""
    if isinstance(value, str) and Path in (hint, *get_args(hint)):
        return Path(value)
    return tuple(value) if isinstance(value, list) else value


def _fits(value: Any, hint: Any) -> bool:
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if origin is Literal:
        return value in parts
    if origin is tuple:
        return isinstance(value, tuple) and all(_fits(item, parts[0]) for item in value)
    return isinstance(value, hint) and not (hint is int and isinstance(value, bool))


def _device(asked: DeviceName | None, begun: DeviceName | None) -> str:
    """The device asked for; else the one that the run was begun on, if this machine has it; else any."""
    if asked is None and begun is not None:
        with contextlib.suppress(UserError):
            return str(pick_device(begun))
    return str(pick_device(asked or "auto"))


def _typed(value: Any) -> str:
    """A setting's value as it is typed."""
    return " ".join(value) or "none" if isinstance(value, tuple) else str(value)
