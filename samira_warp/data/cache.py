"""Decoded frames kept in memory up to a budget, and fetched ahead of their use by several threads."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.frames import FrameFiles
from samira_warp.data.pixels import FramePixels, load_pixels

MOST_DECODERS = 4
"""Threads that fetch ahead, at most: each holds a whole decoded picture. As many as torch computes with,
where those are fewer."""

FASTEST = 1
"""zlib's level: a training frame of 256 pixels is a fourth of its 16 bits in 12 ms, and whole again in 3 ms.
Higher levels gain a tenth for three times the time."""


class _Kept(NamedTuple):
    """A frame in 16 bits a value, deflated plane by plane.

    8-bit sources are kept exactly, their averages to 1/65535. Skin and hair deflate to two thirds, and white
    round a head to nothing.
    """

    deflated: bytes
    shape: tuple[int, ...]


class _Fetched(NamedTuple):
    """A frame for its caller, and as it will be kept; None where it is kept, or there is no room."""

    pixels: FramePixels
    fresh: _Kept | None


class PixelCache:
    """The pixels of a sequence at one resolution; those that do not fit in a budget are decoded again.

    The first frames that fit stay. Every epoch shows all frames, in another order: whichever share fits is
    found each time. To drop the frame that was not shown for longest, and keep the one just shown, finds
    less: a sixth of all where a half fits.

    Every frame keeps the shape of its own camera: ``frame.camera.with_longer_side(resolution)`` is the view
    of its pixels.

    A frame has the same bits whether it was kept, fetched ahead or just decoded, and by whichever thread. Use
    as a context manager, or call ``close``.

    Args:
        frames: What ``index`` counts.
        resolution: Longer side of every result, pixels.
        max_bytes: Budget of the frames that are kept; those being fetched ahead come on top.
        pinned: Whether results lie in page-locked memory, which a GPU copies from while it computes.
    """

    def __init__(
        self,
        frames: Sequence[FrameFiles],
        *,
        resolution: int,
        max_bytes: int = 1 << 28,
        pinned: bool = False,
    ) -> None:
        self._frames = frames
        self._resolution = resolution
        self._max_bytes = max_bytes
        self._pinned = pinned
        self._kept: dict[int, _Kept] = {}
        self._kept_bytes = 0
        self._full = False
        self._pending: dict[int, Future[_Fetched]] = {}
        self._lock = threading.Lock()
        decoders = min(torch.get_num_threads(), MOST_DECODERS)
        self._workers = ThreadPoolExecutor(max_workers=decoders, thread_name_prefix="pixels")

    def __enter__(self) -> PixelCache:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop fetching ahead; frames can still be asked for if they are kept or decoded anew."""
        self._workers.shutdown(wait=True, cancel_futures=True)
        self._pending.clear()

    @property
    def kept_bytes(self) -> int:
        """Of the frames that are kept."""
        return self._kept_bytes

    @property
    def full(self) -> bool:
        """Whether a frame did not fit; then none is kept any more."""
        return self._full

    def prefetch(self, indices: Iterable[int]) -> None:
        """Start fetching frames that will be asked for soon.

        A broken file is reported when its frame is asked for.
        """
        with self._lock:
            for index in indices:
                if index not in self._pending:
                    self._pending[index] = self._workers.submit(self._fetch, index, self._kept.get(index))

    def __getitem__(self, index: int) -> FramePixels:
        """The frame's pixels, on the CPU, the caller's own.

        Raises:
            UserError: A file of the frame cannot be decoded.
        """
        with self._lock:
            pending, kept = self._pending.pop(index, None), self._kept.get(index)
        fetched = self._fetch(index, kept) if pending is None else pending.result()
        self._keep(index, fetched.fresh)
        return fetched.pixels

    def _fetch(self, index: int, kept: _Kept | None) -> _Fetched:
        if kept is not None:
            return _Fetched(self._pixels(_inflated(kept)), None)
        frame = self._frames[index]
        camera = frame.camera.with_longer_side(self._resolution)
        planes = _planes(load_pixels(frame, width=camera.width, height=camera.height))
        return _Fetched(self._pixels(planes), None if self._full else _deflated(planes))

    def _pixels(self, planes: np.ndarray) -> FramePixels:
        """What (C, H, W) planes hold."""
        image, mask = _values(planes[:3]), _values(planes[3:4])[..., 0]
        pixels = FramePixels(image, mask, _values(planes[4:]) if len(planes) > 4 else None)
        return pixels.pinned() if self._pinned else pixels

    def _keep(self, index: int, fresh: _Kept | None) -> None:
        """Add a frame; the first that does not fit is the end of it.

        In the order in which frames are asked for, not in which threads are done with them.
        """
        with self._lock:
            if fresh is None or self._full or index in self._kept:
                return
            size = len(fresh.deflated)
            if self._kept_bytes + size > self._max_bytes:
                self._full = True
                return
            self._kept[index] = fresh
            self._kept_bytes += size


def _planes(pixels: FramePixels) -> np.ndarray:
    """(C, H, W) uint16: image, mask and, where there is one, albedo."""
    albedo = [] if pixels.albedo is None else [pixels.albedo]
    values = torch.cat([pixels.image, pixels.mask[..., None], *albedo], dim=-1).numpy()
    sixteen = np.rint(np.clip(values, 0.0, 1.0) * 65535.0).astype(np.uint16)
    return np.ascontiguousarray(sixteen.transpose(2, 0, 1))


def _values(planes: np.ndarray) -> Tensor:
    """(H, W, C) float32 in 0..1 of (C, H, W) planes."""
    return torch.from_numpy(np.ascontiguousarray(planes.transpose(1, 2, 0), np.float32) / np.float32(65535.0))


def _deflated(planes: np.ndarray) -> _Kept:
    return _Kept(zlib.compress(planes.data, FASTEST), planes.shape)


def _inflated(kept: _Kept) -> np.ndarray:
    return np.frombuffer(zlib.decompress(kept.deflated), np.uint16).reshape(kept.shape)
