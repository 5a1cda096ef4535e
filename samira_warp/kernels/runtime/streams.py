"""Torch's streams as Warp knows them.

A launch names its stream, and `current_stream` is all it needs. Warp's own utilities (sorts, and the trees
that rays are cast at) take none: they work in the one that Warp keeps for the whole device, in whose place
`stream_of` puts torch's.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
import warp as wp

from samira_warp.support.warp_start import WARP_STATE, start_warp

_streams: dict[tuple[int, int], wp.Stream] = {}
"""By a GPU's number and the stream's handle; kept for good, since torch has few and uses them again."""


def current_stream(device: torch.device) -> wp.Stream:
    """Torch's current stream of a GPU, which is this thread's own."""
    key = device.index or 0, torch.cuda.current_stream(device).cuda_stream
    stream = _streams.get(key)
    if stream is None:
        start_warp()
        with WARP_STATE:
            # looked for once more: of two objects for one stream, the first to go would strike it off Warp's
            # list
            stream = _streams.get(key) or wp.Stream(f"cuda:{key[0]}", cuda_stream=key[1])
            _streams[key] = stream
    return stream


@contextlib.contextmanager
def stream_of(device: torch.device) -> Iterator[None]:
    """Make Warp's own utilities work in this thread's current stream of ``device``, captured or not.

    Nothing to do on the CPU. On a GPU one thread at a time is within: Warp's current stream is the device's
    and not the thread's, so that a second thread's utilities would go to the first one's stream; and neither
    does Warp guard its list of trees. What is kept apart is the host's work, which ends when the device's is
    queued.
    """
    start_warp()
    if device.type != "cuda":
        yield
        return
    stream = current_stream(device)
    with WARP_STATE, wp.ScopedStream(stream, sync_enter=False):
        if not stream.is_capturing:
            with _ordered_with_default(device):
                yield
            return
        # Warp has to know of a capture that torch began, or its temporary memory is freed in the middle of it
        wp.capture_begin(stream=stream, external=True, force_module_load=False)
        try:
            yield
        finally:
            wp.capture_end(stream=stream)


@contextlib.contextmanager
def _ordered_with_default(device: torch.device) -> Iterator[None]:
    """Let torch's current stream and its default one wait for each other.

    Warp frees memory in the default stream, whatever stream used it, and the default stream waits by itself
    for none of torch's others: memory that is still worked on could be given away. So what is freed within
    waits for what came before, and whoever is next, in any stream, for what was done within.
    """
    current, default = torch.cuda.current_stream(device), torch.cuda.default_stream(device)
    if current == default:
        yield
        return
    default.wait_stream(current)
    current.wait_stream(default)
    try:
        yield
    finally:
        default.wait_stream(current)
