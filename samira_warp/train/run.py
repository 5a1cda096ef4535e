"""One training run from its configuration to its results."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from samira_warp.avatar import Avatar
from samira_warp.check.opening import open_checked
from samira_warp.data import PixelCache, TrackedSequence
from samira_warp.evaluate import Lpips
from samira_warp.io.files import replace_file, replace_folder
from samira_warp.train.announce import announce
from samira_warp.train.begun import (
    AVATAR_FOLDER,
    CONFIG_FILE,
    Begun,
    check_same,
    find_begun,
    say_other_bits,
)
from samira_warp.train.config import TrainConfig
from samira_warp.train.facts import run_facts
from samira_warp.train.folder import claimed
from samira_warp.train.perceptual import PerceptualDistances
from samira_warp.train.plan import TrainPlan, check_size, make_plan
from samira_warp.train.ranks import Ranks, joined
from samira_warp.train.results import score, summary, write_result
from samira_warp.train.settings import LENGTH, Settings, check_config, resolve
from samira_warp.train.setup import PIXEL_CACHE_BYTES, start
from samira_warp.train.source import find_source
from samira_warp.train.trainer import Trainer

RESULTS_FILE = "results.json"


def train(config: TrainConfig, *, again: str = "the same command and --resume") -> Path | None:
    """Train an avatar, write its run folder and score it on the test frames.

    Everything that can be checked without decoding images is checked before anything is written to the run
    folder; what can be checked without a dataset, before one is made: of the video that ``data`` is, or the
    built-in subject's, where ``data`` is None and it is not there yet.

    Args:
        config: The run as it is asked for.
        again: What goes on with it after an interrupt, for the words that say so.

    Returns:
        The run folder, or None when Ctrl-C ended the run early (a checkpoint was saved).

    Raises:
        UserError: The configuration, the dataset, the video or the run folder cannot be used, another
            training is at work there, or the built-in subject cannot be kept.
    """
    check_config(config)
    out = config.out or Path("runs") / _name(config.data)
    with joined() as ranks, contextlib.ExitStack() as claim:
        ranks.by_first(lambda: claim.enter_context(claimed(out)))
        return _train(config, out, again, ranks)


def _name(data: Path | None) -> str:
    """What a run is called after: a dataset's folder, or a video without its suffix."""
    if data is None:
        return "built_in"
    return data.stem if data.is_file() else data.resolve().name


def _train(config: TrainConfig, out: Path, again: str, ranks: Ranks) -> Path | None:
    """The run, in its folder."""
    begun = ranks.by_first(lambda: find_begun(out, resume=config.resume))
    source = find_source(config.data, begun, out=out)
    settings = _settings(config, source.folder, out, begun, ranks)
    check_size((settings.resolution, settings.resolution), resolution=settings.resolution)
    distances = PerceptualDistances.find(settings.preset, settings.lpips_weights)
    if config.resume and (begun is None or begun.checkpoint is None):
        ranks.say(f"no checkpoint in {out} yet: starting from the beginning")
    if source.make is not None:
        ranks.by_first(source.make)
    sequence = open_checked(settings.data, split=settings.split, flame=settings.flame)
    plan = make_plan(settings, sequence, config, begun=begun)
    distances = distances.at_sizes(plan).to(settings.device)
    perceptual = distances.learned_from is not None
    facts = run_facts(plan, sequence, perceptual=perceptual, ranks=ranks.count)
    if begun is not None and begun.checkpoint is not None:
        check_same(begun, facts, folder=out)
    with PixelCache(
        sequence.frames,
        resolution=settings.resolution,
        max_bytes=PIXEL_CACHE_BYTES,
        pinned=settings.device.startswith("cuda"),
    ) as pixels:
        trainer, record = _at_its_beginning(plan, sequence, pixels, facts, begun, ranks)
        if isinstance(distances.training, Lpips):
            trainer.perceptual = distances.training
        if ranks.first:
            announce(plan, sequence, distances.training, record["encoder"])
            replace_file(out / CONFIG_FILE, json.dumps(record, indent=1))
        if not _run_to_its_end(trainer, record, again):
            return None
        if ranks.first:
            _finish(trainer, distances, record, again)
    return out


