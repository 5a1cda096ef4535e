"""All runs of a comparison, decided before the first begins; those that are there must belong to it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

from samira_warp.ablate.config import FULL, AblateConfig, Variant
from samira_warp.check.opening import open_checked
from samira_warp.data import TrackedSequence
from samira_warp.evaluate.folders import labels_path, read_region_names
from samira_warp.io.files import check_writable
from samira_warp.support.errors import UserError
from samira_warp.train.begun import AVATAR_FOLDER, LENGTHS, Begun, check_same, find_begun, read_begun
from samira_warp.train.config import TrainConfig
from samira_warp.train.facts import run_facts
from samira_warp.train.perceptual import PerceptualDistances
from samira_warp.train.plan import TrainPlan, make_plan
from samira_warp.train.run import RESULTS_FILE
from samira_warp.train.settings import DEFAULTS, Settings, check_config, resolve

LABELS = Path("gt", "parse")
"""Where a dataset has label images of its own."""


@dataclass(frozen=True)
class Run:
    """One run: a variant and a seed.

    Attributes:
        variant: What is trained.
        plan: How; its ``settings.out`` is the run's folder.
    """

    variant: Variant
    plan: TrainPlan

    @property
    def seed(self) -> int:
        """Of its random choices."""
        return self.plan.settings.seed

    @property
    def folder(self) -> Path:
        """Where it is, or will be."""
        return self.plan.settings.out

    @property
    def finished(self) -> bool:
        """Whether it has been trained and scored."""
        return (self.folder / RESULTS_FILE).is_file() and (self.folder / AVATAR_FOLDER).is_dir()

    def begun(self) -> Begun | None:
        """The run that is in its folder, None where there is none.

        Raises:
            UserError: What is there is no run that can be kept or go on.
        """
        # a finished run is kept without its checkpoints, too, which are large
        return read_begun(self.folder, None) if self.finished else find_begun(self.folder, resume=True)

    def asked(self, *, resume: bool) -> TrainConfig:
        """The run as `samira_warp.train.train` takes it; none of its options is left to a default."""
        values = {field.name: getattr(self.plan.settings, field.name) for field in fields(Settings)}
        return TrainConfig(**values, resume=resume)


@dataclass(frozen=True)
class Study:
    """What is compared with what.

    Attributes:
        sequence: The dataset.
        distances: The perceptual ones at the size of the runs' images.
        regions: Folder of label images of the test frames, None without regions.
        runs: Seed by seed, the full method first.
    """

    sequence: TrackedSequence
    distances: PerceptualDistances
    regions: Path | None
    runs: tuple[Run, ...]


def open_study(config: AblateConfig) -> Study:
    """Decide every run, and look whether those that are there belong to them; nothing is written.

    Raises:
        UserError: An option is out of its range, the dataset, the labels or the folder cannot be used, or a
            run that is there was begun with other settings or other data.
    """
    if config.seeds < 1:
        raise UserError("--seeds", expected="a positive number", found=config.seeds)
    asked = TrainConfig(
        max_steps=config.max_steps,
        preset=config.preset,
        device=config.device,
        split=config.split,
        flame=config.flame,
        encoder=config.encoder,
        lpips_weights=config.lpips_weights,
    )
    check_config(asked)
    settings = resolve(asked, data=config.data, out=config.out)
    distances = PerceptualDistances.find(settings.preset, settings.lpips_weights)
    if config.out.exists() and not config.out.is_dir():
        raise UserError(config.out, expected="a folder", found="a file")
    check_writable(config.out)
    sequence = open_checked(config.data, split=settings.split, flame=settings.flame)
    regions = _regions(config, sequence)
    variants = dict.fromkeys((FULL, *config.variants))
    runs = tuple(
        _run(settings, variant, DEFAULTS["seed"] + number, sequence)
        for number in range(config.seeds)
        for variant in variants
    )
    study = Study(sequence, distances.at_sizes(runs[0].plan), regions, runs)
    for run in runs:
        _check_begun(run, study)
    return study


def _run(settings: Settings, variant: Variant, seed: int, sequence: TrackedSequence) -> Run:
    own = replace(
        settings,
        out=settings.out / f"{variant}_{seed}",
        seed=seed,
        ablate=() if variant == "full" else (variant,),
    )
    return Run(variant, make_plan(own, sequence, TrainConfig()))


def _check_begun(run: Run, study: Study) -> None:
    """Raise UserError where another run is in a run's folder.

    As for ``train --resume``, but for the length: a run that was extended is not one of its whole length.
    """
    begun = run.begun()
    if begun is None:
        return
    settings = run.plan.settings
    resolve(run.asked(resume=True), data=settings.data, out=run.folder, begun=begun.settings)
    facts = run_facts(run.plan, study.sequence, perceptual=study.distances.learned_from is not None)
    check_same(begun, facts, folder=run.folder, also=LENGTHS)


def _regions(config: AblateConfig, sequence: TrackedSequence) -> Path | None:
    """The folder of labels, which has those of every test frame; None where nobody has any."""
    folder = config.regions or config.data / LABELS
    if not folder.is_dir():
        if config.regions is None:
            return None
        found = "a file" if folder.exists() else "no such folder"
        raise UserError(folder, expected="a folder of label images", found=found)
    read_region_names(folder)
    for index in sequence.test:
        labels_path(folder, sequence.frames[index].name)
    return folder
