"""A camera as a source, by the device library of PyAV's FFmpeg."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from typing import Any

import av

from samira_warp.drive.sources import FilmedPicture
from samira_warp.support.errors import UserError

SIZE = "640x480"
"""Pixels that a camera is asked for: a face in it is larger than its networks' 192 and costs no more."""


class CameraSource:
    """What a camera sees, as it sees it: not mirrored."""

    live = True
    pictures = True

    def __init__(self, text: str) -> None:
        """Open it.

        Args:
            text: Its number, or its device.

        Raises:
            UserError: There is no such camera, or it gives no pictures.
        """
        self.name = f"camera {text}"
        self._ended = self._begun = False
        kind, device = _device(text)
        try:
            self._container = _opened(kind, device)
        except (av.error.FFmpegError, OSError, ValueError) as fault:
            found = getattr(fault, "strerror", None) or str(fault)
            raise UserError(
                "--drive", expected="a camera that is there", found=f"{device}: {found}"
            ) from fault
        if not self._container.streams.video:
            self._container.close()
            raise UserError(
                "--drive", expected="a camera that is there", found=f"{device}: no pictures of it"
            )

    def frames(self, *, patience: float = math.inf) -> Iterator[FilmedPicture]:
        """Its pictures.

        Raises:
            UserError: It is unplugged, or fails.
        """
        self._begun = True
        try:
            for frame in self._container.decode(video=0):
                if self._ended:
                    break
                yield FilmedPicture(time.monotonic(), frame.to_ndarray(format="rgb24"))
        except av.error.FFmpegError as fault:
            raise UserError(self.name, expected="its next picture", found=fault.strerror) from fault
        finally:
            self._container.close()

    def end(self) -> None:
        """Give no more pictures after the next one."""
        self._ended = True
        if not self._begun:
            self._container.close()


def _device(text: str) -> tuple[str, str]:
    """FFmpeg's name for the kind of device that this system has, and for the camera."""
    if sys.platform == "darwin":
        return "avfoundation", text
    if sys.platform == "win32":
        return "dshow", f"video={text}"
    return "v4l2", f"/dev/video{text}" if text.isdigit() else text


def _opened(kind: str, device: str) -> Any:
    return av.open(device, format=kind, options={"video_size": SIZE})
