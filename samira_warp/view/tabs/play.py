"""The tab that plays the sequence."""

from __future__ import annotations

from dataclasses import replace

import viser

from samira_warp.view.controls import chooses, on_change, on_click, put
from samira_warp.view.session import Session
from samira_warp.view.state import State

RATE = 25
"""Frames per second, unless chosen otherwise."""


class PlayTab:
    """Play, pause, scrub."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session, self._playing = session, False
        frames = session.scene.shown.poser.frames
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._frame = gui.add_slider("Frame", 0, max(len(frames) - 1, 1), 1, 0, disabled=len(frames) == 1)
        self._name = gui.add_text("Name", frames[0].name, disabled=True)
        self._rate = gui.add_slider("Speed, fps", 1, 60, 1, RATE)
        at_rest = gui.add_checkbox("Face at rest", False, hint="Only the frame's place and turn of the head.")
        on_click(self._play, self._toggle)
        on_change(self._frame, self._scrub)
        on_change(self._rate, lambda _: self._session.play(self._rate.value) if self._playing else None)
        chooses(at_rest, session, lambda s, value: replace(s, pose=replace(s.pose, neutral=value)))

    def at_frame(self, number: int) -> None:
        """Show which frame is played."""
        put(self._frame, number)
        put(self._name, self._session.scene.shown.poser.frames[number].name)

    def _toggle(self) -> None:
        self._set_playing(not self._playing)

    def _set_playing(self, playing: bool) -> None:
        self._playing = playing
        self._play.label = "Pause" if playing else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
        self._session.play(self._rate.value if playing else 0.0)

    def _scrub(self, number: int) -> None:
        if self._playing:
            self._set_playing(False)

        def at(state: State) -> State:
            return replace(state, pose=replace(state.pose, frame=int(number)))

        self._session.change(at)
        put(self._name, self._session.scene.shown.poser.frames[int(number)].name)
