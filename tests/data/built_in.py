"""The built-in subject as a tracked film: some moments of its performance, and pictures of them by its own
ray caster.

Every layout can hold this film, turned to what the layout has a place for: the same heads are then seen by
the same camera.
"""

import functools
from dataclasses import replace

import numpy as np
import torch
from data.layouts import FLIP, WRITERS, Film, joint_rotations, write_layout

from samira_subject.cast import build_cast
from samira_subject.head import build_head
from samira_subject.lights import built_in_light
from samira_subject.performance import perform
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE
from samira_subject.studio import Studio, developed, on_white
from samira_warp.head import FrameParameters, Rig, save_template
from samira_warp.io.images import write_png

SIZE = 64
MOMENTS = (0, 9, 22, 47, 70, 93, 118, 141)
"""Frames of the performance: at rest, then turned to either side, speaking and grimacing."""

FEW_RAYS = Effort(samples=4, lights=2, lobes=1, more=4, rounds=1)


@functools.cache
def built_in_film(seed):
    """A person of the built-in head before one camera. Tests that change it copy it first.

    The head turns at its root alone: metrical-tracker's has no neck.
    """
    cast = build_cast(seed, texels=128)
    played = perform(cast.template.expression_names, train=160, test=40, seed=seed)
    rows = list(MOMENTS)
    studio = Studio(cast, size=SIZE, effort=FEW_RAYS)
    film = Film(
        shape=cast.identity.double().numpy(),
        expression=played.expression[rows].double().numpy(),
        rotation=(played.rotation + played.neck)[rows].double().numpy(),
        neck=np.zeros((len(rows), 3)),
        jaw=played.jaw[rows].double().numpy(),
        eyes=played.eyes[rows].double().numpy(),
        translation=played.translation[rows].double().numpy(),
        world_to_camera=np.tile(studio.camera.world_to_camera.double().numpy(), (len(rows), 1, 1)),
        focal=np.tile([studio.camera.fx, studio.camera.fy], (len(rows), 1)),
        center=np.tile([studio.camera.cx, studio.camera.cy], (len(rows), 1)),
        width=SIZE,
        height=SIZE,
        names=[f"{index:05d}" for index in range(len(rows))],
    )
    sky = built_in_light(CAPTURE).tables
    taken = [
        studio.take(studio.pose(parameters_of(film, row).to(dtype=torch.float32)), sky, seed=row)
        for row in range(len(film))
    ]
    coverage = [picture.coverage.numpy()[..., None] for picture in taken]
    film.pictures = _bytes(
        [np.dstack([developed(picture), alpha]) for picture, alpha in zip(taken, coverage, strict=True)]
    )
    film.albedo = _bytes([on_white(picture.albedo, picture.coverage) for picture in taken])
    return film


def _bytes(pictures):
    return np.rint(255.0 * np.stack(pictures).clip(0.0, 1.0)).astype(np.uint8)


def parameters_of(film, row):
    """A frame as the film has it, float64."""
    values = (film.translation[row], joint_rotations(film, row), film.expression[row])
    return FrameParameters(*map(torch.from_numpy, values))


def for_layout(layout, film):
    """The same film with what a layout has no place for put where it has."""
    if layout == "VHAP tracked":
        return _with_camera_at_one_metre(film)
    if layout == "metrical-tracker":
        return _still(film, _motions(film))
    if layout == "IMavatar":
        motions = np.tile(np.eye(4), (len(film), 1, 1))
        motions[:, :3, 3] = film.translation
        return _still(film, motions, turned=False)
    return film


def _with_camera_at_one_metre(film):
    """The world moved so that the camera, which looks along -z, is at (0, 0, 1)."""
    pose = film.world_to_camera[0]
    assert (film.world_to_camera == pose).all()
    assert np.array_equal(pose[:3, :3], FLIP[:3, :3])
    shift = np.array([0.0, 0.0, 1.0]) + pose[:3, :3].T @ pose[:3, 3]
    moved = film.world_to_camera.copy()
    moved[:, :3, 3] = [0.0, 0.0, 1.0]
    return replace(film, translation=film.translation + shift, world_to_camera=moved)


def _motions(film):
    """(T, 4, 4) by which each frame moves the head as a whole."""
    assert not film.neck.any()
    rig = Rig.build(build_head().template).to(dtype=torch.float64)
    shape = torch.from_numpy(film.shape)
    return np.stack(
        [rig.pose(parameters_of(film, row), shape).joint_transforms[0].numpy() for row in range(len(film))]
    )


def _still(film, motions, *, turned=True):
    """The head's motions given to the camera."""
    rotation = np.zeros_like(film.rotation) if turned else film.rotation
    return replace(
        film,
        rotation=rotation,
        translation=np.zeros_like(film.translation),
        world_to_camera=film.world_to_camera @ motions,
    )


def write_built_in(folder, film):
    """A film of the built-in head in every layout, with its template and albedo; the folders by the layouts'
    names."""
    roots = {}
    for layout in WRITERS:
        roots[layout] = write_layout(layout, for_layout(layout, film), folder / layout)
        save_template(build_head().template, roots[layout] / "template.npz")
        (roots[layout] / "albedo").mkdir()
        for name, picture in zip(film.names, film.albedo, strict=True):
            write_png(roots[layout] / "albedo" / f"{name}.png", picture / 255.0)
    return roots
