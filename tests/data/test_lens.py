"""Lenses of transforms.json: the formula, straightened pictures, and what is refused."""

import shutil

import numpy as np
import pytest
import torch
from data.damage import change_json

from samira_warp.data import load_pixels, open_listing
from samira_warp.data.lens import Lens, lens_of
from samira_warp.geometry.camera import Camera
from samira_warp.support.errors import UserError

CAMERA = Camera(torch.eye(4), 80.0, 76.0, 33.0, 29.0, 64, 60)
PARTS = ("transforms.json", "transforms_train.json", "transforms_test.json")
LENSES = [
    Lens(k1=-0.25), Lens(k1=0.2, k2=-0.1), Lens(p1=0.05), Lens(p2=-0.04), Lens(-0.3, 0.12, -0.01, 0.02, 0.01)
]  # fmt: skip


def bent(lens, x, y):
    """OpenCV's formula, written out for one point."""
    r2 = x**2 + y**2
    radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
    return (
        x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x**2),
        y * radial + lens.p1 * (r2 + 2 * y**2) + 2 * lens.p2 * x * y,
    )


def painted(u, v):
    """A smooth picture by place in pixels."""
    return np.stack(
        [0.5 + 0.4 * np.sin(u / 9), 0.5 + 0.4 * np.cos(v / 7), 0.5 + 0.3 * np.sin((u + v) / 11)], axis=-1
    )


@pytest.mark.parametrize("lens", LENSES)
def test_the_formula_is_opencv_s(lens):
    for x, y in ((0.0, 0.0), (0.3, -0.2), (-0.35, 0.3)):
        np.testing.assert_allclose(lens.bend(np.array([x, y])), bent(lens, x, y), atol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("scale", [1, 2])
def test_a_straightened_picture_shows_what_a_pinhole_shows(lens, scale):
    """The lens paints at the bent place what the pinhole paints at the straight one.

    The inverse of the bend is found by iteration, which is no code of the package's.
    """
    camera = CAMERA.resized(width=64 * scale, height=60 * scale)
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    goal = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
    found = goal.copy()
    for _ in range(60):  # the bend is a contraction: differences shrink by a third at least
        found += goal - np.stack(bent(lens, found[..., 0], found[..., 1]), axis=-1)
    assert np.abs(np.stack(bent(lens, found[..., 0], found[..., 1]), axis=-1) - goal).max() < 1e-9
    photographed = painted(found[..., 0] * CAMERA.fx + CAMERA.cx, found[..., 1] * CAMERA.fy + CAMERA.cy)
    straight = lens.straightened(photographed.astype(np.float32), CAMERA)
    expected = painted(u / scale, v / scale)
    # linear interpolation: an eighth of the largest second derivative, 0.4 / 49, of twice that over two
    # axes; the border repeats what the lens did not show
    inner = (slice(6 * scale, -6 * scale),) * 2
    assert np.abs(straight - expected)[inner].max() < 3e-3
    assert np.abs(photographed - expected)[inner].max() > 0.02, "the lens bends the picture"


def test_a_lens_that_bends_nothing_is_none():
    assert lens_of("here", {}, CAMERA) is None
    assert lens_of("here", {"k1": 0.0, "camera_model": "OPENCV"}, CAMERA) is None
    assert lens_of("here", {"k1": 1e-3}, CAMERA) is None  # 0.02 pixels
    assert lens_of("here", {"k1": -0.25, "k4": 0.0}, CAMERA) == Lens(k1=-0.25)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.01}, "pinhole"),
        ({"is_fisheye": True}, "pinhole"),
        ({"k1": -0.1, "k4": 0.2}, "found k4"),
        ({"k1": "-0.1"}, "k1 to be a finite number"),
        ({"k1": float("nan")}, "k1 to be a finite number"),
        ({"k1": -4.0}, "folds"),
        ({"camera_model": "EQUIRECTANGULAR", "k1": 0.1}, "pinhole"),
    ],
)
def test_other_lenses_are_refused_by_name(values, message):
    with pytest.raises(UserError, match=f"here: .*{message}"):
        lens_of("here", values, CAMERA)


@pytest.fixture
def bent_dataset(tiny_dataset, tmp_path):
    """The tiny dataset with pictures, masks and albedo as a lens shows them."""
    root, lens = shutil.copytree(tiny_dataset, tmp_path / "subject"), Lens(k1=-0.6, p1=0.01)

    def change(document):
        for entry in document["frames"]:
            entry.update(k1=lens.k1, p1=lens.p1)

    for name in PARTS:
        change_json(root / name, change)
    return root, lens


def test_frames_are_made_straight_as_they_are_read(bent_dataset, tiny_dataset):
    root, lens = bent_dataset
    listing = open_listing(root)
    frame, size = listing.frames[0], {"width": 32, "height": 32}
    assert (frame.lens.k1, frame.lens.p1) == (lens.k1, lens.p1)
    assert any("distorted by their lens" in note for note in listing.notes)
    pixels, plain = load_pixels(frame, **size), load_pixels(open_listing(tiny_dataset).frames[0], **size)
    for name in ("image", "mask", "albedo"):
        expected = lens.straightened(getattr(plain, name).numpy(), frame.camera)
        np.testing.assert_allclose(
            getattr(pixels, name).numpy(), expected, atol=2e-2
        )  # white before or after
        assert np.abs(expected - getattr(plain, name).numpy()).max() >= 0.04
