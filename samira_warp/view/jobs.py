"""What a browser takes away: a picture, and a film of a turn."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from samira_warp.io.images import encode_png
from samira_warp.stage.video import VideoWriter
from samira_warp.stage.viewpoint import HeadPlace
from samira_warp.view.look import Look
from samira_warp.view.scene import Sides
from samira_warp.view.session import Job, Session
from samira_warp.view.sizes import fit
from samira_warp.view.state import State

SNAPSHOT_SCALE, LARGEST_SNAPSHOT = 2, 4096
"""Pixels of a snapshot for each of the window's, and along its longer side at most."""

FILM_SIDE, FILM_RATE = 720, 25.0
"""Longer side of a film, pixels, and its frames per second."""

Turning = Literal["camera", "light"]


def snapshot(session: Session) -> Job:
    """The picture at twice the window's size, as a PNG file."""
    state, (width, height) = session.state, session.window
    wide, high = fit(SNAPSHOT_SCALE * width, SNAPSHOT_SCALE * height, longer=LARGEST_SNAPSHOT)
    session.screen.download(
        "snapshot.png", encode_png(session.scene.picture(state, Sides.new(), width=wide, height=high))
    )
    yield


def turntable(session: Session, *, turning: Turning, seconds: float) -> Job:
    """A film of one turn of the camera about the head, or of the light, in the window's shape."""
    state, (width, height) = session.state, session.window
    wide, high = fit(width, height, longer=FILM_SIDE)
    count, sides = max(round(seconds * FILM_RATE), 1), Sides.new()
    place = session.scene.place(state)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "turntable.mp4"
        with VideoWriter(path, frames_per_second=FILM_RATE) as video:
            for index in range(count):
                turned = turned_by(state, 360.0 * index / count, turning=turning, place=place)
                video.add(session.scene.picture(turned, sides, width=wide, height=high))
                yield
        session.screen.download("turntable.mp4", path.read_bytes())


def turned_by(state: State, degrees: float, *, turning: Turning, place: HeadPlace) -> State:
    """The state with its light, or its camera about the head's middle, turned about the vertical."""
    if turning == "light":
        light = replace(state.light, rotate=state.light.rotate + degrees)
        return replace(state, light=light)
    turn = Rotation.from_rotvec([0.0, math.radians(degrees), 0.0])
    center = place.center.double().cpu().numpy()
    w, x, y, z = state.look.wxyz
    position = turn.apply(np.asarray(state.look.position) - center) + center
    x, y, z, w = (turn * Rotation.from_quat([x, y, z, w])).as_quat().tolist()
    px, py, pz = position.tolist()
    return replace(state, look=Look((px, py, pz), (w, x, y, z), state.look.fov))
