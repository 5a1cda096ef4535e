"""Landmarks placed anew from pictures whose truth is known: the built-in head's own landmarks, projected."""

import dataclasses

import numpy as np
import pytest
import torch

from samira_subject.anatomy.assembly import mean_anatomy
from samira_subject.anatomy.face_mesh import rims
from samira_subject.head import build_template
from samira_subject.studio import portrait_camera
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head import Rig
from samira_warp.head.landmark_placement import LIP_RIMS, RIMS, Sighting, place_landmarks
from samira_warp.vision.face_shape import face_shape

OUTLINE = (10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152)
"""Of the face, on the subject's left: seen at a grazing angle or not at all, but from their own side."""


def sighting(turn, *, jaw=0.0, noise=0.0, seed=0):
    """What a faultless network would see of a head that is looked at from degrees to its left."""
    template = build_template()
    camera = portrait_camera(template, size=256)
    rig = Rig.build(template)
    parameters = rig.rest()
    parameters.rotations[rig.joint("jaw"), 0] = jaw
    vertices = rig.pose(parameters, torch.zeros(rig.n_shape)).vertices
    about = torch.eye(4)
    about[:3, :3] = axis_angle_to_matrix(torch.tensor([[0.0, -np.radians(turn), 0.0]]))[0]
    camera = dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ about)
    points = template.landmarks.points(vertices.double().numpy(), template.faces)
    transform = camera.world_to_camera.double().numpy()
    seen = points @ transform[:3, :3].T + transform[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    pixels += noise * np.random.default_rng(seed).standard_normal(pixels.shape)
    return Sighting(camera, vertices, pixels[:468], jaw > 0.0)


def placed(sightings, edges):
    shape = face_shape()
    across = shape.points[:, 0] / np.abs(shape.points[:, 0]).max()
    return place_landmarks(build_template(), sightings, across=across, mirror=shape.mirror, rims=edges)


def distances(landmarks):
    """(478,) millimetres on the mean head to where the landmarks are."""
    template = build_template()
    mean = template.v_template.astype(np.float64)
    assert landmarks.ids.tolist() == template.landmarks.ids.tolist()
    found, wanted = (at.points(mean, template.faces) for at in (landmarks, template.landmarks))
    return 1000.0 * np.linalg.norm(found - wanted, axis=1)


VIEWS = (0.0, -15.0, 15.0, -30.0, 30.0)


@pytest.fixture(scope="module")
def faultless():
    return [sighting(turn) for turn in VIEWS] + [sighting(turn, jaw=0.25) for turn in (0.0, 25.0, -25.0)]


def test_landmarks_are_found_where_they_are(faultless):
    """To a raster's pixel, half a picture's: 0.6 mm of skin that is seen squarely, 1 mm and more aslant."""
    far = distances(placed(faultless, rims(mean_anatomy())))
    inner = np.setdiff1d(np.arange(468), OUTLINE)
    assert np.median(far) < 0.4
    assert np.percentile(far[inner], 95) < 1.2
    # on edges of lids and lips the place along them is the mean of what a few pictures show
    on_rims = sorted({*sum(RIMS.values(), ())})
    assert far[on_rims].max() < 0.5
    assert far[468:].max() < 2e-3


def test_noise_averages_out():
    many = [
        sighting(turn, jaw=jaw, noise=1.0, seed=seed)
        for seed in range(3)
        for jaw in (0.0, 0.25)
        for turn in VIEWS
    ]
    # a pixel of noise is 1.1 mm along either axis, 1.3 mm in the median of a single view; some ten of the
    # thirty views show a landmark squarely, and their median is mirrored and averaged
    assert np.median(distances(placed(many, rims(mean_anatomy())))) < 0.8


def test_without_edges_open_mouths_tell_the_lips_apart(faultless):
    landmarks = placed(faultless, {})
    template = build_template()
    rig = Rig.build(template)
    parameters = rig.rest()
    parameters.rotations[rig.joint("jaw"), 0] = 0.25
    opened = rig.pose(parameters, torch.zeros(rig.n_shape)).vertices.double().numpy()
    points = 1000.0 * landmarks.points(opened, template.faces)
    upper, lower = (list(LIP_RIMS[name][2:-2]) for name in ("lip_upper", "lip_lower"))
    assert (points[upper, 1] - points[lower, 1]).min() > 3.0


def test_both_sides_mirror_each_other(faultless):
    template = build_template()
    landmarks = placed(faultless, rims(mean_anatomy()))
    points = landmarks.points(template.v_template.astype(np.float64), template.faces)[:468]
    mirrored = points[face_shape().mirror] * (-1.0, 1.0, 1.0)
    # the two diagonals of a strip's quads differ by less than its sag
    assert np.abs(points - mirrored).max() < 1e-4
