"""Items listed by group in compressed rows: how the adjoints here gather instead of adding atomically."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Groups(NamedTuple):
    """Group g holds members[offsets[g] : offsets[g + 1]].

    Attributes:
        offsets: (G + 1,) int32, ascending from 0.
        members: (M,) int32 item ids, ascending within a group: sums over a group have one order, hence one
            result.
    """

    offsets: Tensor
    members: Tensor

    def to(self, device: torch.device | str) -> Groups:
        """The same lists on ``device``."""
        return Groups(self.offsets.to(device), self.members.to(device))


def group_by(keys: Tensor, groups: int) -> Groups:
    """List the items 0 to M - 1 by their key.

    Args:
        keys: (M,) integers from 0 to ``groups`` - 1.
        groups: G.
    """
    ordered, members = torch.sort(keys, stable=True)
    bounds = torch.arange(groups + 1, device=keys.device, dtype=ordered.dtype)
    return Groups(torch.searchsorted(ordered, bounds, out_int32=True), members.to(torch.int32))
