"""What a tracker found in every frame of one camera's film, in metres and radians, whatever format it was
written in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.data.frames import Listing
from samira_warp.data.still_camera import hold_camera
from samira_warp.head.flame import EYELIDS
from samira_warp.head.model import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of


class Heads(NamedTuple):
    """The tracked heads of a listing, as a template takes them."""

    shape: torch.Tensor
    """(n_shape,) float32 identity coefficients."""
    parameters: tuple[FrameParameters, ...]
    """One per frame of the listing."""
    static_offset: torch.Tensor | None
    """(V, 3) float32 metres, None where the dataset has none."""
    notes: tuple[str, ...] = ()
    """What a user should know, a sentence each."""


class Reading(NamedTuple):
    """A dataset that a format's reader has opened."""

    listing: Listing
    heads: Callable[[HeadTemplate], Heads]
    """Reads the parameters of the listing's frames for a template."""


@dataclass(frozen=True, eq=False)
class Track:
    """T frames in the order of their listing; float64.

    Attributes:
        path: Where it was read.
        shape: (S,) identity coefficients, S up to the template's.
        expression: (T, E) coefficients, E up to the template's.
        rotation: (T, 3) axis-angle of the root joint.
        neck: (T, 3) of the neck joint.
        jaw: (T, 3) of the jaw joint.
        eyes: (T, 6) of the eye joints.
        translation: (T, 3) metres.
        world_to_camera: (T, 4, 4) as tracked, OpenCV axes, metres.
        eyelids: (T, 2) weights of metrical-tracker's left and right eyelid shapes, or None.
    """

    path: Path
    shape: np.ndarray
    expression: np.ndarray
    rotation: np.ndarray
    neck: np.ndarray
    jaw: np.ndarray
    eyes: np.ndarray
    translation: np.ndarray
    world_to_camera: np.ndarray
    eyelids: np.ndarray | None = None

    def taken(self, numbers: list[int]) -> Track:
        """Some of the frames, in an order of one's own."""
        names = ("expression", "rotation", "neck", "jaw", "eyes", "translation", "world_to_camera", "eyelids")
        rows = {name: getattr(self, name)[numbers] for name in names if getattr(self, name) is not None}
        return replace(self, **rows)


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
    """Values (..., n) with zeros up to ``count``: trackers use the first so many of FLAME's shapes, which
    fall in importance.

    Raises:
        UserError: There are more values than shapes, or fewer although each shape has a name and so a meaning
            of its own.
    """
    found = values.shape[-1]
    if found > count or (found < count and template.names_expressions):
        wanted = f"{count} coefficients" if template.names_expressions else f"at most {count} coefficients"
        raise UserError(place, expected=f"{wanted}, as the head template has", found=f"{found}")
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, count - found)])


def heads_of(track: Track, template: HeadTemplate, camera: np.ndarray) -> Heads:
    """A track's heads before a camera that stands still at ``camera``, a (4, 4) world-to-camera transform.

    Raises:
        UserError: As in fitted_shape.
    """
    shape, (expression, notes) = all_of(
        lambda: fitted_shape(track, template), lambda: fitted_expression(track, template)
    )
    rotation, translation = hold_camera(
        track.rotation,
        track.translation,
        track.world_to_camera,
        camera,
        template=template,
        shape=shape,
        expression=expression,
    )
    rows = [
        torch.from_numpy(np.ascontiguousarray(part, np.float32))
        for part in (translation, rotation, track.neck, track.jaw, track.eyes)
    ]
    expressions = torch.from_numpy(np.ascontiguousarray(expression, np.float32))
    parameters = tuple(FrameParameters(*values) for values in zip(*rows, expressions, strict=True))
    return Heads(torch.from_numpy(shape.astype(np.float32)), parameters, None, notes)
