"""The built-in head as the tracker takes it, with offsets that cost nothing to find, and frames of it."""

import functools

import numpy as np
import torch

from samira_subject.head import build_template
from samira_warp.head.landmarks import LANDMARKS
from samira_warp.tracker.faces import GAPS
from samira_warp.tracker.landmark_fit import LandmarkModel
from samira_warp.tracker.landmark_terms import pose
from samira_warp.tracker.observed import Landmarks, View
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.unknowns import Unknowns

VIEW = View(256, 256, cx=128.0, cy=120.0)
FOCAL = 500.0


@functools.cache
def head():
    """Its offsets are products of coordinates, and last a dome on the crown: smooth, and not constant."""
    template = build_template()
    points = template.v_template.astype(np.float64)
    x, y, z = ((points - points.mean(axis=0)) / points.std(axis=0)).T
    crown = points[points[:, 1].argmax()]
    dome = np.exp(-(((points - crown) / 0.06) ** 2).sum(axis=1))
    basis = np.stack([x, y, z, x * y, y * z, z * x, dome], axis=1)
    return TrackedHead.build(
        template,
        basis=basis / np.sqrt((basis**2).mean(axis=0)),
        eigenvalues=np.array([1, 1, 1, 2, 2, 2, 1.0]),
    )


@functools.cache
def model():
    """All 478 landmarks on it."""
    return LandmarkModel.build(head(), head().template.landmarks)


def performed(frames, *, seed=0, focal=FOCAL):
    """A person who turns, talks and looks about, smoothly."""
    generator = torch.Generator().manual_seed(seed)
    layout = head().layout
    unknowns = Unknowns.at_rest(layout, frames=frames, focal=focal)
    seconds = torch.linspace(0.0, 1.0, frames, dtype=torch.float64)
    values = unknowns.frames
    # the head's middle stands three quarters of a metre before the camera
    values[:, layout.translation] = torch.stack([0.01 * seconds, 0.01 - 0.01 * seconds, 0.2 + 0 * seconds], 1)
    values[:, layout.turn(0)] = torch.stack([0.1 * seconds, 0.5 * seconds - 0.25, 0.05 * seconds], 1)
    jaw, *eyes = (head().rig.joint_names.index(name) for name in ("jaw", "left_eye", "right_eye"))
    values[:, layout.turn(jaw).start] = 0.2 * seconds
    for eye in eyes:
        values[:, layout.turn(eye).start + 1] = 0.2 * seconds
    strong = torch.randperm(layout.expressions, generator=generator)[:6]
    values[:, layout.expression.start + strong] = 0.6 * seconds[:, None]
    subject = unknowns.subject
    subject[layout.identity] = torch.randn(layout.identities, generator=generator, dtype=torch.float64)
    subject[layout.offset] = 5e-4 * torch.randn(3 * layout.functions, generator=generator).double()
    return unknowns


def pixels_of(points, unknowns):
    """(N, L, 2) where `SurfacePoints` are seen, and (N, L) how far away."""
    camera = VIEW.in_camera(pose(points, unknowns, slice(None)).points)
    return VIEW.project(camera, unknowns.focal), camera[..., 2]


def seen_landmarks(unknowns, *, noise=0.0, seed=1):
    """What a detector would find that errs by so many pixels, each landmark by its own."""
    ids = model().ids
    found, depths = pixels_of(model().points, unknowns)
    generator = torch.Generator().manual_seed(seed)
    points = torch.zeros(len(found), LANDMARKS, 2)
    points[:, ids] = found + noise * torch.randn(found.shape, generator=generator)
    depth = torch.zeros(len(found), LANDMARKS)
    scale = unknowns.focal / depths.mean(dim=1, keepdim=True)
    depth[:, ids] = scale * (depths - depths.mean(dim=1, keepdim=True))
    upper, lower = torch.tensor(GAPS).T
    return Landmarks(
        points,
        depth,
        torch.ones(len(found), LANDMARKS),
        points[:, upper] - points[:, lower],
        torch.ones(len(found), len(GAPS)),
    )


def vertices_in_picture(unknowns):
    """(N, V, 2) pixels of all vertices."""
    offset = head().basis @ unknowns.offset.float()
    posed = head().rig.pose(unknowns.parameters().to(dtype=torch.float32), unknowns.shape.float(), offset)
    return VIEW.project(VIEW.in_camera(posed.vertices), unknowns.focal)
