"""The tab of what is taken away: a picture, a film, and the command that renders the same."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import viser

from samira_warp.view.command_line import command_of
from samira_warp.view.controls import on_click, put
from samira_warp.view.jobs import Turning, snapshot, turntable
from samira_warp.view.session import Session
from samira_warp.view.state import State


class SaveTab:
    """Snapshot, turntable, command line."""

    def __init__(self, gui: viser.GuiApi, session: Session, *, data: Path | None, split: str | None) -> None:
        self._session, self._data, self._split = session, data, split
        with gui.add_folder("Picture"):
            picture = gui.add_button("Snapshot, twice the size", icon=viser.Icon.CAMERA)
        with gui.add_folder("Film of one turn"):
            turning = gui.add_dropdown("What turns", ("camera", "light"), initial_value="camera")
            seconds = gui.add_slider("Seconds", 1, 12, 1, 4)
            film = gui.add_button("Make the film", icon=viser.Icon.MOVIE)
        with gui.add_folder("The same by a command"):
            self._command = gui.add_text("Command", "", multiline=True)
        on_click(picture, lambda: session.begin(snapshot(session)))

        def begin_film() -> None:
            session.screen.say("The film is being made", "It is downloaded as soon as it is whole.")
            what = cast(Turning, turning.value)
            session.begin(turntable(session, turning=what, seconds=float(seconds.value)))

        on_click(film, begin_film)

    def settled(self, state: State, *, height: int) -> None:
        """Show the command of what is shown."""
        said = command_of(self._session.scene, state, height=height, data=self._data, split=self._split)
        put(self._command, said.text())
