"""A head in the pictures of one face, one after the other: a fit of each frame that begins at the last one.

What `samira_warp.tracker` solves for a film at once is solved here for a picture alone: the first pictures
tell the subject, every later one its own frame, from landmarks, held to what the frame before it was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.drive.face_term import FaceTerm
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.tracker.faces import landmarks_of
from samira_warp.tracker.first_pose import first_pose
from samira_warp.tracker.landmark_fit import LandmarkModel
from samira_warp.tracker.landmark_terms import pose
from samira_warp.tracker.lens import guessed_focal
from samira_warp.tracker.observed import Landmarks, View
from samira_warp.tracker.priors import REFERENCE_RATE, frame_terms, subject_term
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.terms import FramePrior, SubjectPrior, Term, minimise
from samira_warp.tracker.unknowns import Layout, Unknowns
from samira_warp.vision.faces import FaceFollower, FaceFrame, gathered
from samira_warp.vision.networks import FaceNetworks
from samira_warp.vision.openness import own_openness

OPENING = 8
"""Pictures of a face that the subject is found from, a third of a second: more of one pose tell no more."""

OPENING_STEPS, FRAME_STEPS = 20, 2
"""Steps of the two minimisations at most. A frame begins at the one before: the second step is for what
jumps, such as lids."""

KNOWN_FOCAL = 1e-3
"""Of the focal length's logarithm, one standard deviation: it is held where it is guessed. A few pictures of
one pose do not tell it, and what is taken from them is relative."""

STRIDES = {"translation": 0.02, "root": 0.1, "jaw": 0.15, "eye": 0.4, "expression": 0.4}
"""How far parameters go from one picture to the next at 25 a second, one standard deviation: metres, radians,
coefficients. Weak beside 478 landmarks, but for what these do not tell."""

TRUST = 8.0
"""Factor on the weights of the mesh's landmarks, beside those of a film's fit: what they err by alike, which
makes these low, is taken off by what they erred by in the first pictures."""

LOST = 0.5
"""Seconds without a face after which the next one begins anew."""

REMEMBERED = 250
"""Pictures that a person's open eyes are known from."""


class TrackedFace(NamedTuple):
    """One picture, tracked.

    Attributes:
        number: Of the picture, from 0.
        seconds: When it was.
        parameters: The head, float64; None where no face is seen.
        reason: Why none is, else "".
    """

    number: int
    seconds: float
    parameters: FrameParameters | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _Begun:
    """What stays once the subject is known.

    Attributes:
        model: Landmarks on the head.
        view: The camera.
        subject: (Q,) float64 as `Unknowns` has it.
        bias: (L, 3) float32 metres by which landmarks lie beside their points, in the head's axes.
    """

    model: LandmarkModel
    view: View
    subject: Tensor
    bias: Tensor

    def without_bias(self, landmarks: Landmarks, turn: Tensor, scale: float) -> Landmarks:
        """(1, L) landmarks where they would be if the first pictures' head had been met exactly.

        Args:
            landmarks: As they were read.
            turn: (3,) axis-angle of the head, roughly.
            scale: Pixels to a metre of it.
        """
        seen = self.bias @ axis_angle_to_matrix(turn).mT.float()
        points = landmarks.points.clone()
        points[:, self.model.ids] -= scale * seen[:, :2] * seen.new_tensor([1.0, -1.0])
        return replace(landmarks, points=points)


