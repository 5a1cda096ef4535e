"""The controls of the camera that a mouse does not have: field of view, roll, and the way back."""

from __future__ import annotations

import math

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from samira_warp.view.controls import on_change, on_click, put
from samira_warp.view.session import Session

UP = (0.0, 1.0, 0.0)
"""The world's."""


class CameraControls:
    """What the browser's camera can be told."""

    def __init__(self, gui: viser.GuiApi, session: Session, camera: viser.CameraHandle) -> None:
        self._session, self._camera = session, camera
        self._start = session.state.look
        fov = gui.add_slider("View, degrees", 3.0, 90.0, 0.5, round(self._start.fov, 1))
        self._roll = gui.add_slider("Roll, degrees", -180, 180, 1, 0)
        on_change(fov, lambda value: setattr(camera, "fov", math.radians(value)))
        on_change(self._roll, lambda value: self._tilt(float(value)))
        on_click(
            gui.add_button("Before the face", icon=viser.Icon.FOCUS_CENTERED, color="gray"), self._before_face
        )
        on_click(
            gui.add_button("Centre on the head, upright", icon=viser.Icon.CROSSHAIR, color="gray"),
            self._centre,
        )

    def _tilt(self, degrees: float) -> None:
        """Turn the camera's upward direction about its line of sight."""
        forward = np.asarray(self._camera.look_at) - np.asarray(self._camera.position)
        axis = forward / max(float(np.linalg.norm(forward)), 1e-9)
        up = Rotation.from_rotvec(math.radians(degrees) * axis).apply(UP)
        self._camera.up_direction = up

    def _before_face(self) -> None:
        """Back to where the training camera stood, about the head as it is now."""
        place = self._session.scene.place(self._session.state)
        put(self._roll, 0)
        self._camera.up_direction = np.asarray(UP)
        self._camera.position = np.asarray(self._start.position)
        self._camera.look_at = place.center.double().cpu().numpy()

    def _centre(self) -> None:
        """Look at the head's middle, the head's own up above: what ``render --camera`` can say."""
        place = self._session.scene.place(self._session.state)
        put(self._roll, 0)
        self._camera.up_direction = place.axes[:, 1].double().cpu().numpy()
        self._camera.look_at = place.center.double().cpu().numpy()
