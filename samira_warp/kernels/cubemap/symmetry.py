"""The cube's 48 symmetries as index tables: they make eight small matrix products of a large filter.

A linear filter whose weight depends only on the angle between two texels (and on a texel's solid angle)
commutes with every symmetry of the cube. The sign flips of the three coordinates commute with each other, so
the eight combinations of even and odd parts of a map (a Walsh-Hadamard transform over its eight octants)
never mix; the six permutations of the coordinates then carry one sixth of an octant's rows to the rest. A
filter from B to O texels needs B O / 6 stored weights and B O / 4 multiply-adds a channel instead of B O.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import FACES, texel_index, texel_points
from samira_warp.support.caching import cached_tensors

OCTANTS = 8
"""One for each combination of the coordinates' signs."""

PERMUTATIONS = tuple(itertools.permutations(range(3)))
"""The six orders of the coordinates: permutation p carries a point v to (v[p[0]], v[p[1]], v[p[2]])."""


class Symmetry(NamedTuple):
    """Index tables of one map size S.

    Of its B = 6 S^2 texels, U = B / 8 lie in the octant of positive coordinates.

    Attributes:
        flips: (8, U) int64, the texels of the eight octants: flip f negates coordinate k where bit k of f is
            set.
        turns: (6, U) int64, where in the octant each permutation carries each texel.
        turn_of: (U,) int64, the permutation that carries a representative to each texel of the octant.
        source_of: (U,) int64, position among ``representatives`` of that representative.
        representatives: (R,) int64, octant positions that stand for all others, one for each orbit of the
            permutations.
    """

    flips: Tensor
    turns: Tensor
    turn_of: Tensor
    source_of: Tensor
    representatives: Tensor


@cached_tensors()
def symmetry(size: int, device: torch.device) -> Symmetry:
    """The tables of an even map size."""
    points = texel_points(size).view(-1, 3)
    octant = points[(points > 0).all(dim=-1)]
    signs = torch.tensor([[1 - 2 * (flip >> k & 1) for k in range(3)] for flip in range(OCTANTS)])
    flips = texel_index(octant * signs[:, None], size)
    position = torch.full((FACES * size * size,), -1)
    position[flips[0]] = torch.arange(len(octant))
    turns = torch.stack([position[texel_index(octant[:, list(turn)], size)] for turn in PERMUTATIONS])
    representatives, source = turns.amin(dim=0).unique(return_inverse=True)
    # of the permutations that carry the representative here (several, on a plane of symmetry), the first
    carries = turns[:, representatives[source]] == torch.arange(len(octant))
    return Symmetry(
        *(table.to(device) for table in (flips, turns, carries.int().argmax(dim=0), source, representatives))
    )


@cached_tensors()
def parities(device: torch.device) -> Tensor:
    """(8, 8) float32 Walsh-Hadamard matrix: entry (p, f) is the sign that parity p gives to flip f.

    It is its own transpose.
    """
    return torch.tensor(
        [[1.0 - 2.0 * ((p & f).bit_count() % 2) for f in range(OCTANTS)] for p in range(OCTANTS)],
        device=device,
    )


@cached_tensors()
def turned_parities(device: torch.device) -> Tensor:
    """(8, 6) int64: the parity that each permutation makes of each parity.

    It moves the bits as it moves the coordinates.
    """
    return torch.tensor(
        [[sum((p >> turn[k] & 1) << k for k in range(3)) for turn in PERMUTATIONS] for p in range(OCTANTS)],
        device=device,
    )


@cached_tensors()
def spread_table(size: int, device: torch.device) -> Tensor:
    """(8, U, 6) int64: which row of a map's parity parts stands at each place after each permutation.

    A row is parity U + position; a place, a parity and a position.
    """
    tables = symmetry(size, device)
    octant = tables.turns.shape[1]
    return (turned_parities(device)[:, None] * octant + tables.turns.T).contiguous()


@cached_tensors()
def collect_table(size: int, device: torch.device) -> Tensor:
    """(8 U, 6) int64: transpose of `spread_table`, the six places where each row stands, in a fixed order."""
    spread = spread_table(size, device).reshape(-1, len(PERMUTATIONS))
    places = torch.argsort(spread, dim=0) * len(PERMUTATIONS)
    return places + torch.arange(len(PERMUTATIONS), device=device)


@cached_tensors()
def result_table(size: int, device: torch.device) -> Tensor:
    """(8, U) int64: where each row of a filtered map's parity parts stands in the products.

    Their rows are (parity R + representative) 6 + permutation.
    """
    tables = symmetry(size, device)
    count = len(tables.representatives)
    untwisted = torch.argsort(turned_parities(device), dim=0)[:, tables.turn_of]
    return ((untwisted * count + tables.source_of) * len(PERMUTATIONS) + tables.turn_of).contiguous()
