"""The usual mistakes, known by what they do to a tracked head before its camera.

One mistake has many consequences (a head behind the camera is upside down and covers nothing as well), so
that each kind of symptom is looked for only where those before it are absent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch

from samira_warp.check.findings import OTHER_FLAME, Finding
from samira_warp.check.matte_symptoms import matte_symptoms
from samira_warp.check.views import View, project
from samira_warp.data import TrackedSequence
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.head import HeadTemplate
from samira_warp.support.constants import NEAR_PLANE

EYES_APART = 0.063
"""Metres between the eyes of an adult; a child of four has 0.05."""

_LEAST_FOCAL, _MOST_FOCAL = 0.2, 40.0
"""Focal lengths in the longer side of the picture: fields of view of 136 and 1.4 degrees."""

_LEAST_HEIGHT, _MOST_HEIGHT = 0.15, 1.8
"""Heights of a head in the picture's that a person may have framed it by."""

_STRETCHED, _MOST_STRETCHED = 3.0, 0.1
"""A mesh whose edges are this many times longer or shorter than the template's, in this share of them, is
torn: no identity does that."""


def symptoms_of(sequence: TrackedSequence, views: list[View]) -> list[Finding]:
    """What is wrong with where the heads are, and how large.

    Args:
        sequence: The dataset.
        views: Some of its frames.
    """
    if not views:
        return []
    kinds: tuple[Callable[[TrackedSequence, list[View]], Iterator[Finding]], ...] = (
        _intrinsics,
        _mesh,
        _place,
        matte_symptoms,
        _framing,
    )
    for kind in kinds:
        found = list(kind(sequence, views))
        if found:
            return found
    return []


def cameras_of(sequence: TrackedSequence) -> str:
    """Where the poses of the cameras are written."""
    if (sequence.root / CANONICAL_FILE).is_file():
        return str(sequence.root / "transforms_*.json")
    return str(sequence.frames[0].parameters_path)


def _intrinsics(sequence: TrackedSequence, views: list[View]) -> Iterator[Finding]:
    """Shares of the picture's size where pixels are expected, and the other way round."""
    del views
    cameras = {
        (f.camera.fx, f.camera.fy, f.camera.cx, f.camera.cy, f.camera.width, f.camera.height)
        for f in sequence.frames
    }
    for fx, fy, cx, cy, width, height in sorted(cameras):
        low, high, side = min(fx, fy), max(fx, fy), max(width, height)
        size = f"a picture of {width} x {height}"
        if low < _LEAST_FOCAL * side:
            found = f"{low:.4g} and a centre of ({cx:.4g}, {cy:.4g}) for {size}"
            remedy = "it looks like a share of the picture's size: write focal length and centre in pixels"
        elif high > _MOST_FOCAL * side:
            found = f"{high:.4g} for {size}"
            remedy = (
                "it looks like pixels where a share of the picture's size belongs: divide it by the width"
            )
        elif 0 < max(cx, cy) <= 1 and min(width, height) > 2:
            found = f"a centre of ({cx:.4g}, {cy:.4g}) for {size}"
            remedy = "it looks like a share of the picture's size: write it in pixels"
        else:
            continue
        yield Finding(
            "fault",
            f"{cameras_of(sequence)}: intrinsics",
            "a focal length and a centre in pixels",
            found,
            remedy,
        )
        return


def _mesh(sequence: TrackedSequence, views: list[View]) -> Iterator[Finding]:
    """A head in another unit than metres, inside out, or torn by parameters of another template."""
    del views
    template = sequence.template
    mean = torch.from_numpy(template.v_template).double()
    head = (
        mean
        + torch.from_numpy(template.shapedirs[..., : template.n_shape]).double() @ sequence.shape.double()
    )
    if sequence.static_offset is not None:
        head = head + sequence.static_offset.double()
    in_template, tracked = (_eyes_apart(template, points) for points in (mean, head))
    for place, apart in (
        (sequence.template_path, in_template),
        (sequence.frames[0].parameters_path, tracked),
    ):
        factor = apart / EYES_APART
        if apart > 0 and not 0.5 <= factor <= 2.0:
            size = f"{factor:.3g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
            remedy = f"divide lengths by {factor:.3g}" if place == sequence.template_path else OTHER_FLAME
            yield Finding(
                "fault",
                str(place),
                f"a head in metres, with eyes {EYES_APART} apart",
                f"{apart:.3g}: {size}",
                remedy,
            )
            return
    faces = torch.from_numpy(template.faces).long()
    if _volume(mean, faces) < 0.0:
        yield Finding(
            "fault",
            str(sequence.template_path),
            "faces whose corners run counter-clockwise where they are seen from outside",
            "a head that is inside out: its normals point inwards, and it would lie in its own shadow",
            "swap two corners of every face, in f and ft alike",
        )
        return
    before, after = ((points[faces] - points[faces.roll(1, 1)]).norm(dim=-1) for points in (mean, head))
    stretch = (after / before.clamp(min=1e-9)).flatten()
    torn = ((stretch > _STRETCHED) | (stretch < 1 / _STRETCHED)).double().mean()
    if torn > _MOST_STRETCHED:
        share = f"{torn:.0%} of its edges are over {_STRETCHED:.0f} times"
        found = f"one torn: {share} as long or short as the template's"
        yield Finding(
            "fault",
            str(sequence.frames[0].parameters_path),
            "the head model's own identity and offsets",
            found,
            OTHER_FLAME,
        )


