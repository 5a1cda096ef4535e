"""Decoded frames kept in memory up to a budget, and decoded ahead of their use by one thread."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.frames import FrameFiles
from samira_warp.data.pixels import FramePixels, load_pixels


class _Stored(NamedTuple):
    """A frame in 16 bits a value: 8-bit sources are kept exactly, their averages to 1/65535."""

    image: np.ndarray
    mask: np.ndarray
    albedo: np.ndarray | None

    @property
    def bytes(self) -> int:
        return sum(array.nbytes for array in self if array is not None)


class PixelCache:
    """The pixels of a sequence at one resolution; the least recently used are decoded again.

    Every frame keeps the shape of its own camera: ``frame.camera.with_longer_side(resolution)`` is the view
    of its pixels.

    A frame has the same bits whether it was kept, fetched ahead or just decoded. Use as a context manager, or
    call ``close``.

    Args:
        frames: What ``index`` counts.
        resolution: Longer side of every result, pixels.
        max_bytes: Budget of the frames that are kept; those being fetched ahead come on top.
    """

    def __init__(self, frames: Sequence[FrameFiles], *, resolution: int, max_bytes: int = 1 << 30) -> None:
        self._frames = frames
        self._resolution = resolution
        self._max_bytes = max_bytes
        self._kept: OrderedDict[int, _Stored] = OrderedDict()
        self._kept_bytes = 0
        self._pending: dict[int, Future[_Stored]] = {}
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="pixels")

    def __enter__(self) -> PixelCache:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop fetching ahead; frames can still be asked for if they are kept or decoded anew."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._pending.clear()

    def prefetch(self, indices: Iterable[int]) -> None:
        """Start decoding frames that will be asked for soon.

        A broken file is reported when its frame is asked for.
        """
        with self._lock:
            for index in indices:
                if index not in self._kept and index not in self._pending:
                    self._pending[index] = self._worker.submit(self._decode, index)

    def __getitem__(self, index: int) -> FramePixels:
        """The frame's pixels, on the CPU.

        Raises:
            UserError: A file of the frame cannot be decoded.
        """
        with self._lock:
            stored = self._kept.get(index)
            if stored is not None:
                self._kept.move_to_end(index)
            pending = None if stored is not None else self._pending.pop(index, None)
        if stored is None:
            stored = pending.result() if pending is not None else self._decode(index)
            self._keep(index, stored)
        return FramePixels(
            _unpack(stored.image),
            _unpack(stored.mask),
            None if stored.albedo is None else _unpack(stored.albedo),
        )

    def _decode(self, index: int) -> _Stored:
        frame = self._frames[index]
        camera = frame.camera.with_longer_side(self._resolution)
        pixels = load_pixels(frame, width=camera.width, height=camera.height)
        return _Stored(
            _pack(pixels.image), _pack(pixels.mask), None if pixels.albedo is None else _pack(pixels.albedo)
        )

    def _keep(self, index: int, stored: _Stored) -> None:
        """Add a frame and drop the oldest beyond the budget; one frame larger than the budget is not kept."""
        with self._lock:
            if index in self._kept or stored.bytes > self._max_bytes:
                return
            self._kept[index] = stored
            self._kept_bytes += stored.bytes
            while self._kept_bytes > self._max_bytes:
                _, dropped = self._kept.popitem(last=False)
                self._kept_bytes -= dropped.bytes


def _pack(values: Tensor) -> np.ndarray:
    return np.rint(np.clip(values.numpy(), 0.0, 1.0) * 65535.0).astype(np.uint16)


def _unpack(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.float32) / np.float32(65535.0))
