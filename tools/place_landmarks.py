"""Place the face mesh's landmarks on a head model, from pictures of it that the landmark network looks at.

usage: python tools/place_landmarks.py --head FILE_OR_FOLDER --out FILE.npz [--models DIR] [--picture FILE]
       python tools/place_landmarks.py [--head FILE_OR_FOLDER] --out FILE.csv [--models DIR] [--picture FILE]

Without --head it is the built-in one, under its own paint; other heads get a plain paint after their masks
(lips, scalp, eyeballs, teeth, mouth). A .npz is the head with its landmarks, a .csv the landmarks alone, as
they come with this package. Then pictures of other people are taken, and how far the landmarks are from what
the network sees in those is printed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw
from tqdm import tqdm

from samira_subject.anatomy.assembly import mean_anatomy
from samira_subject.anatomy.face_mesh import rims as built_in_rims
from samira_subject.cast import build_cast
from samira_subject.paint.plain import plain_paint
from samira_subject.raycaster import Effort
from samira_subject.raycaster_sampling import SkyTables
from samira_subject.sky import Sky, Softbox, exposure_of, paint_sky
from samira_subject.studio import Cast, Studio, developed
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, HeadTemplate, LandmarkEmbedding, Rig, read_head, save_template
from samira_warp.head.ict import is_ict
from samira_warp.head.ict_regions import ict_rims
from samira_warp.head.landmark_placement import Sighting, place_landmarks
from samira_warp.head.landmarks import MESH_LANDMARKS
from samira_warp.head.placed_landmarks import write_placed
from samira_warp.head.uv_layout import with_one_atlas
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.vision.crops import Square
from samira_warp.vision.face_shape import face_shape
from samira_warp.vision.mesh import settle
from samira_warp.vision.networks import FaceNetworks
from samira_warp.vision.runtime import Network

SIZE = 512
"""Width and height of the pictures, pixels."""

TEXELS = 1024

EFFORT = Effort(samples=2, lights=1, lobes=1, more=4, rounds=1, tolerance=0.1)
"""Rays of a picture: the network sees its noise no more than a camera's."""

SOFT = Sky(
    zenith=(0.90, 0.92, 0.95),
    horizon=(0.80, 0.80, 0.80),
    ground=(0.45, 0.43, 0.40),
    softboxes=(Softbox(20.0, 25.0, 90.0, 80.0, (1.40, 1.35, 1.30), 0.6),),
)
"""An overcast day and a large window: no shadow has an edge."""

ALL_ROUND = (
    (0, 0),
    (-15, 0),
    (15, 0),
    (-30, 0),
    (30, 0),
    (-45, 0),
    (45, 0),
    (0, 15),
    (0, -15),
    (25, 12),
    (-25, 12),
)
"""Degrees from before the face to the camera, to the subject's left and up."""

NEAR_FRONT = ((0, 0), (-25, 0), (25, 0))

PEOPLE, OTHERS = (0, 1, 2, 3), (4, 5)
"""Who is looked at to place landmarks, and whom they are compared with; 0 is the mean head."""

SPREAD = 0.7
"""Standard deviation of identities of heads that are not the built-in one, in units of their shapes."""

OPENING = 0.2
"""Radians of a jaw, or twice that of a shape jawOpen."""


@dataclass(frozen=True)
class PlaceConfig:
    """Place the face mesh's landmarks on a head model."""

    out: Path
    """A .npz for the head with its landmarks, or a .csv for the landmarks alone."""
    head: Path | None = None
    """The head model; without it the built-in one."""
    models: Path | None = None
    """Folder of the network files; without it they are fetched."""
    picture: Path | None = None
    """A .png to draw the landmarks in, on the mean head from four sides."""


class Shot(NamedTuple):
    """A picture, and what the network saw in it."""

    picture: np.ndarray
    sighting: Sighting


