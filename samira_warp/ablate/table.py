"""From the scores of single runs to tables: means, spreads, and differences from the full method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from samira_warp.ablate.config import FULL

HEADINGS = {
    "psnr": "PSNR",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "l1": "L1 x 100",
    "psnr_foreground": "PSNR of the foreground",
}
"""Scores of whole frames, as the tables call them."""

REGION_HEADINGS = {"psnr": "PSNR", "ssim": "SSIM"}
"""Scores of regions."""

DECIMALS = {"psnr": 2, "ssim": 4, "lpips": 4, "l1": 3, "psnr_foreground": 2}

WITHIN = "within the spread"

_ONE_SEED = (
    "One seed: the spread over seeds is not known, and so neither is which differences are more than chance."
)
_SEVERAL_SEEDS = (
    "After ± stands the sample standard deviation over seeds; after ± of a difference of means, that of the "
    "difference of two runs, one of each: the root of 2 times the pooled variance of both. A difference that "
    f"is not larger is said to be {WITHIN}."
)


class Score(NamedTuple):
    """A column: what is scored, and where; the whole frame where ``region`` is None."""

    name: str
    region: str | None = None


@dataclass(frozen=True)
class Summary:
    """A score over seeds.

    Attributes:
        mean: Over ``count`` seeds.
        spread: Sample standard deviation, None of one seed.
        count: At least 1.
    """

    mean: float
    spread: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        """The summary of at least one value."""
        count, mean = len(values), math.fsum(values) / len(values)
        if count == 1:
            return cls(mean, None, count)
        return cls(mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (count - 1)), count)


@dataclass(frozen=True)
class Difference:
    """How far a variant is from the full method.

    Attributes:
        mean: The variant's mean less the full method's.
        spread: The root of 2 times the pooled variance, None where neither has more than one seed.
    """

    mean: float
    spread: float | None

    @classmethod
    def between(cls, variant: Summary, full: Summary) -> Difference:
        """The difference of two scores over seeds."""
        freedom = variant.count + full.count - 2
        if freedom == 0:
            return cls(variant.mean - full.mean, None)
        squares = sum((one.count - 1) * (one.spread or 0.0) ** 2 for one in (variant, full))
        return cls(variant.mean - full.mean, math.sqrt(2.0 * squares / freedom))

    @property
    def within_spread(self) -> bool | None:
        """Whether seeds alone may make as large a difference; None where that is not known."""
        return None if self.spread is None else abs(self.mean) <= self.spread


@dataclass(frozen=True)
class Table:
    """All scores of all variants.

    Attributes:
        seeds: How many runs each variant has.
        summaries: By variant, the full method first.
        differences: By variant, without the full method.
    """

    seeds: int
    summaries: Mapping[str, Mapping[Score, Summary]]
    differences: Mapping[str, Mapping[Score, Difference]]

    @property
    def scores(self) -> list[Score]:
        """Those that the full method has, in the order of HEADINGS, then region by region."""
        return list(self.summaries[FULL])


def scores_in(result: Mapping[str, Any]) -> dict[Score, float]:
    """The scores of one run that there are.

    Args:
        result: As `samira_warp.evaluate.evaluate_images` gives it.
    """
    found = {Score(name): result.get(name) for name in HEADINGS}
    for region, scores in result.get("regions", {}).items():
        found |= {Score(name, region): scores.get(name) for name in REGION_HEADINGS}
    return {score: value for score, value in found.items() if value is not None}


def tabulate(runs: Mapping[str, Sequence[Mapping[Score, float]]]) -> Table:
    """Means, spreads and differences.

    Args:
        runs: The scores of each variant's runs, one a seed; ``full`` is among the variants. A score that a
            run lacks, as that of a region that no frame shows, is left out of its mean.
    """
    summaries = {}
    for variant, scored in runs.items():
        names = dict.fromkeys(score for scores in scored for score in scores)
        summaries[variant] = {
            name: Summary.of([scores[name] for scores in scored if name in scores]) for name in names
        }
    full = summaries[FULL]
    differences = {
        variant: {
            name: Difference.between(summary, full[name]) for name, summary in own.items() if name in full
        }
        for variant, own in summaries.items()
        if variant != FULL
    }
    return Table(len(runs[FULL]), summaries, differences)


def as_json(table: Table) -> dict[str, Any]:
    """By variant: means and spreads of the scores and, but for the full method, of the differences."""
    variants = {
        variant: {"scores": nested({score: vars(summary) for score, summary in own.items()})}
        for variant, own in table.summaries.items()
    }
    for variant, own in table.differences.items():
        variants[variant]["differences"] = nested(
            {score: vars(one) | {"within_spread": one.within_spread} for score, one in own.items()}
        )
    return variants


def nested(values: Mapping[Score, Any]) -> dict[str, Any]:
    """Values by the names of whole frames' scores, and under ``regions`` by region and name."""
    result: dict[str, Any] = {score.name: value for score, value in values.items() if score.region is None}
    regions: dict[str, dict[str, Any]] = {}
    for score, value in values.items():
        if score.region is not None:
            regions.setdefault(score.region, {})[score.name] = value
    return result | ({"regions": regions} if regions else {})


def markdown(table: Table, *, title: str, about: Sequence[str]) -> str:
    """The tables in Markdown: scores, then differences, of whole frames and of regions.

    Args:
        table: The scores.
        title: A heading.
        about: Sentences below it, a paragraph each.
    """
    blocks = [f"# {title}", *about, _ONE_SEED if table.seeds == 1 else _SEVERAL_SEEDS]
    for heading, columns in _sections(table).items():
        rows = {
            variant: [_scored(own.get(score), score) for score in columns.values()]
            for variant, own in table.summaries.items()
        }
        blocks += [f"## {heading}", _aligned(list(columns), rows)]
        rows = {
            variant: [_differing(own.get(score), score) for score in columns.values()]
            for variant, own in table.differences.items()
        }
        if rows:
            blocks += [f"## {heading}: difference from {FULL}", _aligned(list(columns), rows)]
    return "\n\n".join(blocks) + "\n"


def _sections(table: Table) -> dict[str, dict[str, Score]]:
    """Tables by heading: their columns' headings and scores."""
    whole = {HEADINGS[score.name]: score for score in table.scores if score.region is None}
    sections = {"Whole frame": whole}
    for name, heading in REGION_HEADINGS.items():
        regions = {
            score.region: score for score in table.scores if score.region is not None and score.name == name
        }
        if regions:
            sections[f"{heading} by region"] = regions
    return sections


def _scored(summary: Summary | None, score: Score) -> str:
    if summary is None:
        return "none"
    decimals = DECIMALS[score.name]
    spread = "" if summary.spread is None else f" ± {summary.spread:.{decimals}f}"
    return f"{summary.mean:.{decimals}f}{spread}"


def _differing(difference: Difference | None, score: Score) -> str:
    if difference is None:
        return "none"
    decimals = DECIMALS[score.name]
    spread = "" if difference.spread is None else f" ± {difference.spread:.{decimals}f}"
    return f"{difference.mean:+z.{decimals}f}{spread}" + (f", {WITHIN}" if difference.within_spread else "")


def _aligned(columns: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    """A Markdown table whose columns are as wide as their widest cell, to be read as text as well."""
    lines = [["variant", *columns], *([name, *cells] for name, cells in rows.items())]
    lines = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    )
