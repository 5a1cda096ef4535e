"""The same test frames of several runs: their truth, their renderings, and their regions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from samira_warp.ablate.study import LABELS
from samira_warp.ablate.table import REGION_HEADINGS, Score, scores_in
from samira_warp.avatar import Avatar, DrivingFrame
from samira_warp.compare.runs import TrainedRun
from samira_warp.data import FrameFiles, open_listing
from samira_warp.data.pixels import load_pixels
from samira_warp.evaluate import ImagePair, evaluate_images
from samira_warp.evaluate.folders import labels_path, read_frame_labels, read_region_names
from samira_warp.io.images import to_uint8
from samira_warp.support.errors import UserError
from samira_warp.train.begun import AVATAR_FOLDER


@dataclass(frozen=True)
class Truth:
    """The dataset of runs, as far as it is there.

    Attributes:
        files: Its test frames' files by name; None where it is not there.
        missing: Why it is not there.
        regions: Folder of label images of the test frames, None without regions.
    """

    files: Mapping[str, FrameFiles] | None
    missing: str | None = None
    regions: Path | None = None


def find_truth(runs: Sequence[TrainedRun], *, data: Path | None, regions: Path | None) -> Truth:
    """The dataset that the runs were trained on.

    Args:
        runs: All of the same data.
        data: Where it is now; None looks where the runs found it.
        regions: Folder of label images; None takes the dataset's own, where it has some.

    Raises:
        UserError: What is asked for is not there, or not of these runs.
    """
    names = [frame.name for frame in runs[0].frames]
    places = [data] if data is not None else [run.settings["data"] for run in runs]
    place = next((place for place in places if place.is_dir()), places[0])
    try:
        listing = open_listing(place)
        files = {frame.name: frame for frame in listing.frames}
        absent = [name for name in names if name not in files]
        if absent:
            raise UserError(
                place, expected=f"the runs' test frame {absent[0]}", found="no frame of this name"
            )
    except UserError as fault:
        if data is not None or regions is not None:
            raise
        return Truth(None, missing=str(fault))
    folder = regions or place / LABELS
    if regions is None and not folder.is_dir():
        return Truth(files)
    read_region_names(folder)
    for name in names:
        labels_path(folder, name)
    return Truth(files, regions=folder)


@torch.no_grad()
def render_frames(
    run: TrainedRun, frames: Sequence[DrivingFrame], *, device: torch.device
) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 pictures of some frames under the light that the run learned, on white, as scored."""
    avatar = Avatar.load(run.folder / AVATAR_FOLDER, device=device)
    light, shadows = avatar.light(), avatar.settings.visibility
    for frame in frames:
        rendering = avatar.render(frame.parameters, frame.camera, light, shadows=shadows)
        yield to_uint8(rendering.image.cpu().numpy())


def true_picture(files: FrameFiles, *, width: int, height: int) -> np.ndarray:
    """(H, W, 3) float32 display values of a frame as it was filmed, on white.

    Raises:
        UserError: A file cannot be read.
    """
    return load_pixels(files, width=width, height=height).image.numpy()


def score_regions(run: TrainedRun, truth: Truth, *, device: torch.device) -> dict[Score, float]:
    """PSNR and SSIM of a run's test frames by region: what results.json has not; none without regions.

    Raises:
        UserError: A picture or its labels cannot be read.
    """
    files, regions = truth.files, truth.regions
    if files is None or regions is None:
        return {}

    def pairs() -> Iterator[ImagePair]:
        for frame, picture in zip(run.frames, render_frames(run, run.frames, device=device), strict=True):
            size = {"width": picture.shape[1], "height": picture.shape[0]}
            truly = torch.from_numpy(true_picture(files[frame.name], **size))
            labels = read_frame_labels(regions, frame.name, **size)
            yield ImagePair(frame.name, torch.from_numpy(picture).float() / 255.0, truly, labels=labels)

    scored: dict[str, Any] = evaluate_images(pairs(), region_names=read_region_names(regions), protocol={})
    return {
        score: value
        for score, value in scores_in(scored).items()
        if score.region is not None and score.name in REGION_HEADINGS
    }
