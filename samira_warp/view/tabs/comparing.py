"""The tab that puts two pictures side by side."""

from __future__ import annotations

from dataclasses import replace

import viser

from samira_warp.view.controls import chooses
from samira_warp.view.session import Session
from samira_warp.view.state import Beside, Light, State
from samira_warp.view.tabs.light import LightControls

CHOICES: dict[str, Beside] = {"nothing": "nothing", "another light": "light", "the second avatar": "avatar"}


class CompareTab:
    """What the right part of the picture shows."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        names = [name for name, of in CHOICES.items() if of != "avatar" or session.scene.second is not None]
        what = gui.add_dropdown("On the right", names, initial_value=names[0])
        where = gui.add_slider("From", 0.0, 1.0, 0.01, 0.5)
        second = gui.add_folder("The other light", visible=False)
        with second:
            LightControls(gui, session, lambda s: s.comparison.light, _with_light)

        def beside(state: State, name: str) -> State:
            second.visible = CHOICES[name] == "light"
            return replace(state, comparison=replace(state.comparison, of=CHOICES[name]))

        chooses(what, session, beside)
        chooses(where, session, lambda s, at: replace(s, comparison=replace(s.comparison, split=float(at))))


def _with_light(state: State, light: Light) -> State:
    return replace(state, comparison=replace(state.comparison, light=light))
