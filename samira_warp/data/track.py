"""What a tracker found in every frame of one camera's film, whatever format it was written in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.joints import rotations_on
from samira_warp.data.still_camera import hold_camera
from samira_warp.data.tracking import Tracking
from samira_warp.head.flame import EYELIDS
from samira_warp.head.joints import ROOT
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of


@dataclass(frozen=True, eq=False)
class Track:
    """T frames in the order of their listing; float64, metres and radians.

    Attributes:
        path: Where it was read.
        shape: (S,) identity coefficients, S up to the template's.
        expression: (T, E) coefficients, E up to the template's.
        poses: (T, 3) axis-angle of each tracked joint by its name; `ROOT` turns the whole head.
        translation: (T, 3) metres.
        world_to_camera: (T, 4, 4) as tracked, OpenCV axes, metres.
        eyelids: (T, 2) weights of metrical-tracker's left and right eyelid shapes, or None.
    """

    path: Path
    shape: np.ndarray
    expression: np.ndarray
    poses: dict[str, np.ndarray]
    translation: np.ndarray
    world_to_camera: np.ndarray
    eyelids: np.ndarray | None = None

    def taken(self, numbers: list[int]) -> Track:
        """Some of the frames, in an order of one's own."""
        return replace(
            self,
            expression=self.expression[numbers],
            poses={name: pose[numbers] for name, pose in self.poses.items()},
            translation=self.translation[numbers],
            world_to_camera=self.world_to_camera[numbers],
            eyelids=None if self.eyelids is None else self.eyelids[numbers],
        )


def fitted_shape(track: Track, template: HeadTemplate) -> np.ndarray:
    """(n_shape,) identity coefficients.

    Raises:
        UserError: The track has more than the template, or fewer than one whose shapes have names.
    """
    return pad_coefficients(f"{track.path}: identity", track.shape, template.n_shape, template)


def fitted_expression(track: Track, template: HeadTemplate) -> tuple[np.ndarray, tuple[str, ...]]:
    """(T, n_expression) coefficients, the eyelids among them, and what had to be left out.

    Raises:
        UserError: As in fitted_shape.
    """
    place = f"{track.path}: expression"
    if template.expression_names[-2:] != EYELIDS:
        left_out = track.eyelids is not None and bool(np.any(track.eyelids))
        note = "the tracked eyelids are left out: l_eyelid.npy and r_eyelid.npy are not beside the FLAME file"
        return pad_coefficients(place, track.expression, template.n_expression, template), (
            note,
        ) if left_out else ()
    lids = np.zeros((len(track.expression), 2)) if track.eyelids is None else track.eyelids
    return np.concatenate(
        [pad_coefficients(place, track.expression, template.n_expression - 2, template), lids], axis=1
    ), ()


def pad_coefficients(place: object, values: np.ndarray, count: int, template: HeadTemplate) -> np.ndarray:
    """Values (..., n) with zeros up to ``count``.

    Trackers use the first so many of FLAME's shapes, which fall in importance.

    Raises:
        UserError: There are more values than shapes, or fewer although each shape has a name and so a meaning
            of its own.
    """
    found = values.shape[-1]
    if found > count or (found < count and template.names_expressions):
        wanted = f"{count} coefficients" if template.names_expressions else f"at most {count} coefficients"
        raise UserError(place, expected=f"{wanted}, as the head template has", found=f"{found}")
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, count - found)])


def tracking_of(track: Track, template: HeadTemplate, camera: np.ndarray) -> Tracking:
    """A track's heads before a camera that stands still at ``camera``, a (4, 4) world-to-camera transform.

    Raises:
        UserError: As in fitted_shape and rotations_on.
    """
    shape, (expression, notes), rotations = all_of(
        lambda: fitted_shape(track, template),
        lambda: fitted_expression(track, template),
        lambda: rotations_on(template, track.poses, place=track.path),
    )
    rotations[:, 0], translation = hold_camera(
        track.poses[ROOT],
        track.translation,
        track.world_to_camera,
        camera,
        template=template,
        shape=shape,
        expression=expression,
    )

    def tensor(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, np.float32))

    return Tracking(
        shape=tensor(shape),
        static_offset=None,
        parameters=FrameParameters(tensor(translation), tensor(rotations), tensor(expression)),
        rows=tuple(range(len(expression))),
        notes=notes,
    )