def main(config: PlaceConfig) -> None:
    """Place, write, and compare."""
    if config.out.suffix not in {".npz", ".csv"}:
        raise UserError("--out", expected="the name of a .npz or .csv file", found=config.out.name)
    network = FaceNetworks.load(config.models).mesh
    template = None if config.head is None else with_one_atlas(read_head(config.head))
    shots = list(_all_shots(template, network, PEOPLE))
    mean = build_cast(0, texels=64).template if template is None else template
    shape = face_shape()
    landmarks = place_landmarks(
        mean,
        [shot.sighting for shot in shots],
        across=shape.points[:, 0] / np.abs(shape.points[:, 0]).max(),
        mirror=shape.mirror,
        rims=_rims(config.head, mean),
    )
    placed = replace(mean, landmarks=landmarks)
    if config.out.suffix == ".npz":
        save_template(placed, config.out)
    else:
        write_placed(config.out, landmarks, mean.v_template, mean.faces)
    if config.picture is not None:
        _draw(config.picture, [shots[index] for index in (0, 3, 6, 11)], placed, landmarks)
    _compare("the same people", shots, placed, landmarks)
    _compare("two others", list(_all_shots(template, network, OTHERS)), placed, landmarks)


def _rims(head: Path | None, template: HeadTemplate) -> dict[str, np.ndarray]:
    """Edges of lids and lips, where they are known."""
    if head is None:
        return built_in_rims(mean_anatomy())
    return ict_rims(template) if is_ict(head) else {}


def _all_shots(template: HeadTemplate | None, network: Network, people: tuple[int, ...]) -> Iterator[Shot]:
    """Pictures of some people, and what the network saw in them; those in which it saw none are left out."""
    sky = paint_sky(SOFT)
    tables = SkyTables.build(sky * exposure_of(sky))
    total = len(people) * (len(ALL_ROUND) + 2 * len(NEAR_FRONT))
    with tqdm(total=total, unit="picture", desc="looking", dynamic_ncols=True) as bar:
        for seed in people:
            cast = build_cast(seed, texels=TEXELS) if template is None else _cast(template, seed)
            studio = Studio(cast, size=SIZE, effort=EFFORT)
            rig = Rig.build(cast.template)
            for parameters, opened, views in _poses(rig, cast.template.expression_names):
                posed = studio.pose(parameters)
                vertices = rig.pose(parameters, cast.identity).vertices
                for bearing, above in views:
                    bar.update()
                    camera = _seen_from(studio.camera, bearing, above)
                    picture = developed(posed.render(camera, tables, effort=EFFORT, seed=seed))
                    levels = np.rint(picture * 255.0).astype(np.uint8)
                    square = _square(camera, vertices[cast.template.masks["face"]])
                    reading = settle(network, levels, square)
                    if reading.settled:
                        yield Shot(levels, Sighting(camera, vertices, reading.landmarks[:, :2], opened))


def _cast(template: HeadTemplate, seed: int) -> Cast:
    """A person of a head model that has no paint of its own."""
    if "face" not in template.masks:
        raise UserError(
            "--head", expected="a template with mask_face, to know where its face is", found="none"
        )
    identity = SPREAD * np.random.default_rng(seed).standard_normal(template.n_shape) * (seed > 0)
    return Cast(template, torch.from_numpy(identity.astype(np.float32)), plain_paint(template, size=TEXELS))


def _poses(
    rig: Rig, names: tuple[str, ...]
) -> Iterator[tuple[FrameParameters, bool, tuple[tuple[int, int], ...]]]:
    """At rest from all round, with the mouth open, and smiling; whether it is open, and from where."""
    yield rig.rest(), False, ALL_ROUND
    for smile, opening in ((0.0, OPENING), (0.7, 0.6 * OPENING)):
        parameters = rig.rest()
        for name in ("mouthSmile_L", "mouthSmile_R", "mouthUpperUp_L", "mouthUpperUp_R"):
            if name in names:
                parameters.expression[names.index(name)] = smile
        if "jawOpen" in names:
            parameters.expression[names.index("jawOpen")] = 2.0 * opening
        elif "jaw" in rig.joint_names:
            parameters.rotations[rig.joint("jaw"), 0] = opening
        yield parameters, True, NEAR_FRONT


