"""The landmarks of one picture as one term of a fit, whose points are posed once a step."""

from __future__ import annotations

from collections.abc import Sequence

from samira_warp.tracker.landmark_terms import GapTerm, LandmarkTerm, in_picture, pose
from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.observed import View
from samira_warp.tracker.surface_points import PosedPoints, SurfacePoints
from samira_warp.tracker.unknowns import Unknowns

_ALL = slice(0, 1)


class FaceTerm:
    """The sum of landmarks and gaps: a state whose cost was asked for is not posed again to be added."""

    def __init__(self, points: SurfacePoints, view: View, parts: Sequence[LandmarkTerm | GapTerm]) -> None:
        """Put terms together.

        Args:
            points: Those of all the terms.
            view: The camera.
            parts: Of one frame.
        """
        self._points, self._view, self._parts = points, view, parts
        self._last: tuple[Unknowns, PosedPoints] | None = None

    def cost(self, unknowns: Unknowns) -> float:
        """The sum of the parts' costs."""
        posed = self._posed(unknowns)
        return sum(part.cost_of(posed, unknowns, _ALL) for part in self._parts)

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add all parts."""
        posed = self._posed(unknowns)
        moves = in_picture(posed, self._view, unknowns, subject=equations.with_subject)
        for part in self._parts:
            part.add_of(posed, moves, unknowns, _ALL, equations)

    def _posed(self, unknowns: Unknowns) -> PosedPoints:
        """The points in a state, those of the last one at no cost."""
        if self._last is None or self._last[0] is not unknowns:
            self._last = unknowns, pose(self._points, unknowns, _ALL)
        return self._last[1]
