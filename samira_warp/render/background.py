"""What is behind the head."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from samira_warp.avatar import Avatar
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import is_linear, read_on_white, resize_box
from samira_warp.light import Environment, encode_srgb
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError

GREYS = {"white": 1.0, "black": 0.0}


class Background:
    """The background that ``--background`` names, in display values."""

    def __init__(self, name: str, avatar: Avatar) -> None:
        """Read the image file, if it is one.

        Raises:
            UserError: It is none of white, black and env, and no image file.
        """
        self._name, self._avatar = name, avatar
        self._image: np.ndarray | None = None
        self._picture: torch.Tensor | None = None
        if name != "env" and name not in GREYS:
            if not Path(name).is_file():
                raise UserError(
                    "--background", expected="white, black, env or an image file", found=repr(name)
                )
            self._image = read_on_white(Path(name))
            if is_linear(Path(name)):
                self._image = encode_srgb(torch.from_numpy(self._image)).numpy()

    def view_of(self, environment: Environment) -> RadianceMap | None:
        """What is seen of an environment, as a map of display values; None where something else is behind the
        head.

        The values are clipped and encoded before they are interpolated: in radiance, a texel of a lamp would
        cover all the pixels between it and its neighbours, in steps.
        """
        if self._name != "env":
            return None
        visible = environment.visible
        return replace(visible, texels=self._avatar.display(visible.texels).clamp(0.0, 1.0))

    def behind(self, camera: Camera, view: RadianceMap | None, *, rotate: float) -> torch.Tensor | float:
        """A grey, or (H, W, 3): the picture filling the frame, cropped at its longer sides, or the
        environment as the camera sees it.

        Args:
            camera: The view.
            view: What `view_of` gave for the light.
            rotate: Degrees by which it is turned.
        """
        if view is not None:
            return view.behind(camera, rotate=rotate)
        if self._image is not None:
            return self._filled(camera.width, camera.height, camera.world_to_camera.device)
        return GREYS[self._name]

    def _filled(self, width: int, height: int, device: torch.device) -> torch.Tensor:
        """The picture at a frame's size, kept for the next frame, which is seldom of another."""
        if (
            self._picture is None
            or self._picture.shape[:2] != (height, width)
            or self._picture.device != device
        ):
            self._picture = torch.from_numpy(_fill(self._image, width=width, height=height)).to(device)
        return self._picture


def _fill(image: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """The middle of an image (h, w, 3), of the aspect of width x height, at that size."""
    rows, columns = image.shape[:2]
    scale = min(columns / width, rows / height)
    wide, high = max(round(width * scale), 1), max(round(height * scale), 1)
    top, left = (rows - high) // 2, (columns - wide) // 2
    return resize_box(image[top : top + high, left : left + wide], width=width, height=height)
