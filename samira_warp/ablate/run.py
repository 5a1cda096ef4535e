"""A comparison from its options to its tables."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from samira_warp.ablate.config import AblateConfig
from samira_warp.ablate.picture import draw_regions
from samira_warp.ablate.scores import score_runs
from samira_warp.ablate.study import Run, Study, open_study
from samira_warp.ablate.table import Table, as_json, markdown, nested, scores_in, tabulate
from samira_warp.io.files import read_json, replace_file
from samira_warp.io.images import encode_png
from samira_warp.train.begun import CONFIG_FILE
from samira_warp.train.run import train

TABLE_FILE, JSON_FILE, PICTURE_FILE = "ablation.md", "ablation.json", "regions.png"
"""Names in the folder of a comparison."""


def ablate(config: AblateConfig) -> str | None:
    """Train what is not there yet, score it all, and write the tables and the picture.

    Runs are looked at before the first is trained: one with other settings or of other data is refused. What
    is there of an earlier comparison stays until the new tables are whole.

    Returns:
        The tables in Markdown, or None when Ctrl-C ended a run early (a checkpoint was saved).

    Raises:
        UserError: An option, the dataset, the labels or a run that is there cannot be used, or a run fails.
    """
    study = open_study(config)
    for number, run in enumerate(study.runs, 1):
        name = f"run {number} of {len(study.runs)}: {run.variant}, seed {run.seed}"
        print(f"{name}, {'is there' if run.finished else 'begins'}: {run.folder}", file=sys.stderr)
        if not run.finished and not _trained(run):
            return None
    results = score_runs(study)
    scores: dict[str, list[dict]] = {}
    for run, result in zip(study.runs, results, strict=True):
        scores.setdefault(run.variant, []).append(scores_in(result))
    table = tabulate(scores)
    text = markdown(table, title=f"Ablation on {_subject(study)}", about=_about(study, results[0]))
    _write(config.out, study, results, table, text)
    return text


def _trained(run: Run) -> bool:
    """Train a run to its end; False where Ctrl-C ended it.

    In this process: its kernels are loaded already, a run leaves nothing behind but its folder, and Ctrl-C
    reaches the training that saves a checkpoint for it.
    """
    resume = run.begun() is not None
    with contextlib.redirect_stdout(sys.stderr):  # standard output is the tables'
        return train(run.asked(resume=resume), again="the same command") is not None


def _subject(study: Study) -> str:
    return study.sequence.root.resolve().name


def _about(study: Study, result: dict[str, Any]) -> list[str]:
    """What was compared, in words.

    Args:
        study: The study.
        result: The scores of any run.
    """
    plan, sequence = study.runs[0].plan, study.sequence
    sizes = " and ".join(f"{width} x {height}" for width, height in plan.sizes)
    seeds = list(dict.fromkeys(run.seed for run in study.runs))
    lines = [
        f"{plan.schedule.steps} steps a run on {len(sequence.train)} training frames of {sizes} pixels, "
        f"preset {plan.settings.preset}; seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}. "
        f"Scores are means over {len(sequence.test)} test frames; PSNR in dB."
    ]
    if "lpips_reason" in result:
        lines.append(f"No LPIPS: {result['lpips_reason']}.")
    if study.regions is None:
        lines.append("No regions: the dataset has no labels (--regions DIR).")
    return lines


def _write(out: Path, study: Study, results: Sequence[dict[str, Any]], table: Table, text: str) -> None:
    """Write the tables and the picture, each whole or not at all."""
    content = {
        **_settings(study),
        "protocol": results[0]["protocol"],
        "runs": [
            {"variant": run.variant, "seed": run.seed, "folder": run.folder.name}
            | {"scores": nested(scores_in(result))}
            for run, result in zip(study.runs, results, strict=True)
        ],
        "variants": as_json(table),
    }
    if table.differences:
        replace_file(out / PICTURE_FILE, encode_png(draw_regions(table)))
    else:
        (out / PICTURE_FILE).unlink(missing_ok=True)  # one of other variants
    replace_file(out / JSON_FILE, json.dumps(content, indent=1))
    replace_file(out / TABLE_FILE, text)


def _settings(study: Study) -> dict[str, Any]:
    """What all runs have in common."""
    plan, record = study.runs[0].plan, read_json(study.runs[0].folder / CONFIG_FILE)
    own = ("out", "seed", "ablate")
    return {
        "subject": _subject(study),
        "settings": {name: value for name, value in plan.settings.as_json().items() if name not in own},
        "steps": plan.schedule.steps,
        "seeds": list(dict.fromkeys(run.seed for run in study.runs)),
        "regions": None if study.regions is None else str(study.regions.absolute()),
        **{name: record[name] for name in ("encoder", "train_frames", "test_frames", "frames_hash")},
    }
