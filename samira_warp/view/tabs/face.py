"""The tab that moves the face: expressions by name, and the joints."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import viser

from samira_warp.stage.face_controls import (
    ExpressionControl,
    JointControl,
    expression_controls,
    joint_controls,
)
from samira_warp.view.controls import on_change, on_click, put
from samira_warp.view.session import Session
from samira_warp.view.state import State

DEGREES_STEP, COEFFICIENT_STEP = 0.5, 0.01


class FaceTab:
    """Sliders whose values are added to the frame's."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        shown = session.scene.shown
        template = shown.poser.template
        first, rest = expression_controls(shown.poser.frames, template)
        self._expressions: dict[str, Any] = {}
        self._joints: list[tuple[JointControl, Any]] = []
        gui.add_markdown("*Added to the frame that is shown.*")
        reset = gui.add_button("All back to 0", icon=viser.Icon.ROTATE, color="gray")
        with gui.add_folder("Head, jaw and gaze, degrees"):
            for joint in joint_controls(template):
                slider = gui.add_slider(joint.label, -joint.limit, joint.limit, DEGREES_STEP, 0.0)
                self._joints.append((joint, slider))
                on_change(slider, lambda _: self._apply())
        with gui.add_folder("Expressions"):
            self._add(gui, first)
        if rest:
            with gui.add_folder("More expressions", expand_by_default=False):
                self._add(gui, rest)
        on_click(reset, self._reset)

    def _add(self, gui: viser.GuiApi, controls: list[ExpressionControl]) -> None:
        for control in controls:
            slider = gui.add_slider(control.name, -control.limit, control.limit, COEFFICIENT_STEP, 0.0)
            self._expressions[control.name] = slider
            on_change(slider, lambda _: self._apply())

    def _apply(self) -> None:
        expression = tuple(
            (name, float(slider.value)) for name, slider in self._expressions.items() if slider.value
        )
        turns: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
        for control, slider in self._joints:
            for joint in control.joints if slider.value else ():
                turns[joint][control.axis] = float(slider.value)
        joints = tuple((joint, (x, y, z)) for joint, (x, y, z) in turns.items())

        def posed(state: State) -> State:
            return replace(state, pose=replace(state.pose, expression=expression, joints=joints))

        self._session.change(posed)

    def _reset(self) -> None:
        for slider in (*self._expressions.values(), *(slider for _, slider in self._joints)):
            put(slider, 0.0)
        self._apply()
