"""Pairs of images from folders: which names are scored, and where their files lie."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from samira_warp.data import FrameFiles, Listing
from samira_warp.data.pictures import is_hidden
from samira_warp.data.pixels import load_mask, load_pixels
from samira_warp.evaluate.config import Layer
from samira_warp.evaluate.evaluate import ImagePair
from samira_warp.io.files import read_json
from samira_warp.io.images import read_labels, read_on_white, read_rgba, resize_box, resize_nearest
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class Comparison:
    """The files of one frame to be compared.

    Attributes:
        frame: The dataset's frame, for its mask.
        prediction: The predicted image.
        truth: The true image, None for the dataset's own picture.
        labels: The region labels, None without regions.
    """

    frame: FrameFiles
    prediction: Path
    truth: Path | None
    labels: Path | None


def find_comparisons(
    listing: Listing, *, predictions: Path, truth: Path | None, layer: Layer, regions: Path | None
) -> list[Comparison]:
    """Pair predictions with the truth by name.

    All images of the ``truth`` folder are scored; without one, the dataset's own pictures of the split are.
    ``predictions`` may be the folder of the images or an output folder of ``render``, which has one folder
    for each layer.

    Raises:
        UserError: A folder or an image is missing, or a true image is none of the dataset's.
    """
    for folder in (predictions, truth, regions):
        if folder is not None and not folder.is_dir():
            raise UserError(
                folder, expected="a folder of images", found="a file" if folder.exists() else "no such folder"
            )
    truths: dict[str, Path | None]
    if truth is None:
        truths = {listing.frames[index].name: None for index in listing.selected}
    else:
        truths = {
            path.stem: path
            for path in sorted(truth.iterdir())
            if path.suffix.lower() in (".png", ".jpg", ".jpeg") and not is_hidden(path)
        }
        if not truths:
            raise UserError(truth, expected="images", found="none")
    frames = {frame.name: frame for frame in listing.frames}
    within = predictions / layer
    folder = within if within.is_dir() else predictions
    comparisons = []
    for name, true_path in truths.items():
        if name not in frames:
            raise UserError(
                true_path,
                expected=f"the name of a frame of {listing.root} (split {listing.split.text})",
                found=name,
            )
        labels = None if regions is None else labels_path(regions, name)
        comparisons.append(
            Comparison(
                frames[name], _existing(folder / f"{name}.png", "the frame's prediction"), true_path, labels
            )
        )
    return comparisons


def read_pair(comparison: Comparison, *, layer: Layer) -> ImagePair:
    """Read the files of one frame; truth, mask and labels take the prediction's size.

    Raises:
        UserError: A file cannot be decoded.
    """
    prediction = _read_laid(comparison.prediction, layer)
    height, width = prediction.shape[:2]
    if comparison.truth is None:
        truth = load_pixels(comparison.frame, width=width, height=height).image
    else:
        truth = torch.from_numpy(
            np.ascontiguousarray(resize_box(_read_laid(comparison.truth, layer), width=width, height=height))
        )
    labels = None if comparison.labels is None else _resized(comparison.labels, width=width, height=height)
    decoded = torch.from_numpy(prediction)
    if layer == "normal":
        decoded, truth = 2.0 * decoded - 1.0, 2.0 * truth - 1.0
    return ImagePair(
        comparison.frame.name, decoded, truth, load_mask(comparison.frame, width=width, height=height), labels
    )


def read_pairs(comparisons: list[Comparison], *, layer: Layer) -> Iterator[ImagePair]:
    """The pairs one after the other."""
    return (read_pair(comparison, layer=layer) for comparison in comparisons)


def labels_path(regions: Path, name: str) -> Path:
    """The label image of a frame.

    Raises:
        UserError: There is none.
    """
    return _existing(regions / f"{name}.png", "the frame's region labels")


def read_frame_labels(regions: Path, name: str, *, width: int, height: int) -> Tensor:
    """(height, width) uint8 region labels of a frame, the nearest ones of its label image.

    Raises:
        UserError: The image is missing or cannot be decoded.
    """
    return _resized(labels_path(regions, name), width=width, height=height)


def read_region_names(regions: Path) -> dict[int, str]:
    """Names of the labels, from ``parse.json`` in the folder of labels or beside it: {"1": "eye", ...}.

    Raises:
        UserError: There is no such file, or it holds something else.
    """
    beside = (regions / "parse.json", regions.parent / "parse.json")
    path = next((path for path in beside if path.is_file()), None)
    if path is None:
        raise UserError(
            beside[0], expected="the names of the labels, here or one folder up", found="no such file"
        )
    try:
        return {int(label): str(name) for label, name in read_json(path).items()}
    except ValueError as fault:
        raise UserError(path, expected='labels and their names, such as {"1": "eye"}', found=fault) from fault


def _resized(labels: Path, *, width: int, height: int) -> Tensor:
    return torch.from_numpy(resize_nearest(read_labels(labels), width=width, height=height))


def _read_laid(path: Path, layer: Layer) -> np.ndarray:
    """(H, W, 3) float32: an image without its alpha, laid on what layers of its kind are laid on."""
    if layer != "normal":
        return read_on_white(path)
    color, alpha = read_rgba(path)
    return color if alpha is None else alpha[..., None] * color + 0.5 * (1.0 - alpha[..., None])


def _existing(path: Path, expected: str) -> Path:
    if not path.is_file():
        raise UserError(path, expected=expected, found="no such file")
    return path