def _volume(points: torch.Tensor, faces: torch.Tensor) -> float:
    """Signed volume between (V, 3) vertices' centre and (F, 3) faces, positive where these look outwards.

    A hole, as the neck's, leaves out the cone above it.
    """
    corners = (points - points[faces.unique()].mean(dim=0))[faces]
    return float(torch.linalg.det(corners).sum()) / 6


def _eyes_apart(template: HeadTemplate, points: torch.Tensor) -> float:
    """Metres between the eye joints of (V, 3) float64 vertices; 0 where a template has none."""
    if not {"left_eye", "right_eye"} <= set(template.joint_names):
        return 0.0
    eyes = [template.joint_names.index(name) for name in ("left_eye", "right_eye")]
    left, right = torch.from_numpy(template.joint_regressor[eyes]).double() @ points
    return float((left - right).norm())


def _place(sequence: TrackedSequence, views: list[View]) -> Iterator[Finding]:
    """Heads behind their camera, upside down, or outside of the picture."""
    behind = [view for view in views if np.median(view.points[:, 2]) <= NEAR_PLANE]
    if 2 * len(behind) >= len(views):
        yield Finding(
            "fault",
            f"{cameras_of(sequence)}: poses",
            "the head before the camera",
            f"it behind in {_share(behind, views)}",
            _turn(behind),
        )
        return
    before = [view for view in views if np.median(view.points[:, 2]) > NEAR_PLANE]
    turned = [view for view in before if view.up[1] > 0.5]
    if 2 * len(turned) >= len(before):
        remedy = (
            "negate the x and y axes of the camera, "
            "or turn the pictures by 180 degrees as they were when they were tracked"
        )
        yield Finding(
            "fault",
            f"{cameras_of(sequence)}: poses",
            "the head upright",
            f"it upside down in {_share(turned, views)}",
            remedy,
        )
        return
    outside = [view for view in before if not _inside(view.pixels, view).any()]
    if 2 * len(outside) >= len(before):
        found = f"it outside in {_share(outside, views)}"
        remedy = (
            "look whether the pictures were cropped after they were tracked, "
            "and whether centre and focal length are the camera's"
        )
        yield Finding("fault", cameras_of(sequence), "the head in the picture", found, remedy)


def _turn(views: list[View]) -> str:
    """What brings heads that are behind the camera before it, upright and into the picture."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])

    def mended(view: View, mend: Callable[[np.ndarray], np.ndarray]) -> bool:
        pose = view.frame.camera.world_to_camera.double().numpy()
        change = mend(pose) @ np.linalg.inv(pose)
        points = view.points @ change[:3, :3].T + change[:3, 3]
        return bool(
            np.median(points[:, 2]) > 0
            and (change[:3, :3] @ view.up)[1] < 0
            and _inside(project(points, view.frame), view).any()
        )

    another_convention = (
        "the camera's y and z axes are those of another convention (OpenCV's for OpenGL's): "
        "negate columns two and three of each matrix"
    )
    mends: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        another_convention: lambda pose: flip @ pose,
        "the matrices are inverted (world to camera for camera to world): write their inverses": (
            lambda pose: flip @ np.linalg.inv(pose) @ flip
        ),
    }
    for remedy, mend in mends.items():
        if all(mended(view, mend) for view in views):
            return remedy
    return (
        "the camera looks the other way: negate the x and z axes of each matrix, "
        "or the sign of the translation"
    )


def _framing(sequence: TrackedSequence, views: list[View]) -> Iterator[Finding]:
    """Heads much larger or smaller than pictures are framed by: all that is to be seen without mattes."""
    heights = np.array(
        [
            np.ptp(view.pixels[:, 1]) / view.frame.camera.height
            for view in views
            if view.points[:, 2].min() > NEAR_PLANE
        ]
    )
    typical = float(np.median(heights)) if len(heights) else _MOST_HEIGHT
    if _LEAST_HEIGHT <= typical <= _MOST_HEIGHT:
        return
    remedy = (
        "look at the contact sheet: the camera's distance may be in another unit than metres "
        "(IMavatar's and HRAvatar's first are 4)"
    )
    yield Finding(
        "warning",
        cameras_of(sequence),
        "a head about as high as the picture",
        f"{typical:.3g} times its height",
        remedy,
    )


def _inside(pixels: np.ndarray, view: View) -> np.ndarray:
    """(V,) which pixels are in the view's picture."""
    size = [view.frame.camera.width, view.frame.camera.height]
    return np.all((pixels >= 0) & (pixels < size), axis=1)


def _share(some: list[View], views: list[View]) -> str:
    return f"{len(some)} of {len(views)} frames looked at, such as {some[0].frame.name}"
