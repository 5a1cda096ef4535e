"""The built-in subject's dataset: a VHAP export with the truth beside it, by rays cast at our own head."""

from __future__ import annotations

import json
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

from samira_subject.lights import DatasetLight, built_in_light
from samira_subject.orbit import POSES, held_poses, orbit_camera, view_name
from samira_subject.performance import FRAMES_PER_SECOND, Performance, perform
from samira_subject.plan import HIDDEN_FILE, ORBIT, VERSION, SubjectPlan, Take, film_name
from samira_subject.raycaster import Picture, PosedSkin
from samira_subject.streams import Purpose, generator_of, number_of
from samira_subject.studio import Cast, Studio, developed, on_white
from samira_subject.transforms import entry, write_transforms
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.head import FrameParameters, Rig
from samira_warp.head.template import save_template
from samira_warp.io.files import resume_folder, whole_file
from samira_warp.io.images import write_exr, write_png
from samira_warp.light import encode_srgb

ALBEDO_BLUR = 0.8 / 512
"""Standard deviation, as a share of the width, of the blur that stands for what estimates of albedo lose."""

FINISH_LAYERS = ("gt/roughness", "gt/specular")
"""What is written of `Picture.finish`, in its order."""

HIDDEN_FACT = (
    "motion that the template has no shapes for and the tracks do not say, a function of pose and "
    "expression: displacement (frames, vertices, 3) of the posed vertices, metres along the world's axes"
)
"""What dataset.json says of it."""

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
        cast: Makes the head and its surface, which must be the plan's seed's, hidden motion as the plan says.
        lights: The plan's lights in its order; None are the skies of those names.

    Raises:
        OSError: It cannot be written.
    """
    digests = [] if lights is None else [light.digest for light in lights]

    def fill(half: Path) -> None:
        _make(half, plan, cast, [built_in_light(name) for name in plan.lights] if lights is None else lights)

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
        names = cast.template.expression_names
        self._performance = perform(
            names, train=plan.train, test=plan.test, seed=plan.seed, quick_tilts=plan.hidden
        )
        self._held = held_poses(self._performance, names)

    def make(self, takes: Sequence[Take]) -> None:
        """Write all but the pictures, which takes no time, and take those that are asked for."""
        every = self._plan.takes()
        for name in {layer for take in every for layer in take.layers} | {"albedo", "flame_param", "lights"}:
            (self._folder / name).mkdir(parents=True, exist_ok=True)
        self._write_facts()
        self._write_lights()
        poses = [self._performance.frame(index) for index in range(len(self._performance))]
        self._write_export(self._folder, poses)
        self._write_hidden(poses)
        self._write_transforms()
        if self._plan.orbit:
            self._write_export(self._folder / ORBIT, self._held)
            self._write_orbit()
        total = len(every)
        with tqdm(total=total, initial=total - len(takes), unit="picture", dynamic_ncols=True) as bar:
            for (pose, of_orbit), of_pose in groupby(takes, key=lambda take: (take.pose, bool(take.view))):
                posed = self._studio.pose(self._held[pose] if of_orbit else self._performance.frame(pose))
                for take in of_pose:
                    bar.set_description(str(take))
                    self._take(take, posed)
                    bar.update()

    def _take(self, take: Take, posed: PosedSkin) -> None:
        """Take one picture and write its files, each whole."""
        sky, camera = self._lights[take.light].tables, self._studio.camera
        if take.view is None:
            seed = number_of(self._plan.seed, Purpose.RAYS, take.pose, self._plan.lights.index(take.light))
        else:
            camera = orbit_camera(camera, take.view)
            seed = number_of(
                self._plan.seed, Purpose.ORBIT, take.pose, take.view.yaw % 360, take.view.pitch % 360
            )
        picture = self._studio.take(posed, sky, seed=seed, camera=camera)
        for layer in take.layers:
            with whole_file(self._folder / layer / take.file) as path:
                write_png(path, self._layer(layer, picture, take.pose))

    def _layer(self, layer: str, picture: Picture, frame: int) -> np.ndarray:
        """What of a picture goes into one of the dataset's folders, display values."""
        if layer.endswith("fg_masks"):
            return picture.coverage.numpy()
        if layer == "albedo":
            return self._estimated_albedo(picture, frame)
        if layer == "gt/albedo":
            return on_white(picture.albedo, picture.coverage)
        if layer == "gt/normal":
            return (0.5 + 0.5 * picture.normal).numpy()
        if layer in FINISH_LAYERS:
            return np.rint(65535.0 * picture.finish[..., FINISH_LAYERS.index(layer)].numpy()).astype(
                np.uint16
            )
        if layer.startswith("gt/highlights/"):
            return encode_srgb(picture.specular).numpy()
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

    def _write_export(self, folder: Path, poses: Sequence[FrameParameters]) -> None:
        """What makes a folder a VHAP export, but for its lists of frames: template, identity and poses."""
        (folder / "flame_param").mkdir(exist_ok=True)
        save_template(self._cast.template, folder / "template.npz")
        np.savez(folder / CANONICAL_FILE, **self._arrays(Rig.build(self._cast.template).rest()))
        for index, pose in enumerate(poses):
            np.savez(folder / "flame_param" / f"{index:05d}.npz", **self._arrays(pose))

    def _write_hidden(self, poses: Sequence[FrameParameters]) -> None:
        """What moves as the tracks do not say, where something does."""
        hidden = self._cast.hidden
        if hidden is None:
            return
        rig = Rig.build(self._cast.template)
        moved = [hidden.in_world(pose, rig.pose(pose, self._cast.identity)).numpy() for pose in poses]
        np.savez_compressed(self._folder / HIDDEN_FILE, displacement=np.stack(moved))

    def _write_transforms(self) -> None:
        camera, train = self._studio.camera, self._plan.train
        frames = [entry(film_name(index), camera, timestep=index) for index in range(len(self._performance))]
        write_transforms(self._folder, camera, {"train": frames[:train], "val": [], "test": frames[train:]})

    def _write_orbit(self) -> None:
        """The orbit's lists: all is to test on but the neutral pose from the front, which training saw."""
        camera, frames, angles = self._studio.camera, [], []
        for pose, kind in enumerate(POSES):
            for index, view in enumerate(self._plan.orbit):
                name, seen = view_name(pose, view), orbit_camera(camera, view)
                frames.append(entry(name, seen, timestep=pose, camera_index=index))
                angles.append({"name": name, "pose": kind, "yaw": view.yaw, "pitch": view.pitch})
        folder = self._folder / ORBIT
        write_transforms(folder, camera, {"train": frames[:1], "val": [], "test": frames[1:]})
        (folder / "orbit.json").write_text(_json({"frames": angles}), encoding="utf-8")

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
        """What the dataset is."""
        facts = _facts(self._plan, self._performance)
        (self._folder / "dataset.json").write_text(_json(facts), encoding="utf-8")


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
        "by Rec.709 luminance; the lamp's irradiance on a surface that faces it is pi",
        "albedo": "pseudo-albedo of train frames: true diffuse colour, blurred by "
        f"{ALBEDO_BLUR * plan.size:g} px, gain jittered {100 * ALBEDO_GAIN:g} %; sRGB encoded, on white",
        "gt/albedo": "true diffuse colour of test frames, sRGB encoded, on white",
        "gt/normal": "test frames, world space, (n+1)/2, shading normals with bumps",
        "gt/roughness": "perceptual roughness (its square is GGX's alpha) of test frames, 16 bits over "
        "0 to 1, the mean over what a pixel holds of the head; 0 where that is nothing",
        "gt/specular": "reflectance at normal incidence of test frames, encoded likewise",
        "gt/relight/<light>": "test frames under another light; "
        "<light>.json has file, azimuth_degrees, exposure",
        "gt/highlights/<light>": "the specular light alone of those frames, sRGB encode(linear radiance "
        "x exposure), clipped, the mean over what a pixel holds of the head; 0 where that is nothing",
        "gt/orbit": "a dataset of its own: two poses held, filmed from around under the light of images/; "
        "orbit.json says yaw (degrees from +z towards +x) and pitch (above the horizon) of each picture; all "
        "but the first are test frames",
        "gt/capture_light.json": "the light of images/",
    } | ({HIDDEN_FILE: HIDDEN_FACT} if plan.hidden else {})


def _json(values: dict[str, object]) -> str:
    return json.dumps(values, indent=1)
