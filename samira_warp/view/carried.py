"""How the parameters of one avatar's head move another one's."""

from __future__ import annotations

from dataclasses import dataclass, replace

from samira_warp.avatar import Avatar, Driver, match_expressions, match_joints
from samira_warp.head import FrameParameters


@dataclass(frozen=True, eq=False)
class Carrier:
    """From the first avatar's head to the second's, by the names of expressions and joints.

    Attributes:
        driver: What carries them over.
        same_template: Whether offsets of single vertices mean the same on both.
    """

    driver: Driver
    same_template: bool

    @classmethod
    def between(cls, first: Avatar, second: Avatar, *, source: object) -> Carrier:
        """The carrier between two avatars.

        Raises:
            UserError: Too few of the expressions are in both; ``source`` is what the second is called.
        """
        one, other = first.canonical.template, second.canonical.template
        expressions = match_expressions(one, other, source=source)
        return cls(Driver(one, expressions, match_joints(one, other)), one.hash == other.hash)

    def carry(self, parameters: FrameParameters) -> FrameParameters:
        """The second head's parameters."""
        if not self.same_template:
            parameters = replace(parameters, dynamic_offset=None)
        return self.driver.drive(parameters)
