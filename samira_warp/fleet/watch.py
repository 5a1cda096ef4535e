"""What a fleet shows while it works: a live table on a terminal, lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from samira_warp.fleet.results import in_words, last_metrics
from samira_warp.fleet.stages import Outcome, Stage

MOST_ROWS = 30
"""Stages that the live table has lines for: those at work, then those that failed."""


class Watch:
    """How far all subjects are; `open_watch` shows it."""

    def __init__(self, rows: Sequence[Sequence[Stage]], live: Any) -> None:
        self._rows, self._live = rows, live
        self._done = self._kept = 0
        self._failed: list[tuple[Stage, str]] = []
        self._begun: dict[str, Stage] = {}

    def keep(self, stages: Sequence[Stage]) -> None:
        """Note stages that had finished before."""
        self._kept += len(stages)

    def begin(self, stage: Stage) -> None:
        """Note a stage that waits for a worker from now on."""
        self._begun[stage.subject] = stage

    def end(self, stage: Stage, outcome: Outcome) -> None:
        """Note how a stage ended."""
        del self._begun[stage.subject]
        if outcome.done:
            self._done += 1
        else:
            self._failed.append((stage, outcome.why))
        if self._live is None:
            took = in_words(float(stage.record().get("seconds", 0.0)))
            how = f"done in {took}" if outcome.done else f"failed: {outcome.why}"
            print(f"{stage.subject}: {stage.name} {how}", file=sys.stderr, flush=True)

    def show(self) -> None:
        """Draw the table anew, on a terminal."""
        if self._live is not None:
            self._live.update(self._table(), refresh=True)

    def _table(self) -> Any:
        from rich.table import Table

        total = sum(map(len, self._rows))
        table = Table("subject", "stage", "state", "so far", title=f"{len(self._rows)} subjects")
        working = [(stage, stage.record()) for stage in self._begun.values()]
        working = [(stage, record) for stage, record in working if record.get("state") == "running"]
        for stage, record in working[:MOST_ROWS]:
            table.add_row(stage.subject, stage.name, f"on {record.get('host')}", _so_far(stage))
        for stage, why in self._failed[-max(MOST_ROWS - len(working), 1) :]:
            table.add_row(stage.subject, stage.name, "failed", why, style="red")
        table.caption = (
            f"stages: {self._done + self._kept} of {total} done ({self._kept} before), "
            f"{len(working)} at work, {len(self._begun) - len(working)} waiting, {len(self._failed)} failed"
        )
        return table


def _so_far(stage: Stage) -> str:
    """What a training has reached."""
    line = last_metrics(stage.folder) if stage.name == "train" else {}
    return f"step {line['step']:,}, PSNR {line['psnr']:.2f} dB" if {"step", "psnr"} <= line.keys() else ""


@contextlib.contextmanager
def open_watch(rows: Sequence[Sequence[Stage]]) -> Iterator[Watch]:
    """Show how far all subjects are, on standard error, until the block ends."""
    if not sys.stderr.isatty():
        yield Watch(rows, None)
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        watch = Watch(rows, live)
        yield watch
        watch.show()