def _settings(config: TrainConfig, data: Path, out: Path, begun: Begun | None, ranks: Ranks) -> Settings:
    """Every option's value, on this rank's own device where there are several.

    Raises:
        UserError: As `resolve` does, or the device cannot be divided.
    """
    before = None if begun is None else begun.settings
    if ranks.count > 1 and config.device is None and before is not None:
        before = before | {"device": ranks.device_name(before["device"].partition(":")[0])}
    elif ranks.count > 1:
        config = replace(config, device=ranks.device_name(config.device or "auto"))
    return resolve(config, data=data, out=out, begun=before)


def _at_its_beginning(
    plan: TrainPlan,
    sequence: TrackedSequence,
    pixels: PixelCache,
    facts: dict[str, Any],
    begun: Begun | None,
    ranks: Ranks,
) -> tuple[Trainer, dict[str, Any]]:
    """The trainer where the run begins or goes on, and the record of how the run was begun."""
    if begun is None or begun.checkpoint is None:
        first = start(plan, sequence, pixels)
        record = {**facts, "reference_frame": first.reference, "encoder": first.encoder}
        ranks.take_firsts(list(first.avatar.state_dict().values()))
        first.avatar.set_gaussians(first.avatar.gaussians)
        return Trainer(plan, sequence, pixels, first.avatar, ranks=ranks), record
    avatar = Avatar.load(begun.checkpoint, device=plan.settings.device)
    trainer = Trainer(plan, sequence, pixels, avatar, ranks=ranks)
    trainer.resume(begun.checkpoint)
    if ranks.first:
        say_other_bits(begun, facts)
    return trainer, _going_on(begun, facts)


def _going_on(begun: Begun, facts: dict[str, Any]) -> dict[str, Any]:
    """The record of a run that goes on: as it was begun, with its new length if it has one."""
    settings = begun.record["settings"] | {name: facts["settings"][name] for name in LENGTH}
    lengths = {name: facts[name] for name in ("steps", "earlier_lengths")}
    return (
        begun.record
        if facts["steps"] == begun.schedule.steps
        else begun.record | lengths | {"settings": settings}
    )


def _run_to_its_end(trainer: Trainer, record: dict[str, Any], again: str) -> bool:
    """Train; False where Ctrl-C ended it, which a line says.

    Raises:
        KeyboardInterrupt: It was pressed until the run gave up what it had not saved yet.
    """
    out, steps, say = trainer.plan.settings.out, trainer.plan.schedule.steps, trainer.ranks.say
    if trainer.step == steps:
        say(f"all {steps} steps are done; --max-steps MORE or --epochs MORE extends the run")
    try:
        finished = trainer.run(out, record=record)
    except KeyboardInterrupt:
        say(
            f"given up at step {trainer.step} of {steps}, last saved at {trainer.saved}; "
            f"go on from there with {again}"
        )
        raise
    if not finished:
        say(f"stopped at step {trainer.step} of {steps}; go on with {again}")
    return finished


def _finish(trainer: Trainer, distances: PerceptualDistances, record: dict[str, Any], again: str) -> None:
    """Write the avatar and score it: words on standard error, a JSON line of scores on standard output."""
    settings = trainer.plan.settings
    replace_folder(settings.out / AVATAR_FOLDER, lambda folder: write_result(folder, trainer, record))
    try:
        results = score(
            trainer.avatar, trainer.sequence, trainer.pixels, plan=trainer.plan, distances=distances
        )
    except KeyboardInterrupt:
        print(
            f"the avatar is in {settings.out / AVATAR_FOLDER}, not yet scored; {again} scores it",
            file=sys.stderr,
        )
        raise
    replace_file(settings.out / RESULTS_FILE, json.dumps(results, indent=1))
    print(summary(results, settings), file=sys.stderr)
    print(json.dumps({name: value for name, value in results.items() if name not in ("frames", "protocol")}))
