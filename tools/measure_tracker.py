"""How good the tracker is, where the truth is known or a picture tells: the figures of docs/tracking.md.

python tools/measure_tracker.py film --images FOLDER --fps 10 --out FILM.mp4
python -m samira_warp.prepare FILM.mp4 --out PREPARED
python tools/measure_tracker.py points --prepared PREPARED --truth DATASET
python tools/measure_tracker.py surface --prepared PREPARED --truth DATASET
python tools/measure_tracker.py likeness --prepared PREPARED
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from tyro.conf import Positional

from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.data.landmarks import read_landmarks
from samira_warp.head import Rig
from samira_warp.head.regions import REGIONS, route_faces
from samira_warp.io.images import read_image, to_uint8
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.prepare.faces import read_faces
from samira_warp.stage import VideoWriter
from samira_warp.support.cli import run
from samira_warp.tracker.faces import LIDS
from samira_warp.vision.openness import INNER_LIPS, MOUTH_CORNERS, OPEN_MOUTH, read_openness

POINTS = 200
"""Surface points whose places are compared."""

FACE = ("forehead", "left_eye", "right_eye", "nose", "lips", "cheeks")
"""Regions of the face."""

CLOSED = 0.08
"""Gap between a mesh's lids, in widths of its eye, below which the eye is closed: they touch at 0.03, by how
thick the rims are, and are 0.15 and more apart when open."""

OPEN = 0.12
"""Gap between a mesh's lips, in widths of its mouth, above which the mouth is open: 0.15 in a picture,
the threshold of `samira_warp.vision.openness`, comes out as 0.12, since priors hold expressions back."""

EYE_CORNERS = ((263, 362), (33, 133))
"""Landmarks of the left and the right eye's corners."""


@dataclass(frozen=True)
class Film:
    """Make a film of a folder of pictures."""

    images: Path
    """The pictures, in the order of their names."""
    out: Path
    """The film, an .mp4."""
    fps: float = 25.0
    """Pictures a second."""

    def run(self) -> dict[str, object]:
        """Do it, and say what came of it."""
        paths = sorted(path for path in self.images.iterdir() if not path.name.startswith("."))
        with VideoWriter(self.out, frames_per_second=self.fps) as writer:
            for path in paths:
                writer.add(to_uint8(read_image(path, channels=3)))
        return {"frames": len(paths)}


@dataclass(frozen=True)
class Points:
    """Distances in the picture between tracked surface points and true ones of the same head model."""

    prepared: Path
    """Folder of `prepare`."""
    truth: Path
    """The dataset that was filmed, with true parameters of the same template."""

    def run(self) -> dict[str, object]:
        """Do it, and say what came of it."""
        found, truth = _tracked(self.prepared), open_sequence(self.truth)
        generator = torch.Generator().manual_seed(0)
        faces = torch.from_numpy(truth.template.faces).long()
        on_face = faces[_face_of(truth)]
        corners = on_face[torch.randint(len(on_face), (POINTS,), generator=generator)]
        distances = []
        numbers = _numbers(self.prepared)
        frames = sorted(truth.frames, key=lambda frame: frame.name)
        scale = frames[0].camera.width / found.frames[0].camera.width
        for frame, number in zip(sorted(found.frames, key=lambda frame: frame.name), numbers, strict=True):
            mine = _pixels(found, frame)[corners].mean(dim=1) * scale
            theirs = _pixels(truth, frames[number])[corners].mean(dim=1)
            distances.append((mine - theirs).norm(dim=-1))
        together = torch.stack(distances)
        return {
            "width": frames[0].camera.width,
            "frames": len(numbers),
            "median_pixels": round(float(together.median()), 3),
            "ninth_tenth_pixels": round(float(together.quantile(0.9)), 3),
        }


