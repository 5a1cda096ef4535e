"""The built-in subject's dataset: a VHAP export with the truth beside it, by rays cast at our own head."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from tqdm import tqdm

from samira_subject.performance import FRAMES_PER_SECOND, Performance, perform
from samira_subject.raycaster import Effort, Picture
from samira_subject.raycaster_sampling import SkyTables
from samira_subject.sky import CAPTURE, SKIES, exposure_of, paint_sky
from samira_subject.streams import Purpose, generator_of, number_of
from samira_subject.studio import Cast, Studio, developed, on_white, threads
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, Rig
from samira_warp.head.template import save_template
from samira_warp.io.files import replace_folder
from samira_warp.io.images import write_exr, write_png
from samira_warp.support.errors import UserError

VERSION = 1
"""Rises with every change that changes a pixel or a parameter of the subject."""

SIZE = 256
"""Width and height of the pictures, pixels."""

TEXELS = 1024
"""Width and height of the painted maps: about two texels a pixel at SIZE."""

ALBEDO_BLUR = 0.8 / 512
"""Standard deviation, as a share of the width, of the blur that stands for what estimates of albedo lose."""

ALBEDO_GAIN = 0.05
"""Standard deviation of the factor that stands for how far such estimates stray from frame to frame."""


@dataclass(frozen=True)
class SubjectPlan:
    """What is made.

    Attributes:
        seed: Seed of every choice: whose head it is, what it does, and how rays are cast.
        train: Frames to train on.
        test: Frames to test on, which follow.
        relit: How many of those are taken under each of the other lights as well.
        size: Width and height of the pictures, pixels.
        texels: Width and height of the painted maps.
        effort: How many rays.

    Raises:
        UserError: A number is too small.
    """

    seed: int = 0
    train: int = 160
    test: int = 40
    relit: int = 10
    size: int = SIZE
    texels: int = TEXELS
    effort: Effort = field(default_factory=Effort)

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("train", 1), ("test", 1), ("relit", 0), ("size", 1), ("texels", 1)):
            if getattr(self, name) < least:
                raise UserError(name, expected=f"at least {least}", found=getattr(self, name))


class Light:
    """A light of the dataset.

    Attributes:
        name: One of SKIES.
        radiance: (H, W, 3) float32 panorama, as its file has it.
        exposure: Factor on it.
        tables: The light as the rays find it, exposed.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        with threads(1):
            self.radiance = paint_sky(SKIES[name])
            self.exposure = exposure_of(self.radiance)
            self.tables = SkyTables.build(self.radiance * self.exposure)

    @property
    def file(self) -> str:
        """Where the panorama lies within the dataset."""
        return f"lights/{self.name}.exr"

    def description(self) -> str:
        """What says how pictures under it are lit."""
        return _json({"file": self.file, "azimuth_degrees": 0.0, "exposure": self.exposure})


def make_subject(folder: Path, plan: SubjectPlan, cast: Cast) -> None:
    """Make a dataset, whole or not at all; a folder of that name is replaced.

    Args:
        folder: Where to.
        plan: What to make.
        cast: The head and its surface.

    Raises:
        OSError: It cannot be written.
    """
    replace_folder(folder, lambda fresh: _Maker(fresh, plan, cast).make())


class _Maker:
    """One dataset on its way into its folder."""

    def __init__(self, folder: Path, plan: SubjectPlan, cast: Cast) -> None:
        self._folder = folder
        self._plan = plan
        self._cast = cast
        self._studio = Studio(cast, size=plan.size, effort=plan.effort)
        self._lights = {name: Light(name) for name in SKIES}
        self._performance = perform(
            cast.template.expression_names, train=plan.train, test=plan.test, seed=plan.seed
        )

    def make(self) -> None:
        """Write all of it."""
        for name in ("images", "fg_masks", "albedo", "flame_param", "lights", "gt/albedo", "gt/normal"):
            (self._folder / name).mkdir(parents=True)
        self._write_facts()
        self._write_lights()
        relit = self._relit_frames()
        total = len(self._performance) + len(relit) * len(self._other_lights())
        with tqdm(total=total, unit="picture", dynamic_ncols=True) as bar:
            for index in range(len(self._performance)):
                self._take_frame(index, relit=index in relit, bar=bar)

    def _other_lights(self) -> list[Light]:
        return [light for name, light in self._lights.items() if name != CAPTURE]

    def _relit_frames(self) -> range:
        first, step = self._plan.train, max(self._plan.test // max(self._plan.relit, 1), 1)
        return range(first, first + min(step * self._plan.relit, self._plan.test), step)

    def _take_frame(self, index: int, *, relit: bool, bar: tqdm) -> None:
        """The pictures and the parameters of one frame."""
        parameters = self._performance.frame(index)
        np.savez(self._folder / "flame_param" / f"{index:05d}.npz", **self._arrays(parameters))
        posed = self._studio.pose(parameters)
        trains = index < self._plan.train
        bar.set_description(f"frame {index} under {CAPTURE}")
        picture = self._studio.take(
            posed, self._lights[CAPTURE].tables, seed=number_of(self._plan.seed, Purpose.RAYS, index, 0)
        )
        bar.update()
        file = f"{index:05d}_00.png"
        write_png(self._folder / "images" / file, developed(picture))
        write_png(self._folder / "fg_masks" / file, picture.coverage.numpy())
        if trains:
            write_png(self._folder / "albedo" / file, self._estimated_albedo(picture, index))
            return
        write_png(self._folder / "gt" / "albedo" / file, on_white(picture.albedo, picture.coverage))
        write_png(self._folder / "gt" / "normal" / file, (0.5 + 0.5 * picture.normal).numpy())
        for number, light in enumerate(self._other_lights() if relit else [], start=1):
            bar.set_description(f"frame {index} under {light.name}")
            picture = self._studio.take(
                posed, light.tables, seed=number_of(self._plan.seed, Purpose.RAYS, index, number)
            )
            bar.update()
            write_png(self._folder / "gt" / "relight" / light.name / file, developed(picture))

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

    def _write_lights(self) -> None:
        for light in self._lights.values():
            write_exr(self._folder / light.file, light.radiance.numpy())
            if light.name == CAPTURE:
                (self._folder / "gt" / "capture_light.json").write_text(light.description(), encoding="utf-8")
            else:
                (self._folder / "gt" / "relight" / light.name).mkdir(parents=True)
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
