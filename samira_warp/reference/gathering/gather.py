"""The sparse map of `samira_warp.kernels.gathering.gather` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.gathering.gather import GatherTable


def gather(values: Tensor, table: GatherTable) -> Tensor:
    """Sum weights[m, k] * values[indices[m, k]] over k: (S, C) to (M, C), in the precision of ``values``."""
    weights = table.weights.to(values.dtype)[..., None]
    terms = torch.where(weights != 0, weights * values[table.indices.long()], 0)
    return terms.sum(dim=1)
