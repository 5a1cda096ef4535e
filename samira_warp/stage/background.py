"""What is behind the head."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.io.images import is_linear, read_on_white, resize_box
from samira_warp.light import ColorSpace, Environment, encode_srgb
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError

GREYS = {"white": 1.0, "black": 0.0}


class Background:
    """A grey, a picture, or the environment as the camera sees it, in display values."""

    def __init__(self, name: str, *, color_space: ColorSpace = "srgb") -> None:
        """Read the picture, if it is one.

        Args:
            name: white, black, env or an image file.
            color_space: What shading works in, as a picture of the environment is shown.

        Raises:
            UserError: It is none of these.
        """
        self._name, self._color_space = name, color_space
        self._picture = None if name == "env" or name in GREYS else _Picture(name)

    def seen_of(self, environment: Environment) -> RadianceMap | None:
        """What is seen of an environment, in display values; None where it is not behind the head."""
        return environment.display_map(color_space=self._color_space) if self._name == "env" else None

    def behind(self, camera: Camera, seen: RadianceMap | None, *, rotate: float = 0.0) -> Tensor | float:
        """A grey, or (H, W, 3) display values: the picture, or the environment as the camera sees it.

        Args:
            camera: The view.
            seen: What `seen_of` gave for the light.
            rotate: Degrees by which the light is turned.
        """
        if seen is not None:
            return seen.behind(camera, rotate=rotate)
        if self._picture is not None:
            return self._picture.fill(camera)
        return GREYS[self._name]


class _Picture:
    """A picture that fills the frame, cropped at its longer sides."""

    def __init__(self, name: str) -> None:
        path = Path(name)
        if not path.is_file():
            raise UserError("--background", expected="white, black, env or an image file", found=repr(name))
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