class FaceTracker:
    """Follows one face and fits a head to it, picture by picture."""

    def __init__(self, template: HeadTemplate, networks: FaceNetworks) -> None:
        """Prepare a head.

        Args:
            template: The head, with landmarks on it.
            networks: What looks at the pictures.

        Raises:
            UserError: The head has no landmarks.
        """
        if template.landmarks is None:
            raise UserError(
                "head", expected="a head with landmarks (docs/heads.md says how)", found="none on it"
            )
        vertices = len(template.v_template)
        # no offsets: what the mean head lacks is the same in all frames, and goes with the neutral one's
        head = TrackedHead.build(template, basis=np.zeros((vertices, 0)), eigenvalues=np.zeros(0))
        self.template = template
        self._model = LandmarkModel.build(head, template.landmarks)
        self._follower = FaceFollower(networks)
        self._waiting: list[tuple[int, float, FaceFrame]] = []
        self._lids: list[np.ndarray] = []
        self._begun: _Begun | None = None
        self._last: tuple[float, Tensor] | None = None
        self._number, self._size = 0, (0, 0)

    @property
    def begun(self) -> bool:
        """Whether the subject is known."""
        return self._begun is not None

    @property
    def shape(self) -> Tensor:
        """(S,) float64 identity of the subject, once it is known."""
        assert self._begun is not None
        return self._begun.subject[self._model.head.layout.identity]

    def look(self, seconds: float, picture: np.ndarray) -> list[TrackedFace]:
        """Track the next picture.

        Args:
            seconds: When it was, after the one before.
            picture: (H, W, 3) uint8, upright, all of one size.

        Returns:
            The picture; while the subject is not known none, and with the picture that makes it known all
            that waited for it.
        """
        number, self._number = self._number, self._number + 1
        frame = self._follower.look(picture)
        if frame.lids is not None:
            self._lids = [*self._lids[-REMEMBERED + 1 :], frame.lids]
        if self._begun is None:
            self._size = (picture.shape[1], picture.shape[0])
            self._waiting.append((number, seconds, frame))
            seen = sum(waiting.reading is not None for *_, waiting in self._waiting)
            return self._begin() if seen >= OPENING else []
        return [self._tracked(number, seconds, frame)]

    def close(self) -> list[TrackedFace]:
        """What still waits where the film ends before the subject is known."""
        if self._begun is not None or not self._waiting:
            return []
        return self._begin()

    def _begin(self) -> list[TrackedFace]:
        waiting, self._waiting = self._waiting, []
        seen = [frame for *_, frame in waiting if frame.reading is not None]
        if seen:
            self._begun = self._find_subject(seen)
        return [self._tracked(*one) for one in waiting]

    def _find_subject(self, seen: list[FaceFrame]) -> _Begun:
        width, height = self._size
        model, view = self._model, View(width, height, cx=width / 2, cy=height / 2)
        focal = guessed_focal(width, height)
        landmarks = self._landmarks(seen)
        start, scales = first_pose(
            model.head.layout, model.rest, self._root(), landmarks.only(model.ids), view, focal=focal
        )
        known = subject_term(model.head, focal=focal, frames=len(seen))
        weights = known.weights.clone()
        weights[-1] = KNOWN_FOCAL**-2
        terms: list[Term] = [
            *model.terms(landmarks, view, scales=scales),
            *frame_terms(model.head, rate=REFERENCE_RATE),
            SubjectPrior(known.centre, weights),
        ]
        found, _ = minimise(start, terms, steps=OPENING_STEPS)
        return _Begun(model, view, found.subject, _bias(model, landmarks, view, found, scales))

    def _root(self) -> Tensor:
        rig = self._model.head.rig
        return rig.joint_regressor[0] @ rig.v_template

    def _landmarks(self, frames: list[FaceFrame]) -> Landmarks:
        return landmarks_of(gathered(frames), own=own_openness(np.stack(self._lids)))

    def _tracked(self, number: int, seconds: float, frame: FaceFrame) -> TrackedFace:
        if frame.reading is None or self._begun is None:
            return TrackedFace(number, seconds, None, frame.reason)
        unknowns = self._fit(self._begun, seconds, self._landmarks([frame]))
        self._last = seconds, unknowns.frames[0]
        return TrackedFace(number, seconds, unknowns.parameters()[0])

    def _fit(self, begun: _Begun, seconds: float, landmarks: Landmarks) -> Unknowns:
        """A frame, from the one before or, after a while without one, from a rigid head."""
        model, layout = begun.model, begun.model.head.layout
        last = self._last
        if last is not None and seconds - last[0] > LOST:
            last = None
        focal = float(begun.subject[-1].exp())
        rigid, scales = first_pose(
            layout, model.rest, self._root(), landmarks.only(model.ids), begun.view, focal=focal
        )
        landmarks = begun.without_bias(landmarks, rigid.frames[0, layout.turn(0)], float(scales[0]))
        parts = model.terms(landmarks, begun.view, scales=scales, mesh_trust=TRUST)
        terms: list[Term] = [
            FaceTerm(model.points, begun.view, parts),
            *frame_terms(model.head, rate=None),
        ]
        if last is None:
            start, steps = replace(rigid, subject=begun.subject), OPENING_STEPS
        else:
            passed = max((seconds - last[0]) * REFERENCE_RATE, 1.0)
            strides = _strides(layout, model.head.rig.joint_names) * passed
            terms.append(FramePrior(last[1], strides.pow(-2)))
            frames = last[1][None].clone()
            frames[:, :6] = _nearer(rigid.frames[:, :6], frames[:, :6])
            start, steps = Unknowns(layout, frames, begun.subject), FRAME_STEPS
        return minimise(start, terms, steps=steps, hold_subject=True)[0]


def _nearer(rough: Tensor, last: Tensor) -> Tensor:
    """(1, 6) where a rigid head begins: where it was, or where landmarks alone have it if that is far off."""
    return rough if float((rough[0, 3:] - last[0, 3:]).norm()) > FAR else last


def _bias(model: LandmarkModel, landmarks: Landmarks, view: View, found: Unknowns, scales: Tensor) -> Tensor:
    """(L, 3) float32 metres by which landmarks lie beside their points on the head, in the head's own axes.

    The median over N pictures, across the line of sight: what a network or an embedding errs by on a face, it
    errs by in all of its pictures.
    """
    placed = pose(model.points, found, slice(None)).points
    pixels = view.project(view.in_camera(placed), found.focal)
    beside = (landmarks.points[:, model.ids] - pixels) / scales[:, None, None]
    beside = torch.cat([beside * beside.new_tensor([1.0, -1.0]), torch.zeros_like(beside[..., :1])], dim=-1)
    turns = axis_angle_to_matrix(found.frames[:, found.layout.turn(0)].float())
    return (beside @ turns).median(dim=0).values


FAR = 0.35
"""Radians by which a head that is shaken may turn from one picture to the next before the last one is no
beginning; landmarks alone err by a tenth."""


def _strides(layout: Layout, joint_names: tuple[str, ...]) -> Tensor:
    """(P,) float64 of `STRIDES`."""
    strides = torch.full((layout.frame_size,), STRIDES["expression"], dtype=torch.float64)
    strides[layout.translation] = STRIDES["translation"]
    for joint in layout.moving:
        kind = "root" if joint == 0 else "jaw" if joint_names[joint] == "jaw" else "eye"
        strides[layout.turn(joint)] = STRIDES[kind]
    return strides
