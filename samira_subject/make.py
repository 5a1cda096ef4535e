"""The built-in subject's dataset: a VHAP export with the truth beside it, by rays cast at our own head."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from tqdm import tqdm

from samira_subject.lights import DatasetLight
from samira_subject.performance import FRAMES_PER_SECOND, Performance, perform
from samira_subject.plan import VERSION, SubjectPlan, Take
from samira_subject.raycaster import Picture, PosedSkin
from samira_subject.streams import Purpose, generator_of, number_of
from samira_subject.studio import Cast, Studio, developed, on_white
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, Rig
from samira_warp.head.template import save_template
from samira_warp.io.files import resume_folder, whole_file
from samira_warp.io.images import write_exr, write_png

ALBEDO_BLUR = 0.8 / 512
"""Standard deviation, as a share of the width, of the blur that stands for what estimates of albedo lose."""

ALBEDO_GAIN = 0.05
"""Standard deviation of the factor that stands for how far such estimates stray from frame to frame."""


def make_subject(
    folder: Path, plan: SubjectPlan, cast: Callable[[], Cast], lights: Sequence[DatasetLight] | None = None
) -> None:
    """Make a dataset, whole or not at all; a folder of that name is replaced.

    Ctrl-C, a full disk or a killed process leave the pictures that were taken beside it, and the next call
    with the same plan goes on with them, to the same bytes; lines on standard error say so.

    Args:
        folder: Where to.
        plan: What to make.
        cast: Makes the head and its surface, which must be the plan's seed's.
        lights: The plan's lights in its order; None are the skies of those names.

    Raises:
        OSError: It cannot be written.
    """
    digests = [] if lights is None else [light.digest for light in lights]

    def fill(half: Path) -> None:
        _make(half, plan, cast, [DatasetLight(name) for name in plan.lights] if lights is None else lights)

    resume_folder(folder, fill, recipe=plan.recipe(digests))


def _make(folder: Path, plan: SubjectPlan, cast: Callable[[], Cast], lights: Sequence[DatasetLight]) -> None:
    """Write what is not there yet; say from where it goes on, and what is kept if it ends early."""
    takes = plan.takes()

    def kept() -> str:
        return f"{sum(take.is_in(folder) for take in takes)} of {len(takes)} pictures are kept in {folder}"

    if any(take.is_in(folder) for take in takes):
        print(f"going on where it stopped: {kept()}", file=sys.stderr)
    try:
        _Maker(folder, plan, cast(), lights).make([take for take in takes if not take.is_in(folder)])
    except (KeyboardInterrupt, OSError):
        print(f"stopped: {kept()}; the same command goes on with the others", file=sys.stderr)
        raise


class _Maker:
    """One dataset on its way into its folder."""

    def __init__(self, folder: Path, plan: SubjectPlan, cast: Cast, lights: Sequence[DatasetLight]) -> None:
        self._folder = folder
        self._plan = plan
        self._cast = cast
        self._studio = Studio(cast, size=plan.size, effort=plan.effort)
        self._lights = dict(zip(plan.lights, lights, strict=True))
        self._performance = perform(
            cast.template.expression_names, train=plan.train, test=plan.test, seed=plan.seed
        )

    def make(self, takes: Sequence[Take]) -> None:
        """Write all but the pictures, which takes no time, and take those that are asked for."""
        for name in ("images", "fg_masks", "albedo", "flame_param", "lights", "gt/albedo", "gt/normal"):
            (self._folder / name).mkdir(parents=True, exist_ok=True)
        self._write_facts()
        self._write_lights()
        self._write_parameters()
        total = len(self._plan.takes())
        with tqdm(total=total, initial=total - len(takes), unit="picture", dynamic_ncols=True) as bar:
            for frame, of_frame in groupby(takes, key=lambda take: take.frame):
                posed = self._studio.pose(self._performance.frame(frame))
                for take in of_frame:
                    bar.set_description(f"frame {frame} under {take.light}")
                    self._take(take, posed)
                    bar.update()

    def _take(self, take: Take, posed: PosedSkin) -> None:
        """Take one picture and write its files, each whole."""
        seed = number_of(self._plan.seed, Purpose.RAYS, take.frame, self._plan.lights.index(take.light))
        picture = self._studio.take(posed, self._lights[take.light].tables, seed=seed)
        for layer in take.layers:
            with whole_file(self._folder / layer / take.file) as path:
                write_png(path, self._layer(layer, picture, take.frame))

    def _layer(self, layer: str, picture: Picture, frame: int) -> np.ndarray:
        """What of a picture goes into one of the dataset's folders, display values."""
        if layer == "fg_masks":
            return picture.coverage.numpy()
        if layer == "albedo":
            return self._estimated_albedo(picture, frame)
        if layer == "gt/albedo":
            return on_white(picture.albedo, picture.coverage)
        if layer == "gt/normal":
            return (0.5 + 0.5 * picture.normal).numpy()
        return developed(picture)

    def _estimated_albedo(self, picture: Picture, index: int) -> np.ndarray:
        """(H, W, 3) the true albedo as a network might have estimated it, display values on white."""
        sigma = ALBEDO_BLUR * self._plan.size
        coverage = picture.coverage[..., None].numpy()
        blurred = gaussian_filter(picture.albedo.numpy() * coverage, (sigma, sigma, 0.0))
        albedo = blurred / np.maximum(gaussian_filter(coverage, (sigma, sigma, 0.0)), 1e-6)
        gain = 1.0 + ALBEDO_GAIN * generator_of(self._plan.seed, Purpose.ALBEDO, index).standard_normal()
        return on_white(torch.from_numpy((gain * albedo).astype(np.float32)), picture.coverage)

    def _arrays(self, parameters: FrameParameters) -> dict[str, Any]:
        """A frame as VHAP writes it: numpy arrays by name."""
        root, neck, jaw, *eyes = parameters.rotations.numpy()
        arrays = {
            "translation": parameters.translation.numpy(),
            "rotation": root,
            "neck_pose": neck,
            "jaw_pose": jaw,
            "eyes_pose": np.concatenate(eyes),
            "expr": parameters.expression.numpy(),
        }
        rows = {key: values[None] for key, values in arrays.items()}
        return {**rows, "shape": self._cast.identity.numpy()}

    def _write_parameters(self) -> None:
        for index in range(len(self._performance)):
            arrays = self._arrays(self._performance.frame(index))
            np.savez(self._folder / "flame_param" / f"{index:05d}.npz", **arrays)

    def _write_lights(self) -> None:
        for light in self._lights.values():
            write_exr(self._folder / light.file, light.radiance.numpy())
            if light.name == self._plan.capture:
                (self._folder / "gt" / "capture_light.json").write_text(light.description(), encoding="utf-8")
            else:
                (self._folder / "gt" / "relight" / light.name).mkdir(parents=True, exist_ok=True)
                (self._folder / "gt" / "relight" / f"{light.name}.json").write_text(
                    light.description(), encoding="utf-8"
                )

    def _write_facts(self) -> None:
        """The template, the identity, the lists of frames, and what the dataset is."""
        save_template(self._cast.template, self._folder / "template.npz")
        rest = self._arrays(Rig.build(self._cast.template).rest())
        np.savez(self._folder / CANONICAL_FILE, **rest)
        frames = [_entry(index, self._studio.camera) for index in range(len(self._performance))]
        train = self._plan.train
        for name, part in {"": frames, "_train": frames[:train], "_val": [], "_test": frames[train:]}.items():
            (self._folder / f"transforms{name}.json").write_text(
                _listing(part, self._studio.camera), encoding="utf-8"
            )
        facts = _facts(self._plan, self._performance)
        (self._folder / "dataset.json").write_text(_json(facts), encoding="utf-8")


