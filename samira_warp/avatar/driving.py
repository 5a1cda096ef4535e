"""Cross-identity driving: another subject's tracked pose and expression, as the avatar takes them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.head.joints import known_names
from samira_warp.support.errors import UserError

SHARED_NAMES = 0.8
"""Share of a driver's expressions that the avatar must know by name: with less, a face that speaks and blinks
is not carried over."""

OF_THE_FACE = ("jaw",)
"""Joints whose pose is a part of the face's expression, and so is taken relative to the neutral face's."""

_NUMBERED = re.compile(
    r"(exp|expr|expression|shape|blend_?shape|bs|component|coefficient|pc)?[\W_]*\d*", re.IGNORECASE
)
"""What stands for a name where a file has none: a number, perhaps after a word that fits any expression."""


class PoseRange(NamedTuple):
    """What poses an avatar was trained on.

    Beyond them its residuals and the far side of its head are guesses.

    Attributes:
        low: (J, 3) least value of each joint's axis-angle, radians.
        high: (J, 3) greatest value.
    """

    low: Tensor
    high: Tensor

    @classmethod
    def of(cls, frames: Iterable[FrameParameters]) -> PoseRange:
        """The range of some frames, at least one."""
        rotations = torch.stack([frame.rotations for frame in frames])
        return cls(rotations.amin(dim=0), rotations.amax(dim=0))

    def hold(self, parameters: FrameParameters) -> FrameParameters:
        """The parameters with each number of their pose held to the range.

        Translation and expression stay.
        """
        return replace(parameters, rotations=parameters.rotations.clamp(self.low, self.high))


class NameMap(NamedTuple):
    """Which of a driver's expressions or joints are which of the avatar's.

    Attributes:
        source: (M,) int64 indices of the driver's.
        target: (M,) int64 indices of the avatar's.
        size: How many the avatar has; those without a source stay 0.
        left_out: Names of the driver's that the avatar does not know.
    """

    source: Tensor
    target: Tensor
    size: int
    left_out: tuple[str, ...] = ()

    @classmethod
    def identity(cls, size: int) -> NameMap:
        """The map between two heads of one template."""
        return cls(torch.arange(size), torch.arange(size), size)

    def carry(self, values: Tensor, *, dim: int = -1) -> Tensor:
        """Values of the avatar's from those of the driver's along a dimension."""
        shape = list(values.shape)
        shape[dim] = self.size
        source, target = self.source.to(values.device), self.target.to(values.device)
        return values.new_zeros(shape).index_copy(dim, target, values.index_select(dim, source))


@dataclass(frozen=True, eq=False)
class Driver:
    """How a sequence's parameters drive an avatar.

    Both subjects are taken relative to their neutral faces: the driver's expression and jaw, less those of
    its neutral face, are added to the avatar's, which is its head at rest. A tracker explains a part of who
    somebody is by expression, and that part stays with the driver. Gaze and the head's own motion are the
    driver's as they are, for its camera watches them.

    Attributes:
        template: The template of the driver's parameters.
        expressions: From the driver's expressions to the avatar's.
        joints: From the driver's joints to the avatar's.
        neutral: The driver's frame with a neutral face; None where zero is.
        gain: Factor on the expression, relative to neutral.
        seen: Where the pose is held; None leaves it free.
    """

    template: HeadTemplate
    expressions: NameMap
    joints: NameMap
    neutral: FrameParameters | None = None
    gain: float = 1.0
    seen: PoseRange | None = None

    @classmethod
    def own(cls, template: HeadTemplate, *, gain: float = 1.0) -> Driver:
        """How an avatar's own frames drive it."""
        expressions = NameMap.identity(template.n_expression)
        return cls(template, expressions, NameMap.identity(len(template.joint_names)), gain=gain)

    def drive(self, parameters: FrameParameters) -> FrameParameters:
        """The driver's frames, one or a batch, as the avatar's."""
        expression, rotations = parameters.expression, parameters.rotations
        if self.neutral is not None:
            expression = expression - self.neutral.expression
            facial = [name in OF_THE_FACE for name in self.template.joint_names]
            relative = torch.tensor(facial, device=rotations.device)[:, None]
            rotations = torch.where(relative, rotations - self.neutral.rotations, rotations)
        driven = replace(
            parameters,
            expression=self.gain * self.expressions.carry(expression),
            rotations=self.joints.carry(rotations, dim=-2),
        )
        return driven if self.seen is None else self.seen.hold(driven)


def match_expressions(driver: HeadTemplate, avatar: HeadTemplate, *, source: object) -> NameMap:
    """Match the expressions of two templates.

    All of them match where the templates are one, else those of the same names.

    Args:
        driver: The template of the sequence that drives.
        avatar: The avatar's own.
        source: Where the driver's was read, for what is said about it.

    Raises:
        UserError: The templates differ, and too few of the driver's expressions have names that the avatar's
            have too.
    """
    if driver.hash == avatar.hash:
        return NameMap.identity(avatar.n_expression)
    sources, targets = _real_names(driver), _real_names(avatar)
    found = _matched(driver.expression_names, sources, targets, size=avatar.n_expression)
    shared = len(found.source)
    if shared < SHARED_NAMES * driver.n_expression or not shared:
        numbered = next(
            (words for names, words in ((sources, "its"), (targets, "the avatar's")) if not names), None
        )
        reason = f"it shares the names of {shared} of its {driver.n_expression} expressions"
        if numbered is not None:
            numbers = "expressions have numbers for names, and one number is another movement on another head"
            reason = f"{numbered} {numbers}"
        share = f"one with {SHARED_NAMES:.0%} of its expressions named as there"
        raise UserError(
            source,
            expected=f"the avatar's head template ({avatar.hash[:12]}), or {share}",
            found=f"another template ({driver.hash[:12]}), and {reason}",
        )
    return found


def match_joints(driver: HeadTemplate, avatar: HeadTemplate) -> NameMap:
    """Match the joints of two templates: the roots, which turn the whole head, and those of one name."""
    sources, targets = (
        {name: joint for joint, name in enumerate(known_names(template.joint_names))}
        for template in (driver, avatar)
    )
    return _matched(driver.joint_names, sources, targets, size=len(avatar.joint_names))


def _matched(
    names: tuple[str, ...], sources: dict[str, int], targets: dict[str, int], *, size: int
) -> NameMap:
    """The map by what a driver's and an avatar's are known by.

    Args:
        names: All names of the driver's, for those that are left out.
        sources: Index of each of the driver's by what it is known by.
        targets: The same of the avatar's.
        size: How many the avatar has.
    """
    shared = [name for name in sources if name in targets]
    known = {sources[name] for name in shared}
    return NameMap(
        source=torch.tensor([sources[name] for name in shared], dtype=torch.int64),
        target=torch.tensor([targets[name] for name in shared], dtype=torch.int64),
        size=size,
        left_out=tuple(name for index, name in enumerate(names) if index not in known),
    )


def _real_names(template: HeadTemplate) -> dict[str, int]:
    """Index of each expression whose name says what it is, and no other's."""
    count = Counter(template.expression_names)
    return {
        name: index
        for index, name in enumerate(template.expression_names)
        if count[name] == 1 and _NUMBERED.fullmatch(name.strip()) is None
    }
