"""The tab of what is drawn: layer, tone map, background, materials, and the camera."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import viser

from samira_warp.avatar import MaterialEdit
from samira_warp.head import REGIONS
from samira_warp.stage.layer_names import Layer
from samira_warp.support.tone_names import ToneMap
from samira_warp.view.controls import chooses, on_change, on_click, put
from samira_warp.view.session import Session
from samira_warp.view.state import State

EVERYWHERE = "everywhere"
BACKGROUNDS = ("white", "black", "colour", "light")


class AppearanceTab:
    """How the head is drawn."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        layer = gui.add_dropdown("Layer", get_args(Layer), initial_value="image")
        chooses(layer, session, lambda s, value: replace(s, layer=value))
        tone = gui.add_dropdown("Tone map", ("auto", *get_args(ToneMap)), initial_value="auto")
        chooses(tone, session, lambda s, value: replace(s, tone_map=value))
        background = gui.add_dropdown("Background", BACKGROUNDS, initial_value="white")
        colour = gui.add_rgb("Colour", (64, 72, 84), visible=False)

        def behind(state: State, _: object) -> State:
            colour.visible = background.value == "colour"
            named = {"colour": "#{:02x}{:02x}{:02x}".format(*colour.value), "light": "env"}
            return replace(state, background=named.get(background.value, background.value))

        chooses(background, session, behind)
        chooses(colour, session, behind)
        hint = "Each is shaded where it is; the browser turns them without this process."
        splats = gui.add_checkbox("Splats, drawn by the browser", False, hint=hint)
        chooses(splats, session, lambda s, value: replace(s, splats=bool(value)))
        with gui.add_folder("Materials"):
            Materials(gui, session)


class Materials:
    """Gains on the materials of regions, one region at a time."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        self._gains: dict[str, tuple[float, ...]] = {}
        self._region = gui.add_dropdown("Region", (EVERYWHERE, *REGIONS), initial_value=EVERYWHERE)
        self._sliders = [
            gui.add_slider(label, 0.0, most, 0.05, 1.0)
            for label, most in (("Albedo, times", 2.0), ("Roughness, times", 2.0), ("Specular, times", 4.0))
        ]
        reset = gui.add_button("All regions as learned", icon=viser.Icon.ROTATE, color="gray")
        on_change(self._region, lambda _: self._show())
        for slider in self._sliders:
            on_change(slider, lambda _: self._apply())
        on_click(reset, self._reset)

    def _show(self) -> None:
        gains = self._gains.get(self._region.value, (1.0,) * 3)
        for slider, gain in zip(self._sliders, gains, strict=True):
            put(slider, gain)

    def _apply(self) -> None:
        self._gains[self._region.value] = tuple(float(slider.value) for slider in self._sliders)
        edits = tuple(
            edit
            for region, gains in self._gains.items()
            if (edit := material_edit(region, *gains)) is not None
        )
        self._session.change(lambda state: replace(state, edits=edits))

    def _reset(self) -> None:
        self._gains.clear()
        for slider in self._sliders:
            put(slider, 1.0)
        self._session.change(lambda state: replace(state, edits=()))


def material_edit(region: str, albedo: float, roughness: float, specular: float) -> MaterialEdit | None:
    """The edit that multiplies a region's materials, None where it changes nothing."""
    gains = {"albedo": albedo, "roughness": roughness, "specular": specular}
    changed = {name: f"x{gain:g}" for name, gain in gains.items() if gain != 1.0}
    if not changed:
        return None
    return MaterialEdit(**changed, regions=() if region == EVERYWHERE else (region,))
