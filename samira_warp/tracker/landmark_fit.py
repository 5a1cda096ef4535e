"""Stages (a) and (b) of the fit: landmarks to pose, focal length, identity, and every frame's expression."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.head.landmarks import LANDMARKS, MESH_LANDMARKS, LandmarkEmbedding
from samira_warp.tracker.faces import GAPS
from samira_warp.tracker.first_pose import first_pose
from samira_warp.tracker.landmark_terms import SPREAD, GapTerm, LandmarkTerm, chunks, pose
from samira_warp.tracker.observed import Landmarks, View
from samira_warp.tracker.priors import frame_terms, subject_term
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.surface_points import SurfacePoints
from samira_warp.tracker.terms import Term, minimise
from samira_warp.tracker.unknowns import Unknowns
from samira_warp.tracker.windows import in_windows

KEY_FRAMES = 96
"""Frames that the subject is found from, evenly over the film: more tell nothing new of one head."""

KEY_STEPS, FRAME_STEPS = 25, 12
"""Steps of each minimisation at most; they end when they have settled."""

GAP_SPREAD = 0.0004
"""Metres by which what is seen of a gap is wrong, one standard deviation."""

OVAL = (
    *(10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377),
    *(152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109),
)
"""The face's outline, which is no place of the skin: it slides when the head turns."""

OVAL_TRUST = 0.15
"""Of the outline's landmarks."""

IRIS_TRUST = 3.0
"""Of the irises' landmarks, which alone tell where eyes look."""


@dataclass(frozen=True, eq=False)
class LandmarkModel:
    """Landmarks on a head.

    Attributes:
        head: The head.
        points: The landmarks' points on it.
        corners: (L, 3) int64 vertex ids about them.
        barycentrics: (L, 3) float32 weights of these.
        rest: (L, 3) the points at rest, metres.
        normals: (L, 3) unit normals there.
        ids: (L,) int64 which landmarks they are.
    """

    head: TrackedHead
    points: SurfacePoints
    corners: Tensor
    barycentrics: Tensor
    rest: Tensor
    normals: Tensor
    ids: Tensor

    @classmethod
    def build(cls, head: TrackedHead, embedding: LandmarkEmbedding) -> LandmarkModel:
        """Put landmarks on a head."""
        corners = head.faces[torch.from_numpy(embedding.faces).long()]
        barycentrics = torch.from_numpy(embedding.barycentrics)
        return cls(
            head=head,
            points=head.surface_points(corners, barycentrics),
            corners=corners,
            barycentrics=barycentrics,
            rest=(barycentrics[..., None] * head.rig.v_template[corners]).sum(dim=1),
            normals=head.rest_normals(corners, barycentrics),
            ids=torch.from_numpy(embedding.ids).long(),
        )

    def terms(
        self, landmarks: Landmarks, view: View, *, scales: Tensor, mesh_trust: float = 1.0
    ) -> list[LandmarkTerm | GapTerm]:
        """What landmarks say.

        Args:
            landmarks: All `LANDMARKS` of them, in N frames.
            view: The camera.
            scales: (N,) pixels to a metre of the head.
            mesh_trust: Factor on the weights of the face mesh's landmarks, not of irises and gaps.
        """
        term = LandmarkTerm(
            self.points,
            self.normals,
            landmarks.only(self.ids),
            view,
            self._trust(mesh_trust),
            _precision(scales),
        )
        return [term, *self._gaps(term, landmarks)]

    def precision(self, landmarks: Landmarks, *, scales: Tensor) -> Tensor:
        """(N, L) inverse variances of landmarks, per square pixel."""
        return landmarks.seen[:, self.ids] * self._trust() * _precision(scales)

    def _trust(self, of_mesh: float = 1.0) -> Tensor:
        trust = torch.full((LANDMARKS,), of_mesh)
        trust[list(OVAL)] *= OVAL_TRUST
        trust[MESH_LANDMARKS:] = IRIS_TRUST
        return trust[self.ids]

    def _gaps(self, term: LandmarkTerm, landmarks: Landmarks) -> list[GapTerm]:
        """Lids and lips, as far as the head has landmarks there."""
        place_of = {int(landmark): place for place, landmark in enumerate(self.ids)}
        kept = [
            number for number, (upper, lower) in enumerate(GAPS) if upper in place_of and lower in place_of
        ]
        if not kept:
            return []
        upper, lower = (torch.tensor([place_of[GAPS[number][end]] for number in kept]) for end in (0, 1))
        gaps, trust = landmarks.gaps[:, kept], landmarks.gaps_seen[:, kept]
        return [GapTerm(term, upper, lower, gaps, trust, GAP_SPREAD)]