@dataclass(frozen=True)
class Surface:
    """Normals of the tracked mesh against true ones, and its silhouette against true mattes."""

    prepared: Path
    """Folder of `prepare`."""
    truth: Path
    """The dataset that was filmed, with gt/normal and fg_masks."""

    def run(self) -> dict[str, object]:
        """Do it, and say what came of it."""
        found = _tracked(self.prepared)
        names = sorted(path.stem for path in (self.truth / "images").iterdir())
        topology = MeshTopology.build(
            torch.from_numpy(found.template.faces.copy()), len(found.template.v_template)
        )
        face, rim = _face_of(found), torch.from_numpy(found.template.masks["face"]).long()
        angles, overlaps = [], []
        ordered = sorted(found.frames, key=lambda frame: frame.name)
        for frame, number in zip(ordered, _numbers(self.prepared), strict=True):
            path = self.truth / "gt" / "normal" / f"{names[number]}.png"
            if not path.is_file():
                continue
            normals, shown = _drawn(found, frame, topology)
            truth = torch.nn.functional.normalize(
                2 * torch.from_numpy(read_image(path, channels=3)) - 1, dim=-1
            )
            matte = (
                torch.from_numpy(np.array(Image.open(self.truth / "fg_masks" / path.name).convert("L"))) > 127
            )
            on_face = (shown >= 0) & face[shown.clamp(min=0)] & matte
            cosine = (normals * truth).sum(dim=-1).clamp(-1.0, 1.0)
            angles.append(float(torch.rad2deg(cosine.acos())[on_face].mean()))
            chin = _pixels(found, frame)[rim, 1].max()
            above = (torch.arange(matte.shape[0]) < chin)[:, None]
            mine, theirs = (shown >= 0) & above, matte & above
            overlaps.append(float((mine & theirs).sum() / (mine | theirs).sum()))
        return {
            "frames": len(angles),
            "normals_degrees": round(float(np.mean(angles)), 2),
            "overlap_above_the_chin": round(float(np.mean(overlaps)), 4),
        }


@dataclass(frozen=True)
class Likeness:
    """Landmarks of the mesh against the detector's, and closed eyes and open mouths in both."""

    prepared: Path
    """Folder of `prepare`."""

    def run(self) -> dict[str, object]:
        """Do it, and say what came of it."""
        found = _tracked(self.prepared)
        detected, numbers = read_landmarks(self.prepared / "dataset"), _numbers(self.prepared)
        assert detected is not None, "the dataset has no landmarks"
        embedding = found.template.landmarks
        assert embedding is not None, "the head has no landmarks"
        ids = embedding.ids
        ordered = sorted(found.frames, key=lambda frame: frame.name)
        mesh = np.full((len(ordered), 478, 2), np.nan, np.float32)
        errors = []
        for row, frame in enumerate(ordered):
            pixels = _pixels(found, frame).numpy()
            mesh[row, ids] = embedding.points(pixels, found.template.faces)
            seen = detected.of(frame.name)
            if seen is not None:
                errors.append(np.linalg.norm(mesh[row, ids] - seen[ids], axis=1))
        side = max(ordered[0].camera.width, ordered[0].camera.height)
        openness = read_openness(read_faces(self.prepared / "film" / "faces.npz"))
        return {
            "frames": len(ordered),
            "side": side,
            "landmarks_pixels_at_512": round(float(np.nanmedian(np.concatenate(errors)) * 512 / side), 3),
            "eyes_alike": _alike(openness.closed[numbers], _closed(mesh)),
            "eyes_closed_in_pictures": int(openness.closed[numbers].sum()),
            "mouth_alike": _alike(openness.mouth[numbers] > OPEN_MOUTH, _mouth(mesh) > OPEN),
            "mouth_open_in_pictures": int((openness.mouth[numbers] > OPEN_MOUTH).sum()),
        }


def _closed(mesh: np.ndarray) -> np.ndarray:
    """(N, 2) whether the mesh's left and right eye are closed."""
    found = []
    for pairs, (outer, inner) in zip(LIDS, EYE_CORNERS, strict=True):
        upper, lower = np.array(pairs[1:6]).T
        gap = np.linalg.norm(mesh[:, upper] - mesh[:, lower], axis=-1).mean(axis=1)
        found.append(gap / np.linalg.norm(mesh[:, outer] - mesh[:, inner], axis=-1) < CLOSED)
    return np.stack(found, axis=1)


