"""Constant tensors that are built once and kept."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch

Arguments = ParamSpec("Arguments")
Built = TypeVar("Built")


def cached_tensors(
    maxsize: int | None = None,
) -> Callable[[Callable[Arguments, Built]], Callable[Arguments, Built]]:
    """Decorate a function that builds constant tensors from hashable arguments, so that it builds them once.

    They are made outside `torch.inference_mode` whoever asks first: a tensor that was made inside could never
    be saved for a backward pass after that. Nobody may write into them.

    Args:
        maxsize: How many results to keep, the latest used; None keeps all.
    """

    def decorate(build: Callable[Arguments, Built]) -> Callable[Arguments, Built]:
        @functools.lru_cache(maxsize)
        @functools.wraps(build)
        def build_normally(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Built:
            with torch.inference_mode(False), torch.no_grad():
                return build(*args, **kwargs)

        return build_normally  # type: ignore[return-value]  # typeshed's lru_cache loses the parameters

    return decorate
