"""Fixed random features of an image: a ResNet-18 (He et al., 2016) that nothing was trained on.

Written out here, for it needs none of the seconds that a library of backbones takes to load. Its weights are
drawn as transformers draws those of its own, to the same bits.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

WIDTHS = (64, 128, 256, 512)
"""Channels of the stages, at strides 4, 8, 16 and 32."""

BLOCKS = 2
"""To a stage."""


class RandomFeatures(nn.Module):
    """The stages' outputs, finest first."""

    def __init__(self, levels: int) -> None:
        """Draw the weights from torch's generator.

        Args:
            levels: L, how many stages to give the outputs of, at most four.
        """
        super().__init__()
        self.levels = levels
        self.stem = nn.Sequential(
            *_convolution(3, WIDTHS[0], size=7, stride=2),
            nn.ReLU(),
            nn.MaxPool2d(kernel_size=3, stride=2, padding=1),
        )
        self.stages = nn.ModuleList()
        before = WIDTHS[0]
        for width in WIDTHS:  # all of them are drawn, whatever is asked for
            first = _Block(before, width, stride=1 if width == before else 2)
            self.stages.append(nn.Sequential(first, *(_Block(width, width) for _ in range(BLOCKS - 1))))
            before = width
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.normal_(module.weight)  # theirs are drawn twice
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, image: Tensor) -> list[Tensor]:
        """L features (1, C_l, H_l, W_l) of a (1, 3, H, W) image."""
        features, values = [], self.stem(image)
        for stage in self.stages[: self.levels]:
            values = stage(values)
            features.append(values)
        return features


class _Block(nn.Module):
    """Two convolutions, and what they are added to."""

    def __init__(self, before: int, width: int, *, stride: int = 1) -> None:
        super().__init__()
        self.skip = (
            nn.Identity()
            if before == width and stride == 1
            else nn.Sequential(*_convolution(before, width, size=1, stride=stride))
        )
        self.residual = nn.Sequential(
            *_convolution(before, width, size=3, stride=stride),
            nn.ReLU(),
            *_convolution(width, width, size=3),
        )

    def forward(self, values: Tensor) -> Tensor:
        return torch.relu(self.residual(values) + self.skip(values))


def _convolution(before: int, width: int, *, size: int, stride: int = 1) -> tuple[nn.Module, nn.Module]:
    convolution = nn.Conv2d(before, width, size, stride=stride, padding=size // 2, bias=False)
    return convolution, nn.BatchNorm2d(width)
