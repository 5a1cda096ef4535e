"""LPIPS v0.1 (Zhang et al. 2018) on VGG16 and AlexNet, in plain torch, with weights that the user has."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from samira_warp.evaluate.config import LpipsNet
from samira_warp.support.errors import UserError

SMALLEST_IMAGE = 32
"""Pixels a side; below it AlexNet's last layers have nothing left to look at."""


@dataclass(frozen=True)
class _Convolution:
    """One convolution of a backbone.

    Attributes:
        index: Its place in torchvision's ``features``, which its keys carry.
        channels: Output channels.
        kernel: Kernel size.
        stride: Stride.
        pool: Size of the max pooling (stride 2) before it, 0 for none.
        tapped: Whether LPIPS looks at its rectified output.
    """

    index: int
    channels: int
    kernel: int = 3
    stride: int = 1
    pool: int = 0
    tapped: bool = False


@dataclass(frozen=True)
class _Backbone:
    file: str
    head_file: str
    convolutions: tuple[_Convolution, ...]


_BACKBONES: Mapping[LpipsNet, _Backbone] = {
    "vgg": _Backbone(
        "vgg16-397923af.pth",
        "vgg.pth",
        (
            _Convolution(0, 64),
            _Convolution(2, 64, tapped=True),
            _Convolution(5, 128, pool=2),
            _Convolution(7, 128, tapped=True),
            _Convolution(10, 256, pool=2),
            _Convolution(12, 256),
            _Convolution(14, 256, tapped=True),
            _Convolution(17, 512, pool=2),
            _Convolution(19, 512),
            _Convolution(21, 512, tapped=True),
            _Convolution(24, 512, pool=2),
            _Convolution(26, 512),
            _Convolution(28, 512, tapped=True),
        ),
    ),
    "alex": _Backbone(
        "alexnet-owt-7be5be79.pth",
        "alex.pth",
        (
            _Convolution(0, 64, kernel=11, stride=4, tapped=True),
            _Convolution(3, 192, kernel=5, pool=3, tapped=True),
            _Convolution(6, 384, pool=3, tapped=True),
            _Convolution(8, 256, tapped=True),
            _Convolution(10, 256, tapped=True),
        ),
    ),
}


