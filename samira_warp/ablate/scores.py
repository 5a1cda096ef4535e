"""The scores of a finished run: of the whole frame, of the foreground and by region."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

from samira_warp.ablate.study import Run, Study
from samira_warp.avatar import Avatar
from samira_warp.data import PixelCache
from samira_warp.evaluate.folders import labels_path, read_region_names
from samira_warp.io.files import read_json, replace_file
from samira_warp.support.errors import UserError
from samira_warp.train.begun import CONFIG_FILE
from samira_warp.train.results import score
from samira_warp.train.run import RESULTS_FILE
from samira_warp.train.setup import PIXEL_CACHE_BYTES

SCORES_FILE = "scores.json"
"""In a run's folder: what results.json has, by region as well."""


def score_runs(study: Study) -> list[dict[str, Any]]:
    """The scores of every run of a study, in its order, as `samira_warp.evaluate.evaluate_images` gives them.

    Without regions they are those of the runs' own results; else the test frames are rendered once more, in
    memory, and what comes of it is kept in the run's folder.

    Raises:
        UserError: A file cannot be read, or the runs saw the reference picture by different encoders.
    """
    _check_encoders(study.runs)
    if study.regions is None:
        return [read_json(run.folder / RESULTS_FILE) for run in study.runs]
    labels = _digest(study, study.regions)
    resolution = study.runs[0].plan.settings.resolution
    with PixelCache(study.sequence.frames, resolution=resolution, max_bytes=PIXEL_CACHE_BYTES) as pixels:
        return [_kept(run, labels) or _scored(run, study, pixels, labels) for run in study.runs]


def _kept(run: Run, labels: str) -> dict[str, Any] | None:
    """What was scored before by the same labels."""
    path = run.folder / SCORES_FILE
    found = read_json(path) if path.is_file() else {}
    return found if found.get("labels_hash") == labels else None


def _scored(run: Run, study: Study, pixels: PixelCache, labels: str) -> dict[str, Any]:
    print(f"scores of {run.folder} by region", file=sys.stderr)
    settings = run.plan.settings
    distances = study.distances.to(settings.device)
    avatar = Avatar.load(run.folder, device=settings.device)
    result = score(avatar, study.sequence, pixels, plan=run.plan, distances=distances, regions=study.regions)
    result["labels_hash"] = labels
    replace_file(run.folder / SCORES_FILE, json.dumps(result, indent=1))
    return result


def _digest(study: Study, regions: Path) -> str:
    """Of all labels of the test frames, with their names."""
    digest = hashlib.sha256(json.dumps(read_region_names(regions), sort_keys=True).encode())
    for index in study.sequence.test:
        digest.update(labels_path(regions, study.sequence.frames[index].name).read_bytes())
    return digest.hexdigest()


def _check_encoders(runs: tuple[Run, ...]) -> None:
    """Raise UserError where some runs had an encoder that others had to do without."""
    encoders = [read_json(run.folder / CONFIG_FILE).get("encoder") for run in runs]
    for run, encoder in zip(runs, encoders, strict=True):
        if encoder != encoders[0]:
            raise UserError(
                f"{run.folder}: encoder", expected=f"{encoders[0]} as in {runs[0].folder}", found=encoder
            )