def _entry(index: int, camera: Camera) -> dict[str, object]:
    """One frame of a transforms file."""
    camera_to_world = torch.linalg.inv(camera.world_to_camera.double())
    camera_to_world[:, 1:3] *= -1.0
    return {
        "timestep_index": index,
        "timestep_index_original": index,
        "timestep_id": f"{index:05d}",
        "camera_index": 0,
        "camera_id": "00",
        **_intrinsics(camera),
        "transform_matrix": (camera_to_world + 0.0).tolist(),
        "file_path": f"images/{index:05d}_00.png",
        "fg_mask_path": f"fg_masks/{index:05d}_00.png",
        "flame_param_path": f"flame_param/{index:05d}.npz",
    }


def _listing(frames: list[dict[str, object]], camera: Camera) -> str:
    steps = [frame["timestep_index"] for frame in frames]
    return _json({**_intrinsics(camera), "timestep_indices": steps, "camera_indices": [0], "frames": frames})


def _intrinsics(camera: Camera) -> dict[str, float]:
    return {
        "cx": camera.cx,
        "cy": camera.cy,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "h": camera.height,
        "w": camera.width,
        "camera_angle_x": 2.0 * math.atan(0.5 * camera.width / camera.fx),
        "camera_angle_y": 2.0 * math.atan(0.5 * camera.height / camera.fy),
    }


def _facts(plan: SubjectPlan, performance: Performance) -> dict[str, object]:
    """What dataset.json says."""
    return {
        "name": "built-in subject",
        "version": VERSION,
        "seed": plan.seed,
        "frames": len(performance),
        "frames_per_second": FRAMES_PER_SECOND,
        "plan": asdict(plan),
        "what": "A procedural head under a procedural sky, by an independent ray caster: shadows, two "
        "bounces, GGX, bumps, and wrinkles that come with expressions. The surface is the template's, "
        "subdivided once, with lids kept off the eyeballs. Tracks are exact.",
        "layout": "VHAP / GaussianAvatars export; template.npz is the head model with FLAME's keys",
        "world": "metres, y up, the face looks along +z; OpenGL camera-to-world in transforms.json",
        "colour": "image = sRGB encode(linear radiance x exposure), clipped, then composited on white with "
        "fg_masks in display space",
        "light": "direction d sees the map's column u = 0.5 + atan2(d.x, -d.z)/(2 pi) + azimuth/360 (mod 1) "
        "and row from the top acos(d.y)/pi, times exposure",
        "exposure_rule": "0.8 / (0.5 x mean radiance + 0.5 x irradiance on a surface facing +z / pi), "
        "by Rec.709 luminance",
        "albedo": "pseudo-albedo of train frames: true diffuse colour, blurred by "
        f"{ALBEDO_BLUR * plan.size:g} px, gain jittered {100 * ALBEDO_GAIN:g} %; sRGB encoded, on white",
        "gt/albedo": "true diffuse colour of test frames, sRGB encoded, on white",
        "gt/normal": "test frames, world space, (n+1)/2, shading normals with bumps",
        "gt/relight/<light>": "test frames under another light; "
        "<light>.json has file, azimuth_degrees, exposure",
        "gt/capture_light.json": "the light of images/",
    }


def _json(values: dict[str, object]) -> str:
    return json.dumps(values, indent=1)