def _mouth(mesh: np.ndarray) -> np.ndarray:
    """(N,) gap of the mesh's inner lips in widths of its mouth."""
    upper, lower = np.array(INNER_LIPS).T
    left, right = MOUTH_CORNERS
    gap = np.linalg.norm(mesh[:, upper] - mesh[:, lower], axis=-1).mean(axis=1)
    return gap / np.linalg.norm(mesh[:, left] - mesh[:, right], axis=-1)


def _alike(pictures: np.ndarray, mesh: np.ndarray) -> float:
    return round(float((pictures == mesh).mean()), 4)


def _tracked(prepared: Path) -> TrackedSequence:
    return open_sequence(prepared / "dataset", split="0.5")


def _numbers(prepared: Path) -> list[int]:
    """Which of the film's frames the dataset's are, in order."""
    frames = json.loads((prepared / "dataset" / "transforms.json").read_text(encoding="utf-8"))["frames"]
    return [entry["timestep_index_original"] for entry in frames]


@torch.no_grad()
def _vertices(sequence: TrackedSequence, frame: Frame) -> Tensor:
    """(V, 3) in camera space."""
    rig = Rig.build(sequence.template)
    vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
    pose = frame.camera.world_to_camera
    return vertices @ pose[:3, :3].T + pose[:3, 3]


def _pixels(sequence: TrackedSequence, frame: Frame) -> Tensor:
    """(V, 2)."""
    points, camera = _vertices(sequence, frame), frame.camera
    focal, centre = torch.tensor([camera.fx, camera.fy]), torch.tensor([camera.cx, camera.cy])
    return points[:, :2] / points[:, 2:] * focal + centre


def _drawn(sequence: TrackedSequence, frame: Frame, topology: MeshTopology) -> tuple[Tensor, Tensor]:
    """(H, W, 3) unit normals in the world, and (H, W) the face that each pixel shows."""
    rig, camera = Rig.build(sequence.template), frame.camera
    vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
    depth = _vertices(sequence, frame)[:, 2:]
    points = torch.cat([_pixels(sequence, frame), depth], dim=1)[None]
    raster = rasterize_mesh(points, topology, width=camera.width, height=camera.height)
    normals = interpolate(mesh_normals(vertices[None], topology), raster, topology)[0]
    return torch.nn.functional.normalize(normals, dim=-1), raster.face[0].long()


def _face_of(sequence: TrackedSequence) -> Tensor:
    """(F,) bool: triangles of the face."""
    wanted = torch.tensor([REGIONS.index(region) for region in FACE])
    return torch.isin(torch.from_numpy(route_faces(sequence.template)), wanted)


@dataclass(frozen=True)
class MeasureConfig:
    """Measure a tracking."""

    what: Positional[Literal["film", "points", "surface", "likeness"]]
    """film makes a film of pictures; the others measure what prepare made of one."""
    images: Path = Path("images")
    """Of film: the pictures, in the order of their names."""
    out: Path = Path("film.mp4")
    """Of film: where to."""
    fps: float = 25.0
    """Of film: pictures a second."""
    prepared: Path = Path("prepared")
    """Of the others: the folder of prepare."""
    truth: Path = Path("truth")
    """Of points and surface: the dataset that was filmed."""


def main(config: MeasureConfig) -> None:
    """Do it, and print what came of it."""
    runs: dict[str, Film | Points | Surface | Likeness] = {
        "film": Film(config.images, config.out, config.fps),
        "points": Points(config.prepared, config.truth),
        "surface": Surface(config.prepared, config.truth),
        "likeness": Likeness(config.prepared),
    }
    print(json.dumps(runs[config.what].run()))


if __name__ == "__main__":
    sys.exit(run(main, MeasureConfig, program="python tools/measure_tracker.py"))
