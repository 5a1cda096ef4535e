"""Cross-identity driving: another subject's tracked pose and expression, as the avatar takes them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from samira_warp.avatar.avatar import conditions_of
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.support.errors import UserError

SHARED_NAMES = 0.8
"""Share of a driver's expressions that the avatar must know by name: with less, a face that speaks and blinks
is not carried over."""

_NUMBERED = re.compile(
    r"(exp|expr|expression|shape|blend_?shape|bs|component|coefficient|pc)?[\W_]*\d*", re.IGNORECASE
)
"""What stands for a name where a file has none: a number, perhaps after a word that fits any expression."""


class PoseRange(NamedTuple):
    """What poses an avatar was trained on; beyond them its residuals and the far side of its head are
    guesses.

    Attributes:
        low: (15,) least value of rotation, neck, jaw and eyes, axis-angle radians.
        high: (15,) greatest value.
    """

    low: torch.Tensor
    high: torch.Tensor

    @classmethod
    def of(cls, parameters: Iterable[FrameParameters]) -> PoseRange:
        """The range of some frames, at least one."""
        poses = torch.stack([conditions_of(frame).pose for frame in parameters])
        return cls(poses.amin(dim=0), poses.amax(dim=0))

    def hold(self, parameters: FrameParameters) -> FrameParameters:
        """The parameters with each number of their pose held to the range; translation and expression
        stay.
        """
        pose = conditions_of(parameters).pose.clamp(self.low, self.high)
        rotation, neck, jaw, eyes = pose.split((3, 3, 3, 6))
        return replace(parameters, rotation=rotation, neck=neck, jaw=jaw, eyes=eyes)


class ExpressionMap(NamedTuple):
    """Which of a driver's expressions are which of the avatar's.

    Attributes:
        source: (M,) int64 indices of the driver's expressions.
        target: (M,) int64 indices of the avatar's.
        size: How many the avatar has; those without a source stay 0.
        left_out: Names of the driver's expressions that the avatar does not know.
    """

    source: torch.Tensor
    target: torch.Tensor
    size: int
    left_out: tuple[str, ...] = ()

    @classmethod
    def identity(cls, size: int) -> ExpressionMap:
        """The map between two heads of one template."""
        return cls(torch.arange(size), torch.arange(size), size)

    def carry(self, expression: torch.Tensor) -> torch.Tensor:
        """(E,) coefficients of the avatar from those of the driver."""
        carried = expression.new_zeros(self.size)
        carried[self.target] = expression[self.source]
        return carried


@dataclass(frozen=True, eq=False)
class Driver:
    """How a sequence's parameters drive an avatar.

    Both subjects are taken relative to their neutral faces: the driver's expression and jaw, less those of
    its neutral face, are added to the avatar's, which is its head at rest. A tracker explains a part of who
    somebody is by expression, and that part stays with the driver. Gaze and the head's own motion are the
    driver's as they are, for its camera watches them.

    Attributes:
        expressions: From the driver's template to the avatar's.
        neutral: The driver's frame with a neutral face; None where zero is.
        gain: Factor on the expression, relative to neutral.
        seen: Where the pose is held; None leaves it free.
    """

    expressions: ExpressionMap
    neutral: FrameParameters | None = None
    gain: float = 1.0
    seen: PoseRange | None = None

    def drive(self, parameters: FrameParameters) -> FrameParameters:
        """One frame of the driver as the avatar's; a static offset, which is the driver's own, is left
        out.
        """
        expression, jaw = parameters.expression, parameters.jaw
        if self.neutral is not None:
            expression, jaw = expression - self.neutral.expression, jaw - self.neutral.jaw
        driven = replace(
            parameters, expression=self.gain * self.expressions.carry(expression), jaw=jaw, static_offset=None
        )
        return driven if self.seen is None else self.seen.hold(driven)


def match_expressions(driver: HeadTemplate, avatar: HeadTemplate, *, source: object) -> ExpressionMap:
    """Match the expressions of two templates: all of them where the templates are one, else those of the same
    names.

    Args:
        driver: The template of the sequence that drives.
        avatar: The avatar's own.
        source: Where the driver's was read, for what is said about it.

    Raises:
        UserError: The templates differ, and too few of the driver's expressions have names that the avatar's
            have too.
    """
    if driver.hash == avatar.hash:
        return ExpressionMap.identity(avatar.n_expression)
    sources, targets = _real_names(driver), _real_names(avatar)
    shared = [name for name in sources if name in targets]
    if len(shared) < SHARED_NAMES * driver.n_expression or not shared:
        numbered = next(
            (words for names, words in ((sources, "its"), (targets, "the avatar's")) if not names), None
        )
        reason = f"it shares the names of {len(shared)} of its {driver.n_expression} expressions"
        if numbered is not None:
            reason = f"{numbered} expressions have numbers for names, and one number is another movement on another head"
        expected = f"the avatar's head template ({avatar.hash[:12]}), or one with {SHARED_NAMES:.0%} of its expressions named as there"
        raise UserError(
            source, expected=expected, found=f"another template ({driver.hash[:12]}), and {reason}"
        )
    return ExpressionMap(
        source=torch.tensor([sources[name] for name in shared]),
        target=torch.tensor([targets[name] for name in shared]),
        size=avatar.n_expression,
        left_out=tuple(
            name
            for index, name in enumerate(driver.expression_names)
            if sources.get(name) != index or name not in targets
        ),
    )


def _real_names(template: HeadTemplate) -> dict[str, int]:
    """Index of each expression whose name says what it is, and no other's."""
    count = Counter(template.expression_names)
    return {
        name: index
        for index, name in enumerate(template.expression_names)
        if count[name] == 1 and _NUMBERED.fullmatch(name.strip()) is None
    }
