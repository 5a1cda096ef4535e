"""The tab of the light: which, how it is turned and exposed, and a lamp with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from samira_warp.io.images import to_uint8
from samira_warp.stage.sheet import contact_sheet
from samira_warp.view.controls import on_change
from samira_warp.view.session import Job, Session
from samira_warp.view.state import Lamp, Light, State

GetLight = Callable[[State], Light]
SetLight = Callable[[State, Light], State]

SHEET_COLUMNS = 2


class LightControls:
    """The elements of one light; a comparison has a second one."""

    def __init__(self, gui: viser.GuiApi, session: Session, get: GetLight, put: SetLight) -> None:
        self._session, self._get, self._put = session, get, put
        lights = session.scene.lights
        name = gui.add_dropdown("Light", lights.names, initial_value=lights.names[0])
        self._picture = gui.add_image(_blank(), format="jpeg")
        self._on(name, lambda light, value: replace(light, name=value))
        on_change(name, lambda _: session.begin(self._preview()))
        turn = gui.add_slider("Turn, degrees", -180, 180, 1, 0)
        self._on(turn, lambda light, value: replace(light, rotate=float(value)))
        stops = gui.add_slider("Exposure, stops", -4.0, 4.0, 0.1, 0.0)
        self._on(stops, lambda light, value: replace(light, stops=float(value)))
        shadows = gui.add_checkbox("Shadows", True)
        self._on(shadows, lambda light, value: replace(light, shadows=bool(value)))
        self._add_lamp(gui)
        session.begin(self._preview())

    def _add_lamp(self, gui: viser.GuiApi) -> None:
        usual = Lamp()
        with gui.add_folder("Lamp", expand_by_default=False):
            lit = gui.add_checkbox("On", False)
            azimuth = gui.add_slider("Azimuth, degrees", -180, 180, 1, int(usual.azimuth))
            elevation = gui.add_slider("Elevation, degrees", -90, 90, 1, int(usual.elevation))
            strength = gui.add_slider("Strength", 0.05, 4.0, 0.05, usual.strength)

        def lamp(light: Light, _: object) -> Light:
            chosen = Lamp(float(azimuth.value), float(elevation.value), float(strength.value))
            return replace(light, lamp=chosen if lit.value else None)

        for handle in (lit, azimuth, elevation, strength):
            self._on(handle, lamp)

    def _on(self, handle: Any, how: Callable[[Light, Any], Light]) -> None:
        def chosen(value: Any) -> None:
            self._session.change(lambda state: self._put(state, how(self._get(state), value)))

        on_change(handle, chosen)

    def _preview(self) -> Job:
        """The map's small picture; reading it may take a moment."""
        scene = self._session.scene
        name = self._get(self._session.state).name
        self._picture.image = to_uint8(scene.lights.thumbnail(name, scene.shown.avatar))
        yield


class LightTab:
    """The light of the head, and small pictures of all there are."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        LightControls(gui, session, lambda s: s.light, lambda s, light: replace(s, light=light))
        with gui.add_folder("All lights", expand_by_default=False):
            self._sheet = gui.add_image(_blank(), format="jpeg")
        session.begin(self._draw_sheet())

    def _draw_sheet(self) -> Job:
        scene, pictures = self._session.scene, []
        for name in scene.lights.names:
            pictures.append(scene.lights.thumbnail(name, scene.shown.avatar))
            yield
        self._sheet.image = to_uint8(contact_sheet(pictures, scene.lights.names, columns=SHEET_COLUMNS))


def _blank() -> np.ndarray:
    return np.full((96, 192, 3), 40, np.uint8)
