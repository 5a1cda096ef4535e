"""Feature maps of one size as those of another: R_l of Eq. uv_gate.

Both ways are linear, and the same for every column and every row: two small matrix products, whose adjoints
are matrix products, with the same bits at every call. On a GPU those of torch's own poolings add atomically.
"""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.support.caching import cached_tensors


def resize(features: Tensor, *, like: Tensor) -> Tensor:
    """Averages over areas where a map shrinks, and linear interpolation between texel centres where it grows.

    Args:
        features: (..., H, W) float32.
        like: Whose height and width the result has, (..., H', W').
    """
    (height, width), (new_height, new_width) = features.shape[-2:], like.shape[-2:]
    if width != new_width:
        features = features @ _weights(width, new_width, features.device).T
    if height != new_height:
        features = _weights(height, new_height, features.device) @ features
    return features


@cached_tensors(maxsize=32)
def _weights(count: int, size: int, device: torch.device) -> Tensor:
    """(size, count) weights of ``count`` texels in a row of ``size``."""
    unit = torch.eye(count, dtype=torch.float64)[:, None]
    if size < count:
        columns = torch.nn.functional.adaptive_avg_pool1d(unit, size)
    else:
        columns = torch.nn.functional.interpolate(unit, size=size, mode="linear", align_corners=False)
    return columns[:, 0].T.float().contiguous().to(device)
