"""The scores of runs as tables: the runs' own, and how far the others are from the first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from samira_warp.ablate.table import DECIMALS, HEADINGS, REGION_HEADINGS, Score
from samira_warp.compare.report import Cell, Table

LOWER_IS_BETTER = ("l1", "lpips")

Scores = Mapping[str, Mapping[Score, float]]
"""By run's name, the first one first."""


def whole_frames(scores: Scores) -> list[Table]:
    """Scores of whole frames and of the foreground, and the differences from the first run's."""
    columns = {HEADINGS[score.name]: score for score in _all(scores) if score.region is None}
    return _tables(scores, columns)


def by_region(scores: Scores) -> dict[str, list[Table]]:
    """By the score's heading: a column for each region; nothing without regions."""
    found = {}
    for name, heading in REGION_HEADINGS.items():
        columns = {
            score.region: score for score in _all(scores) if score.region is not None and score.name == name
        }
        if columns:
            found[heading] = _tables(scores, columns)
    return found


def _all(scores: Scores) -> list[Score]:
    """Every score that some run has, in the order in which they are met."""
    return list(dict.fromkeys(score for own in scores.values() for score in own))


def _tables(scores: Scores, columns: Mapping[str, Score]) -> list[Table]:
    (first, reference), *others = scores.items()
    rows = {
        name: [_cell(own.get(score), score, scores) for score in columns.values()]
        for name, own in scores.items()
    }
    differences = {
        name: [_difference(own.get(score), reference.get(score), score) for score in columns.values()]
        for name, own in others
    }
    return [Table(["run", *columns], rows), Table([f"less {first}", *columns], differences)]


def _cell(value: float | None, score: Score, scores: Scores) -> Cell:
    if value is None:
        return Cell("none")
    decimals = DECIMALS[score.name]
    rounded = [round(own[score], decimals) for own in scores.values() if score in own]
    best = min(rounded) if score.name in LOWER_IS_BETTER else max(rounded)
    # equal as they are printed: none of them is better
    only = len(set(rounded)) > 1
    return Cell(f"{value:.{decimals}f}", best=only and round(value, decimals) == best)


def _difference(value: float | None, reference: float | None, score: Score) -> Cell:
    if value is None or reference is None:
        return Cell("none")
    return Cell(f"{value - reference:+z.{DECIMALS[score.name]}f}")


def missing_lpips(reasons: Sequence[str]) -> str | None:
    """A sentence that says why runs have no LPIPS; None where all have it."""
    said = list(dict.fromkeys(reasons))
    return f"No LPIPS where there is none: {'; '.join(said)}." if said else None
