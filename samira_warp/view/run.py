"""The viewer from its options to its end."""

from __future__ import annotations

import importlib.util
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING

from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError
from samira_warp.view.config import ViewConfig
from samira_warp.view.lights import Lights
from samira_warp.view.ports import free_port
from samira_warp.view.scene import Scene, Shown
from samira_warp.view.sources import load_second, load_shown

if TYPE_CHECKING:
    from samira_warp.drive import Performance, Stream
    from samira_warp.view.server import Server

EVERY = 0.5
"""Seconds between two words on how what drives the avatar is."""


def view(config: ViewConfig) -> None:
    """Serve the page until Ctrl-C or SIGTERM.

    Everything is checked before the page opens.

    Raises:
        UserError: viser is not there, the port is in use, or an avatar, a sequence or a folder of maps cannot
            be used.
    """
    config.check()
    if importlib.util.find_spec("viser") is None:
        wanted = "what serves the page (pip install 'samira-warp[view]')"
        raise UserError("viser", expected=wanted, found="none")
    port = free_port(config.host, config.port)
    device = pick_device(config.device)
    lights = Lights(config.envs, device=device)
    shown = load_shown(config, device)
    second = None if config.compare is None else load_second(config.compare, shown, device)
    stream = None if config.drive is None else _stream(config, config.drive, shown)
    with told_to_end() as ended:
        serve(config, Scene(shown, lights, second=second), port=port, ended=ended, stream=stream)


def _stream(config: ViewConfig, text: str, shown: Shown) -> Stream:
    """What drives the avatar live, opened."""
    from samira_warp.drive import DriveSettings, Performer, Stream, open_source

    settings = DriveSettings(config.neutral, smoothing=config.smoothing)
    source = open_source(text)
    try:
        performer = Performer(shown.avatar.canonical, shown.poser.frames, settings, pictures=source.pictures)
    except UserError:
        source.end()
        raise
    return Stream(source, performer)


def serve(
    config: ViewConfig, scene: Scene, *, port: int, ended: threading.Event, stream: Stream | None = None
) -> None:
    """Serve what is shown until an event; the place of viser's import, which takes a moment."""
    from samira_warp.view.server import Server

    follower = None
    if config.run is not None:
        from samira_warp.view.following import Follower

        follower = Follower(config.run, scene.shown.folder, device=scene.device)
    server = Server(
        scene, config, port=port, progress=None if follower is None else follower.progress, stream=stream
    )
    try:
        print(f"{server.address} shows {scene.shown.folder}; Ctrl-C ends it", file=sys.stderr, flush=True)
        if follower is not None:
            follower.start(on_avatar=server.show_avatar, on_progress=server.show_progress)
        if stream is None:
            ended.wait()
        else:
            stream.start(partial(_drive, server))
            while not ended.wait(EVERY):
                server.show_condition(stream.condition())
    finally:
        if stream is not None:
            stream.end()
        if follower is not None:
            follower.end()
        server.end()


def _drive(server: Server, pose: Performance) -> None:
    """Show a pose to all browsers that follow."""
    for session in server.sessions():
        session.drive(pose.parameters)


@contextmanager
def told_to_end() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set, in place of what they do otherwise."""
    ended = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        ended.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