class Started(NamedTuple):
    """Where a fit of all frames begins.

    Attributes:
        unknowns: The subject, and a rigid pose of every frame.
        scales: (N,) pixels to a metre of the head in every frame.
    """

    unknowns: Unknowns
    scales: Tensor


def fit_subject(
    model: LandmarkModel, landmarks: Landmarks, view: View, *, focal: float, say: Callable[[str], None]
) -> Started:
    """Stage (a): poses, the focal length and the subject, from landmarks of frames all over the film.

    Args:
        model: Landmarks on a head.
        landmarks: All `LANDMARKS` of them, in N frames, at least one of them seen.
        view: The camera.
        focal: What is known of the focal length, pixels.
        say: Told of progress.
    """
    head = model.head
    root = head.rig.joint_regressor[0] @ head.rig.v_template
    start, scales = first_pose(head.layout, model.rest, root, landmarks.only(model.ids), view, focal=focal)
    keys = key_frames(landmarks, KEY_FRAMES)
    terms: list[Term] = [
        *model.terms(landmarks.rows(keys), view, scales=scales[keys]),
        *frame_terms(head, rate=None),
        subject_term(head, focal=focal, frames=len(keys)),
    ]
    at_keys, cost = minimise(replace(start, frames=start.frames[keys]), terms, steps=KEY_STEPS)
    say(
        f"head from landmarks of {len(keys)} frames: cost {cost:.4g}, focal length {at_keys.focal:.0f} pixels"
    )
    nearest = (torch.arange(len(start.frames))[:, None] - keys).abs().argmin(dim=1)
    frames = at_keys.frames[nearest]
    rigid = slice(0, 6)
    frames[:, rigid] = _rebased(start.frames[:, rigid], at_keys.frames[:, rigid], keys)
    return Started(replace(start, frames=frames, subject=at_keys.subject), scales)


def fit_frames(
    model: LandmarkModel, landmarks: Landmarks, view: View, start: Started, *, rate: float
) -> Unknowns:
    """Stage (b): every frame's parameters from landmarks, smooth in time, in windows of a long film.

    Args:
        model: Landmarks on a head.
        landmarks: All `LANDMARKS` of them, in N frames.
        view: The camera.
        start: Where to begin.
        rate: Frames a second.
    """

    def fit(rows: slice, unknowns: Unknowns) -> Unknowns:
        terms: list[Term] = [
            *model.terms(landmarks.rows(rows), view, scales=start.scales[rows]),
            *frame_terms(model.head, rate=rate),
        ]
        return minimise(unknowns, terms, steps=FRAME_STEPS, hold_subject=True)[0]

    return in_windows(start.unknowns, fit)


def key_frames(landmarks: Landmarks, count: int) -> Tensor:
    """At most so many of the frames with landmarks, evenly over the film."""
    seen = (landmarks.seen.sum(dim=1) > 0).nonzero()[:, 0]
    return seen[torch.linspace(0, len(seen) - 1, min(count, len(seen))).round().long().unique()]


def landmark_errors(model: LandmarkModel, unknowns: Unknowns, landmarks: Landmarks, view: View) -> Tensor:
    """(N, L) distances in pixels between landmarks and their points on the head; NaN where not seen."""
    parts = [pose(model.points, unknowns, rows).points for rows in chunks(len(unknowns.frames))]
    pixels = view.project(view.in_camera(torch.cat(parts)), unknowns.focal)
    errors = (pixels - landmarks.points[:, model.ids]).norm(dim=-1)
    return torch.where(landmarks.seen[:, model.ids] > 0, errors, torch.nan)


def _precision(scales: Tensor) -> Tensor:
    """(N, 1) inverse variances of a landmark, per square pixel, of (N,) pixels to a metre of the head."""
    return (scales * SPREAD).pow(-2)[:, None]


def _rebased(rough: Tensor, exact: Tensor, at: Tensor) -> Tensor:
    """(N, C) rough values, moved by what (K, C) exact ones at some places differ by, linear between."""
    every = np.arange(len(rough))
    moved = (exact - rough[at]).T.numpy()
    columns = [np.interp(every, at.numpy(), column) for column in moved]
    return rough + torch.from_numpy(np.stack(columns, axis=1))
