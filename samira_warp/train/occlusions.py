"""Which directions the head blocks in training frames: traced once, and again where the mesh has moved."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.avatar.occlusion import Occluder, Occlusion
from samira_warp.head import FrameParameters, PosedHead
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.train.tracking import TrackedParameters

STALE = 0.001
"""Metres that a vertex may go in the head's axes before its frame is traced again. Fine-tuning moves vertices
by a tenth of that; at two centimetres, a nose's height, it turns the edge of a shadow by three degrees, a
third of the sky's step."""

KEPT_BYTES = 1 << 28
"""Of what was traced: some 1,700 frames of a head of 5,300 vertices, on a CPU. The first frames that fit
stay; the others are traced again, from the same parameters, whenever they are shown."""

_TRACED_WITH = ("translation", "rotations", "expression")
"""Parameters of a frame that pose its mesh."""


@dataclass(frozen=True, eq=False)
class _Folded:
    """An `Occlusion` in two fifths of its memory: without its normals, and on a CPU with its bits deflated.

    Neighbours block the same directions: zlib's fastest level makes 48 bytes a vertex 13, in 4 ms, and whole
    again in 1.5 ms.
    """

    bits: bytes | Tensor
    points: Tensor
    openness: Tensor
    transform: Tensor

    @classmethod
    def of(cls, occlusion: Occlusion) -> _Folded:
        bits = occlusion.bits
        folded = zlib.compress(bits.numpy().data, 1) if bits.device.type == "cpu" else bits
        return cls(folded, occlusion.points, occlusion.openness, occlusion.transform)

    @property
    def bytes(self) -> int:
        bits = len(self.bits) if isinstance(self.bits, bytes) else self.bits.nbytes
        return bits + self.points.nbytes + self.openness.nbytes

    def unfolded(self, topology: MeshTopology) -> Occlusion:
        """What was folded, to the bit."""
        bits = self.bits
        if isinstance(bits, bytes):
            words = np.frombuffer(bytearray(zlib.decompress(bits)), np.int32)
            bits = torch.from_numpy(words).view(len(self.points), -1)
        normals = mesh_normals(self.points[None], topology)[0]
        return Occlusion(bits, self.points, normals, self.transform, self.openness)


class FrameOcclusions:
    """What the head blocks in T training frames.

    What a frame's bits are depends on the parameters that it was traced with, which a checkpoint keeps: a run
    that goes on has the same ones.

    Attributes:
        traced: (T,) bool, whether the frame was traced.
        translation: (T, 3) the parameters that it was traced with.
        rotations: (T, J, 3) likewise.
        expression: (T, E) likewise.
        full: Whether a frame did not fit into what is kept.
    """

    def __init__(self, canonical: CanonicalHead, occluder: Occluder, tracked: TrackedParameters) -> None:
        self._canonical, self._occluder = canonical, occluder
        self._kept: dict[int, _Folded] = {}
        self.full = False
        self.traced = torch.zeros(len(tracked.translation), dtype=torch.bool)
        self.translation, self.rotations, self.expression = (
            values.detach().clone() for values in (tracked.translation, tracked.rotations, tracked.expression)
        )

    @torch.no_grad()
    def of(self, row: int, parameters: FrameParameters, head: PosedHead) -> Occlusion:
        """What blocks in frame ``row``, whose parameters pose ``head``; traced if it has to be."""
        kept = self._kept.get(row)
        if kept is not None and not _stale(head, kept.points):
            return kept.unfolded(self._canonical.topology).under(head)
        if kept is None and self.traced[row]:
            then = self._posed(row, parameters)
            if not _stale(head, then.in_head_frame()):
                return self._trace(row, then).under(head)
        self.traced[row] = True
        for name in _TRACED_WITH:
            getattr(self, name)[row] = getattr(parameters, name)
        return self._trace(row, head)

    @property
    def kept_bytes(self) -> int:
        """Of what is kept of traced frames."""
        return sum(folded.bytes for folded in self._kept.values())

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

    def _posed(self, row: int, parameters: FrameParameters) -> PosedHead:
        """The head that a frame was traced with."""
        then = {name: getattr(self, name)[row] for name in _TRACED_WITH}
        return self._canonical.pose(replace(parameters, **then))

    def _trace(self, row: int, head: PosedHead) -> Occlusion:
        """What blocks in a frame as it is posed; it is kept from now on where it fits."""
        occlusion = self._occluder.occlude(head)
        self._kept.pop(row, None)
        folded = _Folded.of(occlusion)
        if self.kept_bytes + folded.bytes <= KEPT_BYTES:
            self._kept[row] = folded
        else:
            self.full = True
        return occlusion


def _stale(head: PosedHead, points: Tensor) -> bool:
    """Whether a vertex has gone too far in the head's axes since it was at its place of (V, 3) points."""
    return bool((head.in_head_frame() - points).square().sum(dim=-1).max() > STALE**2)
