"""Which directions the head blocks in training frames: traced once, and again where the mesh has moved."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.avatar.occlusion import Occluder, Occlusion
from samira_warp.head import FrameParameters, PosedHead
from samira_warp.train.tracking import TrackedParameters

STALE = 0.001
"""Metres that a vertex may go in the head's axes before its frame is traced again. Fine-tuning moves vertices
by a tenth of that; at two centimetres, a nose's height, it turns the edge of a shadow by three degrees, a
third of the sky's step."""

KEPT_BYTES = 1 << 29
"""Of what was traced; beyond it the frame that was not shown for longest is dropped, and traced again from
the same parameters when it is shown."""

_TRACED_WITH = ("translation", "rotations", "expression")
"""Parameters of a frame that pose its mesh."""


class FrameOcclusions:
    """What the head blocks in T training frames.

    What a frame's bits are depends on the parameters that it was traced with, which a checkpoint keeps: a run
    that goes on has the same ones.

    Attributes:
        traced: (T,) bool, whether the frame was traced.
        translation: (T, 3) the parameters that it was traced with.
        rotations: (T, J, 3) likewise.
        expression: (T, E) likewise.
    """

    def __init__(self, canonical: CanonicalHead, occluder: Occluder, tracked: TrackedParameters) -> None:
        self._canonical, self._occluder = canonical, occluder
        self._kept: OrderedDict[int, Occlusion] = OrderedDict()
        self.traced = torch.zeros(len(tracked.translation), dtype=torch.bool)
        self.translation, self.rotations, self.expression = (
            values.detach().clone() for values in (tracked.translation, tracked.rotations, tracked.expression)
        )

    @torch.no_grad()
    def of(self, row: int, parameters: FrameParameters, head: PosedHead) -> Occlusion:
        """What blocks in frame ``row``, whose parameters pose ``head``; traced if it has to be."""
        occlusion = self._at(row, parameters) if self.traced[row] else None
        if occlusion is None or bool(
            (head.in_head_frame() - occlusion.points).square().sum(dim=-1).max() > STALE**2
        ):
            self.traced[row] = True
            for name in _TRACED_WITH:
                getattr(self, name)[row] = getattr(parameters, name)
            occlusion = self._keep(row, self._occluder.occlude(head))
        return occlusion.under(head)

    def told(self, row: int) -> Tensor:
        """(P,) float32: which frame, whether it was traced, and its parameters then, for another process."""
        parts = [getattr(self, name)[row].flatten() for name in _TRACED_WITH]
        head = parts[0].new_tensor([row, bool(self.traced[row])])
        return torch.cat([head, *parts])

    def take(self, told: Tensor) -> None:
        """Know what another process has `told`: what was traced here with other parameters is dropped."""
        row, rest = int(told[0]), told[2:]
        if torch.equal(self.told(row), told):
            return
        self.traced[row] = bool(told[1])
        for name in _TRACED_WITH:
            values = getattr(self, name)[row]
            part, rest = rest[: values.numel()], rest[values.numel() :]
            values.copy_(part.view_as(values))
        self._kept.pop(row, None)

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint keeps, by name."""
        return {name: getattr(self, name) for name in ("traced", *_TRACED_WITH)}

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Take what a checkpoint kept.

        Raises:
            KeyError: Something is missing.
            RuntimeError: It is of other frames.
        """
        for name, values in self.state().items():
            values.copy_(tensors[name])
        self._kept.clear()

    def _at(self, row: int, parameters: FrameParameters) -> Occlusion:
        """What was traced of a frame."""
        if row in self._kept:
            self._kept.move_to_end(row)
            return self._kept[row]
        then = replace(
            parameters,
            translation=self.translation[row],
            rotations=self.rotations[row],
            expression=self.expression[row],
        )
        return self._keep(row, self._occluder.occlude(self._canonical.pose(then)))

    def _keep(self, row: int, occlusion: Occlusion) -> Occlusion:
        self._kept[row] = occlusion
        self._kept.move_to_end(row)
        while len(self._kept) > 1 and sum(each.bytes for each in self._kept.values()) > KEPT_BYTES:
            self._kept.popitem(last=False)
        return occlusion
