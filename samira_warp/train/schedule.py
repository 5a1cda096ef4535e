"""What follows from a run's length: rates, and when the parts of training begin and end."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple


@dataclass(frozen=True)
class Rate:
    """A learning rate in a long run and in a short one, each from its start to its end, along a cosine."""

    long: tuple[float, float]
    short: tuple[float, float]


SHORT_RUN = 10_000
"""Steps; below it the short rates hold: Adam at 2e-4 moves a value by 0.3 at most in 3,000 steps."""

LONG_RUN = 30_000
"""Steps; from here on the paper's rates hold; between the two they are log-interpolated."""

LIGHT_FRAMES = 4
"""Frames that the light learns from at a time (`train.shared_light`): it is filtered once for all of them."""

WARM_UP = 0.02
"""Share of the run over which every rate rises from zero."""


def constant(value: float) -> Rate:
    """The same rate throughout, in every run."""
    return Rate((value, value), (value, value))


RATES = {
    "means": Rate((5e-3, 5e-5), (5e-3, 5e-5)),
    "log_scales": constant(0.017),
    "quaternions": constant(1e-3),
    "opacity_logits": constant(0.05),
    "albedo_logits": constant(5e-3),
    "roughness_logits": constant(5e-3),
    "specular_logits": constant(5e-3),
    "normals": constant(1e-3),
    "response": constant(1e-3),
    "network": Rate((1e-4, 1e-5), (2e-3, 1e-4)),
    "light": Rate((2e-4, 2e-5), (6e-2, 6e-3)),
    "expression": Rate((1e-2, 1e-2), (1e-4, 1e-4)),
    "pose": Rate((1e-4, 1e-4), (3e-4, 3e-4)),
    "translation": Rate((1e-5, 1e-5), (5e-5, 5e-5)),
}
"""By parameter group: GaussianAvatars' for geometry and tracking, HRAvatar's for materials, the paper's for
network and light.

GaussianAvatars' rates of tracking are for an Adam that moves all frames at every step, ten times as far as
the rate says; rows rest here while their frame is not shown, and their rates are ten times as high.

In short runs the light moves fast enough to become a lamp: softplus is linear where light is bright, a lamp
of ten degrees has a radiance of tens, and at a sixth of the rate a thousand steps ended before one was found,
so that its shadows were painted into normals and albedo (docs/relighting.md).

In short runs, rigid tracking moves faster, so that its noise is out of the way before the network learns, and
expressions move slower, so that what repeats with an expression is left to the network instead of being tuned
away frame by frame (docs/measurements.md).
"""


def learning_rate(group: str, *, step: int, steps: int) -> float:
    """The rate of a parameter group at one step: warm-up, then a cosine from the rate's start to its end."""
    rate = RATES[group]
    share = min(max(math.log(steps / SHORT_RUN) / math.log(LONG_RUN / SHORT_RUN), 0.0), 1.0)
    first, last = (
        short ** (1.0 - share) * long**share for short, long in zip(rate.short, rate.long, strict=True)
    )
    warm_up = max(WARM_UP * steps, 1.0)
    cosine = 0.5 * (1.0 + math.cos(math.pi * min(step / steps, 1.0)))
    return min((step + 1) / warm_up, 1.0) * (last + (first - last) * cosine)


class Earlier(NamedTuple):
    """A length that a run was to have before it was extended.

    Attributes:
        steps: The length.
        until: The step that was reached when it was extended.
    """

    steps: int
    until: int


@dataclass(frozen=True)
class Schedule:
    """Events of a run, as shares of its steps.

    An extended run follows the shares of its new length from the step that it had reached: rates rise to what
    they would be there, and density control goes on if its window is still open. What had begun stays on.
    """

    steps: int
    """Length of the run."""
    earlier: tuple[Earlier, ...] = ()
    """The lengths that it was to have before, in order."""
    stage_two: float = 0.3
    """Canonical normals and response factors are frozen before this share of the run."""
    perceptual: float = 0.5
    """LPIPS is on from here, where its weights are to be had."""
    density: tuple[float, float] = (0.1, 0.6)
    """The window of density control."""
    density_every: float = 0.025
    """Share of the run between density control events."""
    density_pause: float = 0.05
    """No event for this share after stage two begins: normals and responses settle first."""
    settling: float = 0.75
    """At this share of the run what no picture saw is guessed (`train.unseen`): no Gaussian is added any
    more, and what is left of the run fits the outlines."""
    opacity_reset_from: int = 20_000
    """Opacity is reset only in runs longer than this many steps; a shorter run never recovers."""
    opacity_reset_every: int = 3_000
    """Steps between opacity resets (3DGS)."""

    def extended(self, steps: int, *, at: int) -> Schedule:
        """The schedule of the same run when it is to be ``steps`` long, from the step that it has reached."""
        before = self.earlier[-1].until if self.earlier else 0
        if at == before:  # not a step was done under the present length
            return replace(self, steps=steps)
        return replace(self, steps=steps, earlier=(*self.earlier, Earlier(self.steps, at)))

    def extended_at(self, step: int) -> bool:
        """Whether the run had done this many steps when it was extended."""
        return any(step == length.until for length in self.earlier)

    def in_stage_two(self, step: int) -> bool:
        """Whether normals and response factors learn at this step."""
        return step >= self._begin(self.stage_two)

    def perceptual_on(self, step: int) -> bool:
        """Whether LPIPS is part of the loss at this step."""
        return step >= self._begin(self.perceptual)

    def density_window(self, step: int) -> bool:
        """Whether density statistics are gathered at this step."""
        return self.density[0] * self.steps <= step < self.density[1] * self.steps

    def density_event(self, step: int) -> bool:
        """Whether Gaussians are added and removed after this step."""
        every = max(round(self.density_every * self.steps), 1)
        paused = 0 <= step - self._begin(self.stage_two) < self.density_pause * self.steps
        return self.density_window(step) and (step + 1) % every == 0 and not paused

    def density_ends(self, step: int) -> bool:
        """Whether this is the last step of the density window."""
        return self.density_window(step) and not self.density_window(step + 1)

    def settles(self, step: int) -> bool:
        """Whether what no picture saw is guessed before this step."""
        return step == round(self.settling * self.steps)

    def opacity_reset(self, step: int) -> bool:
        """Whether opacities are reset after this step."""
        return (
            self.steps > self.opacity_reset_from
            and self.density_window(step)
            and (step + 1) % self.opacity_reset_every == 0
        )

    def _begin(self, share: float) -> float:
        """The step at which what begins at a share of the run did or will begin, by its length then."""
        reached = 0
        for length in self.earlier:
            if share * length.steps <= length.until - 1:
                return max(share * length.steps, reached)
            reached = length.until
        return max(share * self.steps, reached)
