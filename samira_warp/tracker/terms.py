"""What pulls at a fit: each term says what it costs, and adds itself to the normal equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.unknowns import Unknowns


class Term(Protocol):
    """A sum of squares, or of something that grows more slowly."""

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the sum at a state."""
        ...

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the term, linearised about a state."""
        ...


FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-7, 1e4
"""Of Levenberg and Marquardt's method, as shares of the diagonal."""

SETTLED = 1e-4
"""A step that lowers the cost by less than this share ends a minimisation."""


def minimise(
    unknowns: Unknowns, terms: list[Term], *, steps: int, hold_subject: bool = False
) -> tuple[Unknowns, float]:
    """Lower the sum of terms by Levenberg and Marquardt's method; each step taken lowers it.

    Args:
        unknowns: Where to begin.
        terms: What to lower the sum of.
        steps: At most so many are tried.
        hold_subject: Move the frames alone.

    Returns:
        The state that was reached, and its cost.
    """
    damping, cost = FIRST_DAMPING, sum(term.cost(unknowns) for term in terms)
    equations = None
    for _ in range(steps):
        if equations is None:
            frames, size = unknowns.frames.shape
            equations = NormalEquations.zero(
                frames, size, len(unknowns.subject), with_subject=not hold_subject
            )
            for term in terms:
                term.add(unknowns, equations)
        tried = unknowns.moved(*equations.solve(damping=damping))
        tried_cost = sum(term.cost(tried) for term in terms)
        if tried_cost < cost:
            settled = cost - tried_cost < SETTLED * cost
            unknowns, cost, equations = tried, tried_cost, None
            damping = max(damping / 5, LEAST_DAMPING)
            if settled:
                break
        else:
            damping *= 8
            if damping > MOST_DAMPING:
                break
    return unknowns, cost


@dataclass(frozen=True, eq=False)
class FramePrior:
    """Gaussians about constants for each parameter of a frame.

    Attributes:
        centre: (P,) float64.
        weights: (N, P) or (P,) float64 inverse variances, 0 where nothing is known.
    """

    centre: Tensor
    weights: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the weighted squares."""
        return 0.5 * float((self.weights * (unknowns.frames - self.centre).square()).sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares."""
        values = unknowns.frames - self.centre
        equations.add_frame_prior(values, self.weights.expand_as(values))


@dataclass(frozen=True, eq=False)
class Range:
    """Quadratic walls at both ends of what parameters of a frame may be.

    Attributes:
        low: (P,) float64, minus infinity where there is no wall.
        high: (P,) float64.
        weights: (P,) float64 inverse variances of what is beyond.
    """

    low: Tensor
    high: Tensor
    weights: Tensor

    def _beyond(self, unknowns: Unknowns) -> Tensor:
        return unknowns.frames - unknowns.frames.clamp(self.low, self.high)

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the weighted squares of what is beyond."""
        return 0.5 * float((self.weights * self._beyond(unknowns).square()).sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the walls that are reached."""
        beyond = self._beyond(unknowns)
        equations.add_frame_prior(beyond, self.weights * (beyond != 0.0))


@dataclass(frozen=True, eq=False)
class SubjectPrior:
    """Gaussians about constants for the subject's parameters.

    Attributes:
        centre: (Q,) float64.
        weights: (Q,) float64 inverse variances.
    """

    centre: Tensor
    weights: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the weighted squares."""
        return 0.5 * float((self.weights * (unknowns.subject - self.centre).square()).sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares."""
        equations.add_subject_prior(unknowns.subject - self.centre, self.weights)


@dataclass(frozen=True, eq=False)
class Smoothness:
    """Gaussians about zero for the second differences of the frames' parameters.

    Attributes:
        weights: (P,) float64 inverse variances.
    """

    weights: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the weighted squares."""
        frames = unknowns.frames
        bends = frames[2:] - 2 * frames[1:-1] + frames[:-2]
        return 0.5 * float((self.weights * bends.square()).sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares."""
        equations.add_smoothness(unknowns.frames, self.weights)


@dataclass(frozen=True, eq=False)
class Tied:
    """Gaussians about zero for the difference of two columns of the frames' parameters.

    Attributes:
        first: (T,) columns.
        second: (T,) columns.
        weights: (T,) float64 inverse variances.
    """

    first: Tensor
    second: Tensor
    weights: Tensor

    def _apart(self, unknowns: Unknowns) -> Tensor:
        return unknowns.frames[:, self.first] - unknowns.frames[:, self.second]

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the weighted squares."""
        return 0.5 * float((self.weights * self._apart(unknowns).square()).sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares."""
        pull = self.weights * self._apart(unknowns)
        for here, there, sign in ((self.first, self.second, 1.0), (self.second, self.first, -1.0)):
            equations.frames[:, here, here] += self.weights
            equations.frames[:, here, there] -= self.weights
            equations.frames_gradient[:, here] += sign * pull
