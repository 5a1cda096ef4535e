"""Pictures of the built-in subject's head by its own ray caster, large enough for networks to see a face."""

from dataclasses import asdict, dataclass

import numpy as np
from PIL import Image

from samira_subject.cast import build_cast
from samira_subject.lights import built_in_light
from samira_subject.performance import perform
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE
from samira_subject.studio import Studio, developed
from samira_warp.head import Rig

SIZE = 256

OPEN = (0, 17, 47, 70)
"""Frames of the performance whose eyes are open: at rest, speaking, then turned to either side."""

CLOSED = (38, 145, 168)
"""Frames in the middle of a blink, turned by 13 to 24 degrees."""

FEW_RAYS = Effort(samples=4, lights=2, lobes=1, more=4, rounds=1)


@dataclass(frozen=True, eq=False)
class Portrait:
    """A picture on white, (256, 256, 3) uint8, with its coverage, and the projections of both corneas."""

    picture: np.ndarray
    coverage: np.ndarray
    corneas: np.ndarray


def write_portraits(folder):
    """Into a new folder, a file for each frame."""
    folder.mkdir()
    for frame, portrait in take_portraits().items():
        np.savez(folder / f"{frame}.npz", **asdict(portrait))


def read_portraits(folder):
    """By frame."""
    portraits = {}
    for frame in OPEN + CLOSED:
        with np.load(folder / f"{frame}.npz") as arrays:
            portraits[frame] = Portrait(**arrays)
    return portraits


def take_portraits():
    """By frame."""
    cast = build_cast(0, texels=512)
    played = perform(cast.template.expression_names, train=160, test=40, seed=0)
    studio, rig, sky = (
        Studio(cast, size=SIZE, effort=FEW_RAYS),
        Rig.build(cast.template),
        built_in_light(CAPTURE),
    )
    rest = rig.pose(rig.rest(), cast.identity).vertices
    fronts = []
    for side in ("left", "right"):
        ball = cast.template.masks[f"{side}_eyeball"]
        fronts.append(int(ball[rest[ball, 2].argmax()]))
    taken = {}
    for frame in OPEN + CLOSED:
        parameters = played.frame(frame)
        shot = studio.take(studio.pose(parameters), sky.tables, seed=frame)
        alpha = shot.coverage.numpy()
        colours = developed(shot) * alpha[..., None] + 1.0 - alpha[..., None]
        points = rig.pose(parameters, cast.identity).vertices[fronts].numpy()
        picture = np.rint(255.0 * colours.clip(0.0, 1.0)).astype(np.uint8)
        taken[frame] = Portrait(picture, alpha, _projected(points, studio.camera))
    return taken


def _projected(points, camera):
    matrix = camera.world_to_camera.numpy()
    inside = points @ matrix[:3, :3].T + matrix[:3, 3]
    return inside[:, :2] / inside[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def pasted(*placed, width, height, background=255):
    """A picture of a background with others on it: (picture, left, top, side) each, scaled to the side."""
    canvas = Image.new("RGB", (width, height), (background,) * 3)
    for picture, left, top, side in placed:
        canvas.paste(Image.fromarray(picture).resize((side, side), Image.Resampling.BOX), (left, top))
    return np.asarray(canvas)