def _seen_from(camera: Camera, bearing: float, above: float) -> Camera:
    """A camera that is carried round the middle of what it looks at, degrees to its right and up."""
    turn, rise = np.radians([-bearing, above])
    about = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    over = np.array([[1, 0, 0], [0, np.cos(rise), -np.sin(rise)], [0, np.sin(rise), np.cos(rise)]])
    middle = np.array([0.0, float(camera.world_to_camera[1, 3]), 0.0])
    motion = np.eye(4)
    motion[:3, :3] = over @ about
    motion[:3, 3] = middle - motion[:3, :3] @ middle
    transform = camera.world_to_camera.double() @ torch.from_numpy(motion)
    return replace(camera, world_to_camera=transform.float())


def _square(camera: Camera, face: torch.Tensor) -> Square:
    """A square about a face's vertices, to begin with."""
    pixels = _pixels(camera, face)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    x, y = (low + high) / 2
    return Square(float(x), float(y), 1.4 * float((high - low).max()))


def _pixels(camera: Camera, points: torch.Tensor) -> np.ndarray:
    transform = camera.world_to_camera.double()
    seen = points.double() @ transform[:3, :3].T + transform[:3, 3]
    return (
        seen[:, :2] / seen[:, 2:] * torch.tensor([camera.fx, camera.fy])
        + torch.tensor([camera.cx, camera.cy])
    ).numpy()


def _landmarks_in(sighting: Sighting, template: HeadTemplate, landmarks: LandmarkEmbedding) -> np.ndarray:
    """(L, 2) pixels of the head's landmarks in a picture."""
    points = landmarks.points(sighting.vertices.numpy(), template.faces)
    return _pixels(sighting.camera, torch.from_numpy(points))


def _compare(whom: str, shots: list[Shot], template: HeadTemplate, landmarks: LandmarkEmbedding) -> None:
    """Print how far landmarks are from what the network saw, from before and from the side."""
    for what, low, high in (
        ("from before", 0.0, 20.0),
        ("from 25 to 30 degrees", 20.0, 40.0),
        ("from 45", 40.0, 90.0),
    ):
        errors = []
        for shot in shots:
            center = shot.sighting.camera.center
            if low <= abs(np.degrees(np.arctan2(float(center[0]), float(center[2])))) < high:
                of_mesh = landmarks.ids < MESH_LANDMARKS
                places = _landmarks_in(shot.sighting, template, landmarks)[of_mesh]
                seen = shot.sighting.landmarks[landmarks.ids[of_mesh]]
                errors.append(np.linalg.norm(places - seen, axis=1))
        print(
            f"{whom}, {len(errors)} pictures {what}: {np.median(errors):.1f} px in the median, "
            f"{np.percentile(errors, 90):.1f} at 90 %, of {SIZE}"
        )


def _draw(path: Path, shots: list[Shot], template: HeadTemplate, landmarks: LandmarkEmbedding) -> None:
    """Landmarks in green and irises in magenta over pictures, and what the network saw in red."""
    sheet = Image.new("RGB", (2 * SIZE * len(shots), 2 * SIZE))
    for index, shot in enumerate(shots):
        picture = Image.fromarray(shot.picture).resize((2 * SIZE, 2 * SIZE))
        draw = ImageDraw.Draw(picture)
        seen = shot.sighting.landmarks
        places = _landmarks_in(shot.sighting, template, landmarks)
        for landmark, (x, y) in zip(landmarks.ids, 2.0 * places, strict=True):
            if landmark < MESH_LANDMARKS:
                draw.line([(x, y), tuple(2.0 * seen[landmark])], fill="red")
            draw.circle((x, y), 2.5, fill="lime" if landmark < MESH_LANDMARKS else "magenta")
        sheet.paste(picture, (2 * SIZE * index, 0))
    sheet.save(path)


if __name__ == "__main__":
    sys.exit(run(main, PlaceConfig, program="python tools/place_landmarks.py"))
