"""A comparison of runs from its options to its report."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from samira_warp.compare.config import CompareConfig
from samira_warp.compare.curves import draw_curves, knows_time
from samira_warp.compare.frames import Truth, find_truth, render_frames, score_regions, true_picture
from samira_warp.compare.report import Cell, Picture, Report, Section, Table, as_html, as_markdown
from samira_warp.compare.runs import TrainedRun, read_runs
from samira_warp.compare.scores import by_region, missing_lpips, whole_frames
from samira_warp.compare.settings import differing_settings
from samira_warp.compare.sheet import Shown, frames_sheet
from samira_warp.io.files import check_writable, provisional_folder, replace_file
from samira_warp.io.images import encode_png
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError
from samira_warp.train.initialize import spread_out

MOST_PIXELS = 512
"""Longer side of a frame in the sheet, at most."""


def compare(config: CompareConfig) -> Path:
    """Put runs side by side, and write the report.

    Everything is read, rendered and scored before anything is written.

    Returns:
        The report.

    Raises:
        UserError: An option cannot be used, a folder is no finished run, the runs are of different data, or
            a file cannot be read.
    """
    config.check()
    device = pick_device(config.device)
    runs = read_runs(config.runs)
    truth = find_truth(runs, data=config.data, regions=config.regions)
    check_writable(config.out.parent)
    report = make_report(runs, truth, count=config.frames, device=device)
    with provisional_folder(config.out.parent):
        if config.format == "html":
            replace_file(config.out, as_html(report))
        else:
            _write_markdown(config.out, report)
    return config.out


def _write_markdown(out: Path, report: Report) -> None:
    folder = out.with_name(f"{out.stem}_pictures")
    if folder.exists() and not folder.is_dir():
        raise UserError(folder, expected="a folder for the pictures", found="a file")
    with provisional_folder(folder):
        for picture in report.pictures:
            replace_file(folder / picture.file, picture.content)
        replace_file(out, as_markdown(report, folder=folder.name))


def make_report(runs: Sequence[TrainedRun], truth: Truth, *, count: int, device: torch.device) -> Report:
    """The report of runs.

    Args:
        runs: All of the same data.
        truth: Their dataset.
        count: Test frames to show.
        device: Where to render.
    """
    frames, record = runs[0].frames, runs[0].record
    cameras = (frame.camera for run in runs for frame in run.frames)
    sizes = list(dict.fromkeys(f"{camera.width} x {camera.height}" for camera in cameras))
    about = [
        f"Trained on {record.get('subject')}: {record.get('train_frames')} training frames, "
        f"{len(frames)} test frames, of {' and '.join(sizes)} pixels."
    ]
    if len(sizes) > 1:
        about.append("Scores of pictures of different sizes are not to be compared with each other.")
    if truth.missing is not None:
        about.append(f"What was filmed cannot be shown: {truth.missing}.")
    sections = [
        Section("Runs", [_runs_table(runs)]),
        Section("Settings that differ", [_settings_table(runs)]),
        *_score_sections(runs, truth, device),
        Section("Curves", _curves(runs)),
        Section("Test frames", _frames(runs, truth, count=count, device=device)),
    ]
    return Report(" | ".join(run.name for run in runs), about, sections)


def _runs_table(runs: Sequence[TrainedRun]) -> Table:
    rows = {}
    for run in runs:
        last = run.metrics[-1]
        minutes = f"{last['seconds'] / 60.0:.1f}" if knows_time(run) else "not logged"
        texts = (
            f"{run.record['steps']:,}",
            f"{last.get('gaussians', 0):,}",
            minutes,
            str(run.folder.absolute()),
        )
        rows[run.name] = [Cell(text) for text in texts]
    return Table(["run", "steps", "Gaussians at the end", "minutes", "folder"], rows)


def _settings_table(runs: Sequence[TrainedRun]) -> Table | str:
    differing = differing_settings(runs)
    if not differing:
        return "None."
    rows = {name: [Cell(text) for text in texts] for name, texts in differing.items()}
    return Table(["setting", *(run.name for run in runs)], rows)


def _score_sections(runs: Sequence[TrainedRun], truth: Truth, device: torch.device) -> list[Section]:
    reasons = [run.results["lpips_reason"] for run in runs if "lpips_reason" in run.results]
    note = missing_lpips(reasons)
    text = f"Means over the {len(runs[0].frames)} test frames, as training scored them; PSNR in dB."
    tables = whole_frames({run.name: run.scores for run in runs})
    sections = [Section("Scores", [text, *tables, *([] if note is None else [note])])]
    if truth.regions is None:
        return sections
    regions = by_region({run.name: score_regions(run, truth, device=device) for run in runs})
    return sections + [Section(f"{heading} by region", tables) for heading, tables in regions.items()]


def _curves(runs: Sequence[TrainedRun]) -> list[str | Table | Picture]:
    parts: list[str | Table | Picture] = [
        "The loss is the sum of the terms that a run has, so that of runs with other terms is another number."
    ]
    untimed = [run.name for run in runs if not knows_time(run)]
    if untimed:
        parts.append(f"Without the time, which was not logged then: {', '.join(untimed)}.")
    untested = [run.name for run in runs if not any("test_psnr" in line for line in run.metrics)]
    if untested:
        parts.append(f"Without test frames on the way, which were not logged then: {', '.join(untested)}.")
    content = draw_curves(runs).encode("utf-8")
    return [*parts, Picture("curves.svg", content, "loss and PSNR of the runs over steps and minutes")]


def _frames(
    runs: Sequence[TrainedRun], truth: Truth, *, count: int, device: torch.device
) -> list[str | Table | Picture]:
    """The contact sheet, all frames at the largest size that a run was trained at, within bounds."""
    longer = max(max(frame.camera.width, frame.camera.height) for run in runs for frame in run.frames)
    side = min(longer, MOST_PIXELS)
    places = spread_out(range(len(runs[0].frames)), count)
    renderings, names = [], [runs[0].frames[place].name for place in places]
    for run in runs:
        print(f"rendering {run.folder}", file=sys.stderr)
        own = {frame.name: frame for frame in run.frames}
        chosen = [own[name] for name in names]
        chosen = [frame._replace(camera=frame.camera.with_longer_side(side)) for frame in chosen]
        renderings.append(list(render_frames(run, chosen, device=device)))
    shown = []
    for name, *pictures in zip(names, *renderings, strict=True):
        height, width = pictures[0].shape[:2]
        files = None if truth.files is None else truth.files[name]
        true = None if files is None else true_picture(files, width=width, height=height)
        shown.append(Shown(name, true, tuple(pictures)))
    sheet = encode_png(frames_sheet(shown, [run.name for run in runs]))
    text = "Each run under the light that it learned, as it is scored."
    if truth.files is not None:
        text += " Below, the mean absolute difference from what was filmed, in display values, on one scale."
    return [text, Picture("frames.png", sheet, "test frames, their renderings and errors")]