class Lpips(nn.Module):
    """Perceptual distance; frozen, and differentiable in both images.

    Args:
        net: The backbone.
        backbone: torchvision's state dict of it (keys ``features.N.weight`` and ``.bias``).
        head: LPIPS v0.1's linear weights (keys ``linN.model.1.weight``).
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, net: LpipsNet, backbone: Mapping[str, Tensor], head: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.net = net
        self.convolutions = _BACKBONES[net].convolutions
        for convolution in self.convolutions:
            for part in ("weight", "bias"):
                self.register_buffer(
                    f"{part}_{convolution.index}", backbone[f"features.{convolution.index}.{part}"].float()
                )
        for level in range(sum(convolution.tapped for convolution in self.convolutions)):
            self.register_buffer(
                f"head_{level}", head[f"lin{level}.model.1.weight"].float().reshape(-1, 1, 1)
            )
        # LPIPS' own scaling layer: ImageNet's statistics for images in -1..1
        self.register_buffer("shift", torch.tensor([-0.030, -0.088, -0.188])[:, None, None])
        self.register_buffer("scale", torch.tensor([0.458, 0.448, 0.450])[:, None, None])

    def forward(self, prediction: Tensor, truth: Tensor) -> Tensor:
        """Distance of two images, () float32: 0 for equal ones.

        Args:
            prediction: (H, W, 3) float32 display values in 0..1.
            truth: (H, W, 3) float32 display values in 0..1.

        Raises:
            UserError: The images are smaller than SMALLEST_IMAGE.
        """
        if min(prediction.shape[:2]) < SMALLEST_IMAGE:
            raise UserError(
                "LPIPS",
                expected=f"images of {SMALLEST_IMAGE} pixels a side and more",
                found=tuple(prediction.shape[:2]),
            )
        levels = zip(self._features(prediction), self._features(truth), strict=True)
        distances = [
            (getattr(self, f"head_{level}") * (_unit(ours) - _unit(theirs)).square()).sum(dim=1).mean()
            for level, (ours, theirs) in enumerate(levels)
        ]
        return torch.stack(distances).sum()

    def _features(self, image: Tensor) -> list[Tensor]:
        """The tapped levels of one image, (1, C, h, w) each."""
        x = ((2.0 * image.to(self.shift.device).permute(2, 0, 1) - 1.0 - self.shift) / self.scale)[None]
        levels = []
        for convolution in self.convolutions:
            if convolution.pool:
                x = torch.nn.functional.max_pool2d(x, convolution.pool, stride=2)
            weight = getattr(self, f"weight_{convolution.index}")
            bias = getattr(self, f"bias_{convolution.index}")
            # padding that keeps the size, but for AlexNet's first layer, which torchvision pads by 2
            padding = 2 if convolution.kernel == 11 else convolution.kernel // 2
            x = torch.relu(
                torch.nn.functional.conv2d(x, weight, bias, stride=convolution.stride, padding=padding)
            )
            if convolution.tapped:
                levels.append(x)
        return levels


def find_lpips(net: LpipsNet, weights_dir: Path | None = None) -> Lpips | str:
    """Build LPIPS from weights on this machine; nothing is downloaded.

    The files are torchvision's backbone and LPIPS v0.1's ``vgg.pth`` or ``alex.pth``. They are looked for in
    ``weights_dir`` (there only, where it is given), else in torch.hub's cache and in the folder of an
    installed ``lpips`` package, which is not imported.

    Args:
        net: The backbone.
        weights_dir: The user's folder with both files.

    Returns:
        The module on the CPU, or a sentence that says which file is absent and where it was looked for.

    Raises:
        UserError: ``weights_dir`` is no folder, or a file that was found does not hold the weights.
    """
    if weights_dir is not None and not weights_dir.is_dir():
        raise UserError(
            weights_dir,
            expected="a folder of LPIPS weights",
            found="a file" if weights_dir.exists() else "no such folder",
        )
    folders = [weights_dir] if weights_dir is not None else _usual_folders()
    backbone = _BACKBONES[net]
    paths = []
    for name in (backbone.file, backbone.head_file):
        path = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if path is None:
            return f"{name} is in none of: {', '.join(map(str, folders))}"
        paths.append(path)
    return Lpips(
        net, _read_weights(paths[0], _backbone_shapes(net)), _read_weights(paths[1], _head_shapes(net))
    )


def _usual_folders() -> list[Path]:
    folders = [Path(torch.hub.get_dir()) / "checkpoints"]
    package = importlib.util.find_spec("lpips")
    if package is not None:
        folders += [
            Path(location) / "weights" / "v0.1" for location in package.submodule_search_locations or ()
        ]
    return folders


def _backbone_shapes(net: LpipsNet) -> dict[str, tuple[int, ...]]:
    shapes: dict[str, tuple[int, ...]] = {}
    channels = 3
    for convolution in _BACKBONES[net].convolutions:
        shapes[f"features.{convolution.index}.weight"] = (
            convolution.channels,
            channels,
            convolution.kernel,
            convolution.kernel,
        )
        shapes[f"features.{convolution.index}.bias"] = (convolution.channels,)
        channels = convolution.channels
    return shapes


def _head_shapes(net: LpipsNet) -> dict[str, tuple[int, ...]]:
    tapped = [convolution.channels for convolution in _BACKBONES[net].convolutions if convolution.tapped]
    return {f"lin{level}.model.1.weight": (1, channels, 1, 1) for level, channels in enumerate(tapped)}


def _read_weights(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """The named tensors of a state dict, each of the shape expected; no code in the file is run."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (
        Exception
    ) as fault:  # torch raises anything from EOFError to UnpicklingError for a file that is not its own
        raise UserError(
            path,
            expected="a state dict written by torch",
            found=str(fault).splitlines()[0] if str(fault) else repr(fault),
        ) from fault
    for key, shape in shapes.items():
        found = state.get(key) if isinstance(state, dict) else None
        if not isinstance(found, Tensor) or tuple(found.shape) != shape:
            raise UserError(
                f"{path}: {key}", expected=f"weights of shape {shape}", found=getattr(found, "shape", "none")
            )
    return {key: state[key] for key in shapes}


def _unit(features: Tensor) -> Tensor:
    """Features of unit length over the channels.

    vector_norm has a gradient of zero at zero, where a square root has none.
    """
    return features / (torch.linalg.vector_norm(features, dim=1, keepdim=True) + 1e-10)
