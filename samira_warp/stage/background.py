"""What is behind the head."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.io.images import is_linear, read_on_white, resize_box
from samira_warp.light import ColorSpace, Environment, encode_srgb
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError
from samira_warp.support.tone_names import ToneMap

GREYS = {"white": 1.0, "black": 0.0}


class Background:
    """A colour, a picture, the environment as the camera sees it, or nothing; in display values."""

    def __init__(self, name: str, *, color_space: ColorSpace = "srgb", tone_map: ToneMap = "none") -> None:
        """Read the picture, if it is one.

        Args:
            name: white, black, a colour (red,green,blue from 0 to 1, or #rrggbb), transparent, env or an
                image file.
            color_space: What shading works in, as a picture of the environment is shown.
            tone_map: What the head is shown by, and the environment with it.

        Raises:
            UserError: It is none of these.
        """
        self._name, self._color_space, self._tone_map = name, color_space, tone_map
        self._color = None if name in ("env", "transparent") else _color(name)
        plain = name in ("env", "transparent") or self._color is not None
        self._picture = None if plain else _Picture(name)

    @property
    def transparent(self) -> bool:
        """Whether nothing is behind the head; what is shaded before it is laid on black."""
        return self._name == "transparent"

    def seen_of(self, environment: Environment) -> RadianceMap | None:
        """What is seen of an environment, in display values; None where it is not behind the head."""
        if self._name != "env":
            return None
        return environment.display_map(color_space=self._color_space, tone_map=self._tone_map)

    def behind(self, camera: Camera, seen: RadianceMap | None, *, rotate: float = 0.0) -> Tensor | float:
        """A grey, (3,) a colour, or (H, W, 3): the picture, or the environment as the camera sees it.

        Args:
            camera: The view.
            seen: What `seen_of` gave for the light.
            rotate: Degrees by which the light is turned.
        """
        if seen is not None:
            return seen.behind(camera, rotate=rotate)
        if self._picture is not None:
            return self._picture.fill(camera)
        if self._color is None:
            return 0.0
        return torch.tensor(self._color, device=camera.world_to_camera.device)


_EXPECTED = (
    "white, black, transparent, env, a colour (red,green,blue from 0 to 1, or #rrggbb) or an image file"
)


def _color(name: str) -> tuple[float, float, float] | None:
    """Red, green and blue of what names a colour; None where nothing of the kind is meant."""
    if name in GREYS:
        return (GREYS[name],) * 3
    if re.fullmatch(r"#[0-9a-fA-F]{6}", name):
        red, green, blue = (value / 255.0 for value in bytes.fromhex(name[1:]))
        return red, green, blue
    try:
        red, green, blue = (float(word) for word in name.split(","))
    except ValueError:
        return None
    if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
        raise UserError("--background", expected=_EXPECTED, found=repr(name))
    return red, green, blue


class _Picture:
    """A picture that fills the frame, cropped at its longer sides."""

    def __init__(self, name: str) -> None:
        path = Path(name)
        if not path.is_file():
            raise UserError("--background", expected=_EXPECTED, found=repr(name))
        self._image = read_on_white(path)
        if is_linear(path):
            self._image = encode_srgb(torch.from_numpy(self._image)).numpy()
        self._filled: Tensor | None = None

    def fill(self, camera: Camera) -> Tensor:
        """(H, W, 3) at a camera's size, kept for the next frame, which is seldom of another."""
        size, device = (camera.height, camera.width), camera.world_to_camera.device
        if self._filled is None or self._filled.shape[:2] != size or self._filled.device != device:
            middle = _middle(self._image, width=camera.width, height=camera.height)
            self._filled = torch.from_numpy(middle).to(device)
        return self._filled


def _middle(image: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """The middle of an image (h, w, 3), of the aspect of width x height, at that size."""
    rows, columns = image.shape[:2]
    scale = min(columns / width, rows / height)
    wide, high = max(round(width * scale), 1), max(round(height * scale), 1)
    top, left = (rows - high) // 2, (columns - wide) // 2
    return resize_box(image[top : top + high, left : left + wide], width=width, height=height)
