"""What a reader gives of a dataset: its listing, and its tracked heads for a template."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from samira_warp.data.frames import Listing
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate


@dataclass(frozen=True, eq=False)
class Tracking:
    """The tracked head of a listing, as a template takes it; float32.

    Attributes:
        shape: (n_shape,) identity coefficients.
        static_offset: (V, 3) metres, the subject's own offset from the linear shapes; None where there is
            none.
        parameters: A batch of everything that moved the head, in rows.
        rows: The row of each frame of the listing; frames of one moment may share theirs.
        notes: What a user should know, a sentence each.
    """

    shape: Tensor
    static_offset: Tensor | None
    parameters: FrameParameters
    rows: tuple[int, ...]
    notes: tuple[str, ...] = ()


class Reading(NamedTuple):
    """A dataset that a format's reader has opened."""

    listing: Listing
    tracking: Callable[[HeadTemplate], Tracking]
    """Reads the parameters of the listing's frames for a template."""
