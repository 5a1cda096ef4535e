"""A head tracked through a film: from landmarks to pixels, stage by stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.tracker.film import Film
from samira_warp.tracker.kept import Kept
from samira_warp.tracker.kept_basis import kept_basis
from samira_warp.tracker.landmark_fit import (
    LandmarkModel,
    Started,
    fit_frames,
    fit_subject,
    key_frames,
    landmark_errors,
)
from samira_warp.tracker.observed import Landmarks
from samira_warp.tracker.pixel_fit import SIDE, fit_pixels, know, observe
from samira_warp.tracker.priors import frame_terms
from samira_warp.tracker.render_fit import KeyFrames, Rendered, refine_by_rendering
from samira_warp.tracker.samples import Samples
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.terms import Term
from samira_warp.tracker.unknowns import Unknowns

FUNCTIONS = 60
"""Smooth functions of the offset: waves of some 3 cm on the face."""

MESH_TRUST = 0.5
"""Of the face mesh's landmarks beside colours and outlines, which err less, and not with the head's turn."""

RENDERED_FRAMES = 48
"""Frames that the subject is refined from by rendering, evenly over the film."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """A head in N frames.

    Attributes:
        parameters: Of the frames, float32.
        shape: (S,) float32 identity.
        static_offset: (V, 3) float32 metres.
        focal: Focal length, pixels.
        albedo: (V, 3) float32 linear; its scale is not known (see `light`).
        light: (9, 3) float32 spherical harmonics of radiance, in the world.
        errors: (N, L) float32 pixels between landmarks and the mesh, NaN where there is none.
        by_landmarks: (N, L) the same after stage (b).
    """

    parameters: FrameParameters
    shape: Tensor
    static_offset: Tensor
    focal: float
    albedo: Tensor
    light: Tensor
    errors: Tensor
    by_landmarks: Tensor


def track(
    template: HeadTemplate, film: Film, landmarks: Landmarks, *, kept: Kept, say: Callable[[str], None]
) -> Tracking:
    """Track a head.

    Args:
        template: The head model, with landmarks on it.
        film: N frames.
        landmarks: All 478 landmarks in the N frames, at least one of them seen.
        kept: Where parts of this fit are kept when they are done, and were.
        say: Told of progress, a line for each stage.

    Raises:
        UserError: The head has no landmarks, or a picture cannot be read.
        OSError: A part cannot be kept.
    """
    if template.landmarks is None:
        raise UserError("head", expected="a head with landmarks (docs/heads.md says how)", found="none on it")
    basis = kept_basis(template, FUNCTIONS + 1)
    head = TrackedHead.build(
        template, basis=basis.vectors[:, 1:], eigenvalues=basis.eigenvalues[1:] / basis.eigenvalues[1]
    )
    fit = _Fit(LandmarkModel.build(head, template.landmarks), film, landmarks, say)
    seen = kept("landmarks", fit.by_landmarks)
    drawn = kept("rendering", lambda: fit.by_rendering(**seen))
    at_landmarks = Unknowns(head.layout, seen["frames"], seen["subject"])
    unknowns = fit.by_pixels(Unknowns(head.layout, drawn["frames"], drawn["subject"]), seen["scales"])
    errors = fit.errors(unknowns)
    say(
        f"{len(unknowns.frames)} frames from pixels: {float(errors.nanmedian()):.2f} pixels off the landmarks"
    )
    return Tracking(
        parameters=unknowns.parameters().to(dtype=torch.float32),
        shape=unknowns.shape.float(),
        static_offset=head.basis @ unknowns.offset.float(),
        focal=unknowns.focal,
        albedo=drawn["albedo"],
        light=drawn["light"],
        errors=errors,
        by_landmarks=fit.errors(at_landmarks),
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """The stages, each of which says in tensors what it found."""

    model: LandmarkModel
    film: Film
    landmarks: Landmarks
    say: Callable[[str], None]

    def by_landmarks(self) -> dict[str, Tensor]:
        """Stages (a) and (b): frames (N, P), subject (Q,), and scales (N,) in pixels to a metre."""
        film = self.film
        started = fit_subject(self.model, self.landmarks, film.view, focal=film.focal, say=self.say)
        unknowns = fit_frames(self.model, self.landmarks, film.view, started, rate=film.rate)
        off = float(self.errors(unknowns).nanmedian())
        self.say(f"{len(unknowns.frames)} frames from landmarks: {off:.2f} pixels off")
        return {"frames": unknowns.frames, "subject": unknowns.subject, "scales": started.scales}

    def by_rendering(self, frames: Tensor, subject: Tensor, scales: Tensor) -> dict[str, Tensor]:
        """Stage (c): subject, albedo (V, 3) and light (9, 3) by rendering; frames by landmarks again."""
        unknowns = Unknowns(self.model.head.layout, frames, subject)
        rendered = _refine_subject(
            self.model, unknowns, self._keys(), self.film, self.landmarks, scales, say=self.say
        )
        moved = replace(unknowns, subject=rendered.unknowns.subject)
        found = fit_frames(
            self.model, self.landmarks, self.film.view, Started(moved, scales), rate=self.film.rate
        )
        return {
            "frames": found.frames,
            "subject": found.subject,
            "albedo": rendered.albedo,
            "light": rendered.light,
        }

    def by_pixels(self, unknowns: Unknowns, scales: Tensor) -> Unknowns:
        """Stage (c) of the frames."""

        def terms(rows: slice) -> list[Term]:
            of_landmarks = self.model.terms(
                self.landmarks.rows(rows), self.film.view, scales=scales[rows], mesh_trust=MESH_TRUST
            )
            return [*of_landmarks, *frame_terms(self.model.head, rate=self.film.rate)]

        return fit_pixels(self.model.head, unknowns, self.film, self._keys(), terms, say=self.say)

    def errors(self, unknowns: Unknowns) -> Tensor:
        """(N, L) pixels."""
        return landmark_errors(self.model, unknowns, self.landmarks, self.film.view)

    def _keys(self) -> Tensor:
        return key_frames(self.landmarks, RENDERED_FRAMES)


def _refine_subject(
    model: LandmarkModel,
    unknowns: Unknowns,
    keys: Tensor,
    film: Film,
    landmarks: Landmarks,
    scales: Tensor,
    *,
    say: Callable[[str], None],
) -> Rendered:
    """Stage (c) of the subject: by rendering key frames."""
    pictures, mattes = film.load(keys, SIDE)
    at_keys = unknowns.chosen(keys)
    vertices = Samples.at_vertices(model.head)
    known = know(observe(model.head, vertices, at_keys, pictures, mattes, film.view))
    frames = KeyFrames(
        pictures,
        mattes,
        landmarks.points[keys][:, model.ids],
        model.precision(landmarks.rows(keys), scales=scales[keys]),
    )
    start = Rendered(at_keys, known.appearance.albedo, known.appearance.light)
    return refine_by_rendering(model, start, frames, film.view, say=say)
