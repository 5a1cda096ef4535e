"""What is known of heads before one is looked at: how far parameters go, and how fast."""

from __future__ import annotations

import math

import torch

from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.terms import FramePrior, Range, Smoothness, SubjectPrior, Term, Tied

TURNS = {"jaw": (0.15, 0.03, 0.02), "left_eye": (0.25, 0.3, 0.02), "right_eye": (0.25, 0.3, 0.02)}
"""Radians by which joints turn about x, y and z, one standard deviation. A jaw opens, and hardly does
anything else; eyes look up and to the sides, and do not roll."""

ANY_TURN = 0.3
"""Of a joint that has no line above; the root's is not held at all."""

JAW_SHUT = -0.02
"""Radians; a jaw closes no further."""

EXPRESSION = 0.6
"""Of an expression coefficient whose range is not known: FLAME's first ones go to 1 and beyond, most stay far
below."""

NAMED_EXPRESSION = 0.4
"""Of one with a name, which goes from 0, none, to 1, all."""

BEYOND = 0.05
"""By how much a named coefficient leaves 0 to 1, one standard deviation: muscles do not push."""

GAZE_APART = (0.02, 0.05, 0.02)
"""Radians by which one eye looks higher, more to a side, or rolls more than the other."""

BENDS = {"translation": 0.003, "root": 0.02, "jaw": 0.06, "eye": 0.15, "expression": 0.2}
"""Second differences from frame to frame at 25 frames a second, one standard deviation: metres, radians,
coefficients. Eyes jump."""

REFERENCE_RATE = 25.0
"""Frames a second at which BENDS holds; at a lower rate all of it grows in proportion."""

IDENTITY = 1.0
"""Of an identity coefficient, by how shapes are scaled."""

OFFSET = 0.004
"""Metres of the smoothest offset function that is not constant; rougher ones less, by their eigenvalues."""

FOCAL = 0.2
"""Of the focal length's logarithm, about what the film says or a phone has."""


def frame_terms(head: TrackedHead, *, rate: float | None) -> list[Term]:
    """What is known of every frame's parameters, and of how they go from frame to frame.

    Args:
        head: The head.
        rate: Frames a second, None for frames that do not follow each other.
    """
    layout = head.layout
    named = head.template.names_expressions
    spread = torch.full((layout.frame_size,), math.inf, dtype=torch.float64)
    bends = torch.full_like(spread, BENDS["translation"])
    low, high = torch.full_like(spread, -math.inf), torch.full_like(spread, math.inf)
    for joint in layout.moving:
        name, columns = head.rig.joint_names[joint], layout.turn(joint)
        if joint > 0:
            spread[columns] = torch.tensor(TURNS.get(name, (ANY_TURN,) * 3), dtype=torch.float64)
        kind = "root" if joint == 0 else "jaw" if name == "jaw" else "eye"
        bends[columns] = BENDS[kind]
        if name == "jaw":
            low[columns.start] = JAW_SHUT
    spread[layout.expression] = NAMED_EXPRESSION if named else EXPRESSION
    bends[layout.expression] = BENDS["expression"]
    if named:
        low[layout.expression], high[layout.expression] = 0.0, 1.0
    terms: list[Term] = [
        FramePrior(torch.zeros_like(spread), spread.pow(-2)),
        Range(low, high, torch.full_like(spread, BEYOND**-2)),
    ]
    if rate is not None:
        terms.append(Smoothness((bends * REFERENCE_RATE / rate).pow(-2)))
    eyes = [
        head.rig.joint_names.index(name) for name in ("left_eye", "right_eye") if name in head.rig.joint_names
    ]
    if len(eyes) == 2:
        first, second = (torch.arange(layout.frame_size)[layout.turn(eye)] for eye in eyes)
        terms.append(Tied(first, second, torch.tensor(GAZE_APART, dtype=torch.float64).pow(-2)))
    return terms


def subject_term(head: TrackedHead, *, focal: float, frames: int) -> SubjectPrior:
    """What is known of the subject, as much as of one frame for each of the film's.

    Landmarks err in the same way in every frame, so that more frames tell no more of the subject.
    """
    layout = head.layout
    spread = torch.full((layout.subject_size,), IDENTITY, dtype=torch.float64)
    by_function = OFFSET / head.roughness.clamp(min=1.0)
    spread[layout.offset] = by_function.repeat_interleave(3)
    spread[-1] = FOCAL
    centre = torch.zeros_like(spread)
    centre[-1] = math.log(focal)
    return SubjectPrior(centre, frames * spread.pow(-2))
