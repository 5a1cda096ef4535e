"""Adaptive density control (3DGS) of mesh-bound Gaussians."""

from __future__ import annotations

import math
from typing import NamedTuple

import kornia
import torch

from samira_warp.avatar import Gaussians

GRADIENT_THRESHOLD = 2e-4
"""Mean gradient of the projected mean in normalised device units, pixels x (W/2, H/2), above which a Gaussian
is added to (3DGS)."""

SPLIT_SPACING = 2.0
"""Gaussians larger than this many median spacings are split, smaller ones are cloned."""

SPLIT_SHRINK = 1.6
"""Each half of a split is this much smaller (3DGS: 0.8 times two halves)."""

OPACITY_MIN = 0.005
"""Gaussians fainter than this are removed (3DGS)."""

OPACITY_RESET = 0.01
"""Opacity resets bring every Gaussian down to this."""


class DensityStatistics:
    """Screen-space gradients gathered between density control events, one entry a Gaussian."""

    def __init__(self, count: int, device: torch.device) -> None:
        self.gradient = torch.zeros(count, device=device)
        self.views = torch.zeros(count, device=device)

    def add(self, means2d_gradient: torch.Tensor, visible: torch.Tensor, *, width: int, height: int) -> None:
        """Add one frame.

        Args:
            means2d_gradient: (N, 2) gradient of the loss by the projected means, per pixel.
            visible: (N,) bool.
            width: W, pixels.
            height: H, pixels.
        """
        scale = means2d_gradient.new_tensor([0.5 * width, 0.5 * height])
        self.gradient += torch.where(visible, (means2d_gradient * scale).norm(dim=1), 0.0)
        self.views += visible

    def include(self, other: DensityStatistics) -> None:
        """Add what was gathered of other frames of the same Gaussians."""
        self.gradient += other.gradient
        self.views += other.views

    @property
    def mean(self) -> torch.Tensor:
        """(N,) mean gradient over the frames in which each Gaussian was visible."""
        return self.gradient / self.views.clamp(min=1.0)


class DensityChange(NamedTuple):
    """The outcome of one event.

    Attributes:
        gaussians: The Gaussians after it: first those kept, then the new ones.
        kept: (M,) indices of the kept ones among the old.
    """

    gaussians: Gaussians
    kept: torch.Tensor


@torch.no_grad()
def control_density(
    gaussians: Gaussians,
    statistics: DensityStatistics,
    *,
    face_scales: torch.Tensor,
    face_areas: torch.Tensor,
    cap: int,
    generator: torch.Generator,
) -> DensityChange:
    """Clone or split where the screen-space gradient is large, and remove what is faint.

    Every face keeps at least one. Children stay on their parent's face. A split draws two children from the
    parent's own distribution in the triangle's frame.

    Args:
        gaussians: The Gaussians before the event; UV coordinates of the result are the parents' and want
            refreshing.
        statistics: Gathered since the last event.
        face_scales: (F,) k of every face on the reference mesh, metres.
        face_areas: (F,) area of every face on the reference mesh, square metres.
        cap: No more Gaussians than this; those with the largest gradients are served first.
        generator: Draws the split positions.
    """
    old = gaussians.tensors()
    gradient = statistics.mean
    scale = gaussians.scales.amax(dim=1) * face_scales[gaussians.faces.long()]
    faint = _removable(gaussians, face_count=len(face_scales))
    wanted = _largest((gradient > GRADIENT_THRESHOLD) & ~faint, gradient, room=cap - int((~faint).sum()))
    split = wanted & (scale > SPLIT_SPACING * spacing(gaussians.faces.long(), face_areas).median())
    clone = wanted & ~split
    kept = (~faint & ~split).nonzero()[:, 0]
    parts = [
        {name: value[kept] for name, value in old.items()},
        {name: value[clone] for name, value in old.items()},
    ]
    parts += [_split_half({name: value[split] for name, value in old.items()}, generator) for _ in range(2)]
    return DensityChange(Gaussians({name: torch.cat([part[name] for part in parts]) for name in old}), kept)


@torch.no_grad()
def reset_opacity(gaussians: Gaussians) -> None:
    """Bring every opacity down to OPACITY_RESET, so that what the images do not ask for fades away."""
    ceiling = torch.logit(torch.tensor(OPACITY_RESET, device=gaussians.means.device))
    gaussians.opacity_logits.clamp_(max=ceiling)


def _removable(gaussians: Gaussians, *, face_count: int) -> torch.Tensor:
    """(N,) faint Gaussians, less the most opaque one of each face."""
    opacities, faces = gaussians.opacities, gaussians.faces.long()
    rank = torch.empty_like(faces)
    rank[torch.argsort(opacities, stable=True)] = torch.arange(len(faces), device=faces.device)
    highest = torch.full((face_count,), -1, device=faces.device).scatter_reduce(0, faces, rank, "amax")
    return (opacities < OPACITY_MIN) & (rank < highest[faces])


def spacing(faces: torch.Tensor, face_areas: torch.Tensor) -> torch.Tensor:
    """(N,) metres between neighbours: each Gaussian's share of its face's area is a square of this side."""
    count = torch.bincount(faces, minlength=len(face_areas))
    return (face_areas / count.clamp(min=1)).sqrt()[faces]


def _largest(candidates: torch.Tensor, gradient: torch.Tensor, *, room: int) -> torch.Tensor:
    """Of the candidates, the ``room`` ones with the largest gradient."""
    if int(candidates.sum()) <= room:
        return candidates
    order = torch.argsort(torch.where(candidates, gradient, -1.0), descending=True, stable=True)
    chosen = torch.zeros_like(candidates)
    chosen[order[: max(room, 0)]] = True
    return chosen


def _split_half(parents: dict[str, torch.Tensor], generator: torch.Generator) -> dict[str, torch.Tensor]:
    """One child of each parent, drawn from it and smaller."""
    noise = torch.randn(parents["means"].shape, generator=generator).to(parents["means"].device)
    rotation = kornia.geometry.quaternion_to_rotation_matrix(
        torch.nn.functional.normalize(parents["quaternions"], dim=1)
    )
    offset = torch.einsum("nij,nj->ni", rotation, parents["log_scales"].exp() * noise)
    shrunk = parents["log_scales"] - math.log(SPLIT_SHRINK)
    return {**parents, "means": parents["means"] + offset, "log_scales": shrunk}
