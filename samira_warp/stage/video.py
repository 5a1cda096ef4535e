"""Videos of rendered layers, by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from types import TracebackType

import imageio_ffmpeg
import numpy as np

from samira_warp.stage.fitting import fitted
from samira_warp.support.errors import UserError

Stream = Generator[None, np.ndarray | None, None]
"""What takes the frames of a video, one by one."""


def film_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the film of pictures of a size: H.264 holds even numbers of pixels only."""
    return width - width % 2, height - height % 2


class VideoWriter:
    """An H.264 video that grows frame by frame; use as a context manager."""

    def __init__(self, path: Path, *, frames_per_second: float) -> None:
        """Nothing is written before the first frame, whose size is the video's."""
        self.path, self.frames_per_second = path, frames_per_second
        self._size: tuple[int, int] | None = None
        self._writer: Stream | None = None

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(self, picture: np.ndarray) -> None:
        """Append one (H, W, 3) uint8 frame.

        Of frames of the first one's size, what is beyond `film_size` is cut off at the right and below;
        others are fitted into the film, on white.

        Raises:
            UserError: The first frame is too small.
        """
        size = picture.shape[1], picture.shape[0]
        if self._size is None:
            self._size = size
        width, height = film_size(*self._size)
        if self._writer is None:
            self._writer = self._open(picture, width=width, height=height)
        if size != self._size:
            picture = fitted(picture, width=width, height=height)
        self._writer.send(np.ascontiguousarray(picture[:height, :width]))

    def _open(self, picture: np.ndarray, *, width: int, height: int) -> Stream:
        """Start the video with the size of its first frame."""
        if min(height, width) == 0:
            raise UserError(
                self.path,
                expected="frames of at least 2 x 2 pixels",
                found=f"{picture.shape[1]} x {picture.shape[0]}",
            )
        writer: Stream = imageio_ffmpeg.write_frames(
            str(self.path),
            (width, height),
            fps=self.frames_per_second,
            quality=8,
            macro_block_size=1,
            ffmpeg_log_level="error",
        )
        writer.send(None)
        return writer
