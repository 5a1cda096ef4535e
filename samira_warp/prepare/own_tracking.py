"""The package's own tracker over a prepared film: what it found, and pictures of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, HeadTemplate, Rig
from samira_warp.io.files import replace_file, whole_file
from samira_warp.io.images import read_image, to_uint8
from samira_warp.io.npz import read_npz
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.tracker.faces import landmarks_of
from samira_warp.tracker.film import Film
from samira_warp.tracker.kept import Kept
from samira_warp.tracker.mesh_film import write_mesh_video
from samira_warp.tracker.observed import View
from samira_warp.tracker.plots import write_plots
from samira_warp.tracker.track import Tracking, track
from samira_warp.vision.faces import FaceTrack
from samira_warp.vision.openness import read_openness

FIT_FILE, FACTS_FILE, CURVES_FILE, MESH_FILE = "fit.npz", "tracking.json", "curves.png", "mesh.mp4"
"""What lies in the tracking's folder."""

AT_ONCE = 8
"""Frames that are posed and drawn together."""


@dataclass(frozen=True)
class Filmed:
    """What is known of a film before it is tracked.

    Attributes:
        pictures: Its N frames.
        mattes: Their mattes.
        view: The camera.
        rate: Frames a second.
        focal: What is known of the focal length, pixels.
        numbers: (N,) the frames' numbers in the film that they were chosen from.
        left_out: Why others were not, by number.
        notes: What was said of the film.
    """

    pictures: tuple[Path, ...]
    mattes: tuple[Path, ...]
    view: View
    rate: float
    focal: float
    numbers: tuple[int, ...]
    left_out: dict[int, str]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """A tracking as it is kept.

    Attributes:
        parameters: N frames, float32.
        shape: (S,) identity.
        static_offset: (V, 3) metres.
        focal: Focal length, pixels of the film.
        albedo: (V, 3) linear.
        light: (9, 3) spherical harmonics of radiance.
    """

    parameters: FrameParameters
    shape: torch.Tensor
    static_offset: torch.Tensor
    focal: float
    albedo: torch.Tensor
    light: torch.Tensor


def track_film(
    template: HeadTemplate,
    filmed: Filmed,
    faces: FaceTrack,
    folder: Path,
    *,
    kept: Path,
    say: Callable[[str], None],
) -> None:
    """Track a film's head into a folder.

    Args:
        template: The head, with landmarks.
        filmed: The film.
        faces: What is seen in its N frames.
        folder: Where to; it exists, and is empty.
        kept: Where parts of the fit are kept as they are done, to go on from.
        say: Told of progress.

    Raises:
        UserError: A picture cannot be read, or the head has no landmarks.
        OSError: A file cannot be written.
    """
    film = Film(filmed.pictures, filmed.mattes, filmed.view, filmed.rate, filmed.focal)
    tracking = track(template, film, landmarks_of(faces), kept=Kept(kept), say=say)
    _save(tracking, folder / FIT_FILE)
    replace_file(folder / FACTS_FILE, json.dumps(_facts(filmed, tracking), indent=1))
    _draw(template, filmed, faces, tracking, folder)


def read_fit(path: Path) -> Fit:
    """Read what `track_film` kept."""
    arrays = read_npz(path, wanted=lambda key: True)
    tensors = {name: torch.from_numpy(np.asarray(values)) for name, values in arrays.items()}
    return Fit(
        FrameParameters(tensors["translation"], tensors["rotations"], tensors["expression"]),
        tensors["shape"],
        tensors["static_offset"],
        float(arrays["focal"]),
        tensors["albedo"],
        tensors["light"],
    )


def camera_of(view: View, focal: float) -> Camera:
    """The film's camera."""
    return Camera(
        view.world_to_camera(), focal, focal, view.cx, view.cy, width=view.width, height=view.height
    )


def _save(tracking: Tracking, target: Path) -> None:
    parameters = tracking.parameters
    arrays: dict[str, Any] = {
        "translation": parameters.translation.numpy(),
        "rotations": parameters.rotations.numpy(),
        "expression": parameters.expression.numpy(),
        "shape": tracking.shape.numpy(),
        "static_offset": tracking.static_offset.numpy(),
        "focal": np.float64(tracking.focal),
        "albedo": tracking.albedo.numpy(),
        "light": tracking.light.numpy(),
    }
    with whole_file(target) as path, path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _facts(filmed: Filmed, tracking: Tracking) -> dict[str, Any]:
    """What tracking.json says."""

    def by_frame(errors: torch.Tensor) -> list[float | None]:
        return [None if np.isnan(value) else round(float(value), 3) for value in _by_frame(errors)]

    stages = {"landmarks": tracking.by_landmarks, "pixels": tracking.errors}
    return {
        "frames": len(filmed.pictures),
        "frames_per_second": filmed.rate,
        "width": filmed.view.width,
        "height": filmed.view.height,
        "focal_length_pixels": tracking.focal,
        "focal_length_before": filmed.focal,
        "principal_point": [filmed.view.cx, filmed.view.cy],
        "error_pixels": {
            name: {"median": round(float(errors.nanmedian()), 3), "by_frame": by_frame(errors)}
            for name, errors in stages.items()
        },
        "left_out": {str(number): reason for number, reason in filmed.left_out.items()},
        "notes": list(filmed.notes),
    }


def _by_frame(errors: torch.Tensor) -> np.ndarray:
    """(N,) median of each frame's errors, NaN where no landmark was seen."""
    values = errors.numpy()
    found = np.full(len(values), np.nan)
    seen = ~np.isnan(values).all(axis=1)
    found[seen] = np.nanmedian(values[seen], axis=1)
    return found


def _draw(template: HeadTemplate, filmed: Filmed, faces: FaceTrack, tracking: Tracking, folder: Path) -> None:
    """Curves over time, and the mesh over the film."""
    parameters, openness = tracking.parameters, read_openness(faces)
    turns = Rotation.from_rotvec(parameters.rotation.double().numpy())
    write_plots(
        folder / CURVES_FILE,
        seconds=np.array(filmed.numbers) / filmed.rate,
        angles=turns.as_euler("XYZ", degrees=True),
        translation=parameters.translation.numpy(),
        openness={
            "left eye": openness.eyes[:, 0],
            "right eye": openness.eyes[:, 1],
            "mouth": openness.mouth,
        },
        error={
            "landmarks": _by_frame(tracking.by_landmarks),
            "pixels": _by_frame(tracking.errors),
        },
    )
    rig = Rig.build(template)

    def pictures() -> Iterator[np.ndarray]:
        for path in filmed.pictures:
            yield to_uint8(read_image(path, channels=3))

    def vertices() -> Iterator[torch.Tensor]:
        for first in range(0, len(filmed.pictures), AT_ONCE):
            some = parameters[first : first + AT_ONCE]
            head = rig.pose(some, tracking.shape, tracking.static_offset)
            yield filmed.view.in_camera(head.vertices)

    write_mesh_video(
        folder / MESH_FILE,
        pictures(),
        vertices(),
        MeshTopology.build(torch.from_numpy(template.faces.copy()), len(template.v_template)),
        camera_of(filmed.view, tracking.focal),
        frames_per_second=filmed.rate,
        landmarks=faces.landmarks[..., :2],
    )
