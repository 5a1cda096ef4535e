"""Films of the built-in subject that its own ray caster takes, large enough for networks to see a face."""

from dataclasses import dataclass
from fractions import Fraction

import av
import numpy as np
import torch

from samira_subject.cast import build_cast
from samira_subject.gestures import BLINK
from samira_subject.lights import built_in_light
from samira_subject.performance import perform
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE
from samira_subject.studio import Studio, developed
from samira_warp.head import FrameParameters, Rig, read_template, save_template

SIZE = 256
MOMENTS = range(27, 49)
"""Of the performance: the head speaks and turns by 20 degrees, and its eyes are closed in the middle."""

RATE = 25

BIAS = 2.2
"""Pixels of 256 by which landmarks of a head that is turned by 20 to 30 degrees lie beside their places, in
the median and all the same way: the 4.4 of 512 that docs/heads.md has of other people's renders."""

PARAMETERS = ("translation", "rotations", "expression")
"""Names of a frame's."""

FEW_RAYS = Effort(samples=2, lights=1, lobes=1, more=2, rounds=1)
FEW_STEPS = ((96, 8), (192, 8))
"""`render_fit.LEVELS` where it does not matter how well the subject is found."""

LEFT, TOP, WIDTH, HEIGHT = 150, 34, 600, 290
"""Where the subject's pictures stand in a video, at its foot, and the video's size: the focal
length, 2.8 times the pictures' width, is then 1.2 of the video's, as is usual."""


@dataclass(frozen=True, eq=False)
class Taken:
    """A film and what is known of it.

    Attributes:
        pictures: (N, SIZE, SIZE, 3) uint8, on grey.
        coverage: (N, SIZE, SIZE) float32.
        pixels: (N, V, 2) float32 where the vertices are seen in the pictures.
        parameters: N frames.
        template: The head.
    """

    pictures: np.ndarray
    coverage: np.ndarray
    pixels: np.ndarray
    parameters: FrameParameters
    template: object

    def blink(self):
        """(N,) how far both eyes are closed, 0 to 1."""
        names = self.template.expression_names
        lids = [number for number, name in enumerate(names) if name.startswith(BLINK)]
        return self.parameters.expression[:, lids].mean(dim=1).numpy()


def write_taken(folder):
    """Film some moments of the performance, and write all of it into a new folder."""
    folder.mkdir()
    taken = take()
    save_template(taken.template, folder / "template.npz")
    frames = {name: getattr(taken.parameters, name).numpy() for name in PARAMETERS}
    np.savez(
        folder / "film.npz", pictures=taken.pictures, coverage=taken.coverage, pixels=taken.pixels, **frames
    )


def read_taken(folder):
    with np.load(folder / "film.npz") as arrays:
        frames = {name: torch.from_numpy(arrays[name]) for name in PARAMETERS}
        seen = (arrays["pictures"], arrays["coverage"], arrays["pixels"])
    return Taken(*seen, FrameParameters(**frames), read_template(folder / "template.npz"))


def take():
    """Film some moments of the performance."""
    cast = build_cast(0, texels=512)
    played = perform(cast.template.expression_names, train=160, test=40, seed=0)
    studio, sky = Studio(cast, size=SIZE, effort=FEW_RAYS), built_in_light(CAPTURE).tables
    rig = Rig.build(cast.template)
    pictures, coverage, pixels = [], [], []
    for frame in MOMENTS:
        shot = studio.take(studio.pose(played.frame(frame)), sky, seed=frame)
        alpha = shot.coverage.numpy()
        colours = developed(shot) * alpha[..., None] + BACKDROP * (1.0 - alpha[..., None])
        pictures.append(np.rint(255.0 * colours.clip(0.0, 1.0)).astype(np.uint8))
        coverage.append(alpha)
        pixels.append(projected(rig.pose(played.frame(frame), cast.identity).vertices.numpy(), studio.camera))
    parameters = FrameParameters.stack([played.frame(frame) for frame in MOMENTS])
    return Taken(np.stack(pictures), np.stack(coverage), np.stack(pixels), parameters, cast.template)


BACKDROP = np.array([0.55, 0.6, 0.58])


def projected(points, camera):
    """(V, 2) pixels of (V, 3) points."""
    matrix = camera.world_to_camera.numpy()
    inside = points @ matrix[:3, :3].T + matrix[:3, 3]
    return inside[:, :2] / inside[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def placed(picture):
    """(HEIGHT, WIDTH, 3) the subject's picture in its place before the backdrop."""
    canvas = np.tile(np.rint(255.0 * BACKDROP).astype(np.uint8), (HEIGHT, WIDTH, 1))
    canvas[TOP : TOP + SIZE, LEFT : LEFT + SIZE] = picture
    return canvas


def write_film(path, pictures, *, rate=RATE):
    """A video of pictures (H, W, 3) uint8 of even sides, near enough to lossless."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": "6", "preset": "fast"})
        stream.pix_fmt = "yuv444p"
        stream.height, stream.width = pictures[0].shape[:2]
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path
