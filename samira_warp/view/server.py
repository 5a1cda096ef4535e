"""The page: a server, and a session with a panel for every browser that opens it."""

from __future__ import annotations

import contextlib
import io
import math
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from samira_warp.avatar import Avatar
from samira_warp.support.errors import UserError
from samira_warp.view.config import ViewConfig
from samira_warp.view.look import Look
from samira_warp.view.panel import Panel
from samira_warp.view.scene import Scene, Sides
from samira_warp.view.session import Session
from samira_warp.view.state import State
from samira_warp.view.tabs.camera import UP
from samira_warp.view.turns import Turns

if TYPE_CHECKING:
    from samira_warp.drive.stream import Condition, Stream
    from samira_warp.view.following import Progress

TITLE = "samira_warp"

WARM_SIDE = 64
"""Pixels of the picture that is made before there is anybody to see it."""


class Server:
    """Browsers come and go; each has its own session, and one thread makes the pictures of all."""

    def __init__(
        self,
        scene: Scene,
        config: ViewConfig,
        *,
        port: int,
        progress: Progress | None,
        stream: Stream | None = None,
    ) -> None:
        """Open the page.

        Args:
            scene: What is shown.
            config: The options.
            port: A free one.
            progress: How far the run is that is followed, if any.
            stream: What drives the avatar live, if anything does.

        Raises:
            UserError: The port was taken in the meantime.
        """
        self._scene, self._config, self._progress, self._stream = scene, config, progress, stream
        self._lock = threading.Lock()
        self._browsers: dict[int, tuple[Session, Panel]] = {}
        self._turns = Turns()
        start = start_look(scene)
        self._start = State(start)
        # a picture that was being made for a browser when it went is lost, and that is all
        warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
        with contextlib.redirect_stdout(io.StringIO()):  # its banner
            self._viser = viser.ViserServer(host=config.host, port=port, label=TITLE, verbose=False)
        if self._viser.get_port() != port:
            self._stop_viser()
            raise UserError(f"{config.host}:{port}", expected="a port that is free here", found="one in use")
        self._set_up(start)
        # kernels are loaded while the first browser loads the page
        self._turns.between(
            lambda: scene.picture(self._start, Sides.new(), width=WARM_SIDE, height=WARM_SIDE, detail="quick")
        )
        self._turns.start()
        self._viser.on_client_connect(self._come)
        self._viser.on_client_disconnect(self._go)

    @property
    def address(self) -> str:
        """Where browsers find the page."""
        host = "localhost" if self._config.host in ("0.0.0.0", "::") else self._config.host
        return f"http://{host}:{self._viser.get_port()}"

    def sessions(self) -> list[Session]:
        """Those of the browsers that are there."""
        return self._turns.sessions()

    def show_avatar(self, avatar: Avatar, folder: Path) -> None:
        """Show a newer state of the avatar to all."""

        def swap() -> None:
            self._scene.replace_avatar(avatar, folder)
            for session in self.sessions():
                session.refresh()

        self._turns.between(swap)

    def show_progress(self, progress: Progress) -> None:
        """Show to all how far the training is by now."""
        with self._lock:
            self._progress = progress
            panels = [panel for _, panel in self._browsers.values()]
        for panel in panels:
            panel.progress(progress)

    def show_condition(self, condition: Condition) -> None:
        """Show to all how what drives the avatar is by now."""
        with self._lock:
            panels = [panel for _, panel in self._browsers.values()]
        for panel in panels:
            panel.condition(condition)

    def end(self) -> None:
        """Close the page."""
        self._turns.end()
        self._stop_viser()

    def _stop_viser(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):  # it says so
            self._viser.stop()

    def _set_up(self, start: Look) -> None:
        """How the page looks, and where its camera begins."""
        gui, scene, camera = self._viser.gui, self._viser.scene, self._viser.initial_camera
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        scene.set_up_direction("+y")
        scene.world_axes.visible = False
        center = self._scene.place(self._start).center.double().cpu().numpy()
        camera.fov = math.radians(start.fov)
        camera.up = UP
        camera.position = start.position
        camera.look_at = center
        camera.near = 0.01

    def _come(self, client: viser.ClientHandle) -> None:
        panel = Panel(client)
        session = Session(
            self._scene, self._start, panel, longest=self._config.resolution, wake=self._turns.wake
        )
        session.see(
            look_of(client.camera), width=client.camera.image_width, height=client.camera.image_height
        )
        if self._stream is not None and self._stream.latest is not None:
            session.drive(self._stream.latest.parameters)
        self._turns.join(session)
        with self._lock:
            self._browsers[client.client_id] = (session, panel)
            progress = self._progress

        async def moved(camera: viser.CameraHandle) -> None:
            session.see(look_of(camera), width=camera.image_width, height=camera.image_height)

        client.camera.on_update(moved)
        panel.fill(session, self._config, progress, self._stream)
        if client.client_id not in self._viser.get_clients():  # it left meanwhile
            self._go(client)

    def _go(self, client: viser.ClientHandle) -> None:
        with self._lock:
            found = self._browsers.pop(client.client_id, None)
        if found is not None:
            self._turns.leave(found[0])


def start_look(scene: Scene) -> Look:
    """Where the camera of the first frame stands, looking at the head's middle, the world's up above."""
    look = Look.of(scene.shown.poser.frames[0].camera)
    center = scene.place(State(look)).center.double().cpu().numpy()
    forward = center - np.asarray(look.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(UP))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    x, y, z, w = Rotation.from_matrix(axes).as_quat().tolist()
    return look._replace(wxyz=(w, x, y, z))


def look_of(camera: viser.CameraHandle) -> Look:
    """Where a browser looks from."""
    px, py, pz = (float(value) for value in camera.position)
    w, x, y, z = (float(value) for value in camera.wxyz)
    return Look((px, py, pz), (w, x, y, z), math.degrees(camera.fov))
