"""The learned light as several frames in a row see it: filtered once, and learned from all of them.

Filtering and its adjoint are a quarter of a step on a CPU and most of its launches on a GPU, and the light
hardly moves from one step to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.light import FilteredLight, LearnableLight
from samira_warp.train.ranks import ALONE, Ranks


class _Filtered(NamedTuple):
    """A light that was filtered, and what stands in for it.

    Attributes:
        maps: What filtering made, from which gradients reach the light.
        leaves: The same values, where the gradients of frames are gathered.
        light: The light of the leaves.
    """

    maps: list[Tensor]
    leaves: list[Tensor]
    light: FilteredLight


class SharedLight:
    """A learned light for as long as it stays as it is.

    Attributes:
        frames: How many frames have told what they want of it since it last changed.
        gradient: (P,) sum of their gradients with respect to its maps, one after the other.
    """

    def __init__(self, light: LearnableLight) -> None:
        self._light = light
        self._filtered: _Filtered | None = None
        self.frames = 0
        with torch.no_grad():
            size = sum(values.numel() for values in _maps(light()))
        self.gradient = torch.zeros(size, device=light.specular.device)

    def light(self) -> FilteredLight:
        """The light as it is now, to shade a frame with."""
        if self._filtered is None:
            light = self._light.requires_grad_()()
            maps = _maps(light)
            leaves = [values.detach().requires_grad_() for values in maps]
            self._filtered = _Filtered(maps, leaves, _of_maps(light, leaves))
        return self._filtered.light

    def listen(self, *, frames: int = 1, ranks: Ranks = ALONE, counts: bool = True) -> None:
        """Take up what frames want of the light, after a backward pass.

        Args:
            frames: How many, over all ranks.
            ranks: Each with a frame of its own.
            counts: Whether this rank's is counted.
        """
        assert self._filtered is not None
        leaves = self._filtered.leaves
        wanted = torch.cat(
            [(torch.zeros_like(leaf) if leaf.grad is None else leaf.grad).flatten() for leaf in leaves]
        )
        for leaf in leaves:
            leaf.grad = None
        (total,) = ranks.summed([wanted], counts=counts)
        self.gradient += total
        self.frames += frames

    def learn(self) -> None:
        """Add the mean of what the frames wanted to the gradients of the light, which is to change now."""
        assert self._filtered is not None
        maps = self._filtered.maps
        parts = (self.gradient / self.frames).split([values.numel() for values in maps])
        torch.autograd.backward(
            maps, [part.view_as(values) for part, values in zip(parts, maps, strict=True)]
        )
        self._filtered, self.frames = None, 0
        self.gradient.zero_()

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint keeps, by name."""
        return {"frames": torch.tensor(self.frames), "gradient": self.gradient}

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Take what a checkpoint kept; one of before keeps nothing.

        Raises:
            RuntimeError: It is of another light.
        """
        self._filtered = None
        if tensors:
            self.frames = int(tensors["frames"])
            self.gradient.copy_(tensors["gradient"])


def _maps(light: FilteredLight) -> list[Tensor]:
    return [light.irradiance, *light.specular, light.radiance]


def _of_maps(light: FilteredLight, maps: list[Tensor]) -> FilteredLight:
    irradiance, *specular, radiance = maps
    return replace(light, irradiance=irradiance, specular=tuple(specular), radiance=radiance)
