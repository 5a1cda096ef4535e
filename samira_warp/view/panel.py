"""The panel of one browser: its tabs, and what of its session they show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser
from PIL import ImageColor

from samira_warp.view.config import ViewConfig
from samira_warp.view.session import Session
from samira_warp.view.splats import SPLAT_UNITS, BrowserSplats
from samira_warp.view.state import State
from samira_warp.view.tabs.appearance import AppearanceTab
from samira_warp.view.tabs.camera import CameraControls
from samira_warp.view.tabs.comparing import CompareTab
from samira_warp.view.tabs.face import FaceTab
from samira_warp.view.tabs.light import LightTab
from samira_warp.view.tabs.play import PlayTab
from samira_warp.view.tabs.saving import SaveTab

if TYPE_CHECKING:
    from samira_warp.drive.stream import Condition, Stream
    from samira_warp.view.following import Progress
    from samira_warp.view.tabs.driving import DriveTab
    from samira_warp.view.tabs.training import TrainingTab


class Panel:
    """A browser as its session sees it (`samira_warp.view.session.Screen`)."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._play: PlayTab | None = None
        self._save: SaveTab | None = None
        self._training: TrainingTab | None = None
        self._splats: viser.GaussianSplatHandle | None = None
        self._behind: str | None = None
        self._drive: DriveTab | None = None

    def fill(
        self, session: Session, config: ViewConfig, progress: Progress | None, stream: Stream | None
    ) -> None:
        """Make the tabs."""
        gui = self._client.gui
        tabs = gui.add_tab_group()
        if stream is not None:
            from samira_warp.view.tabs.driving import DriveTab

            with tabs.add_tab("Drive"):
                self._drive = DriveTab(
                    gui,
                    session,
                    stream.source.name,
                    stream.condition(),
                    take_for_neutral=stream.take_for_neutral,
                )
        with tabs.add_tab("Play"):
            self._play = PlayTab(gui, session)
            with gui.add_folder("Camera"):
                CameraControls(gui, session, self._client.camera)
        with tabs.add_tab("Face"):
            FaceTab(gui, session)
        with tabs.add_tab("Light"):
            LightTab(gui, session)
        with tabs.add_tab("Look"):
            AppearanceTab(gui, session)
        with tabs.add_tab("Compare"):
            CompareTab(gui, session)
        with tabs.add_tab("Save"):
            self._save = SaveTab(gui, session, data=config.data, split=config.split)
        if progress is not None:
            from samira_warp.view.tabs.training import TrainingTab

            with tabs.add_tab("Run"):
                self._training = TrainingTab(gui, progress)

    def show(self, picture: np.ndarray, *, quality: int) -> None:
        """Show a picture (H, W, 3) uint8, stretched over the window."""
        self._client.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)
        self._client.flush()

    def show_splats(self, splats: BrowserSplats, *, background: str) -> None:
        """Have the browser draw splats in place of pictures, before white, black or a colour #rrggbb."""
        scene, color = self._client.scene, "white" if background == "env" else background
        geometry = SPLAT_UNITS * splats.centers, SPLAT_UNITS**2 * splats.covariances
        if self._splats is None:
            self._splats = scene.add_gaussian_splats(
                "/splats", *geometry, splats.colors, splats.opacities, scale=1.0 / SPLAT_UNITS
            )
        else:
            self._splats.set_gaussians(*geometry, splats.colors, splats.opacities)
        if color != self._behind:
            self._behind = color
            plain = np.full((8, 8, 3), ImageColor.getrgb(color), np.uint8)
            scene.set_background_image(plain, format="png")
        self._client.flush()

    def hide_splats(self) -> None:
        """Draw them no more."""
        if self._splats is not None:
            self._splats.remove()
        self._splats = self._behind = None

    def say(self, title: str, text: str) -> None:
        """Show a line of words for a while."""
        self._client.add_notification(title, text, auto_close_seconds=10.0)

    def at_frame(self, number: int) -> None:
        """Show which frame is played."""
        if self._play is not None:
            self._play.at_frame(number)

    def settled(self, state: State, *, height: int) -> None:
        """Show the command of what is shown."""
        if self._save is not None:
            self._save.settled(state, height=height)

    def download(self, name: str, content: bytes) -> None:
        """Have the browser keep a file."""
        self._client.send_file_download(name, content, save_immediately=True)

    def progress(self, progress: Progress) -> None:
        """Show how far the training is by now."""
        if self._training is not None:
            self._training.show(progress)

    def condition(self, condition: Condition) -> None:
        """Show how what drives the avatar is by now."""
        if self._drive is not None:
            self._drive.show(condition)
