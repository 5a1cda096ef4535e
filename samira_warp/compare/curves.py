"""What runs have logged as curves, over steps and over time: a picture in SVG."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, NamedTuple

from samira_warp.ablate.picture import COLORS
from samira_warp.compare.runs import TrainedRun

PANELS: dict[str, tuple[str, Literal["linear", "log"]]] = {
    "loss": ("loss", "log"),
    "psnr": ("PSNR of training frames, dB", "linear"),
    "test_psnr": ("PSNR of a few test frames, dB", "linear"),
}
"""Numbers of metrics.jsonl that are drawn, with their titles and scales."""

WIDTH, HEIGHT, LEFT, TOP, GAP, BELOW = 430, 190, 62, 30, 26, 40
"""Pixels: a panel, and what is left of it for its scale, above it for its title, beside it, and below it for
the axis."""

LINE, LETTER = 22, 7.5
"""Pixels: from line to line of the legend, and about the width of a letter."""

INK, GRID = "#202020", "#dddddd"

MINUTE = 60.0


class Curve(NamedTuple):
    """One number of one run.

    Attributes:
        color: As the legend has it.
        points: Places along the axis and values, in order.
    """

    color: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Panel:
    """Curves on one pair of axes.

    Attributes:
        title: What is drawn.
        along: What runs along the horizontal axis.
        scale: Of the vertical axis.
        curves: At least one, each with a point or more.
    """

    title: str
    along: str
    scale: Literal["linear", "log"]
    curves: tuple[Curve, ...]


def draw_curves(runs: Sequence[TrainedRun]) -> str:
    """The curves of runs, a colour each, as an SVG document: over steps, and beside that over minutes.

    A run that did not log what a panel shows is not in it, and a panel without any run is left out.
    """
    names = {run.name: COLORS[number % len(COLORS)] for number, run in enumerate(runs)}
    rows = [row for row in (_row(runs, list(names.values()), name) for name in PANELS) if row]
    width = 2 * (LEFT + WIDTH + GAP)
    legend = list(_legend(names, width))
    top = legend[-1].bottom
    height = top + len(rows) * (TOP + HEIGHT + BELOW)
    parts = [line.text for line in legend]
    for number, row in enumerate(rows):
        for column, panel in row.items():
            x = LEFT + column * (LEFT + WIDTH + GAP)
            parts.append(_panel(panel, x=x, y=top + number * (TOP + HEIGHT + BELOW) + TOP))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="sans-serif" font-size="13" fill="{INK}">'
        f'<rect width="{width}" height="{height}" fill="white"/>{"".join(parts)}</svg>'
    )


def knows_time(run: TrainedRun) -> bool:
    """Whether a run logged the time of all its lines."""
    return all(_number(line.get("seconds")) for line in run.metrics)


def _row(runs: Sequence[TrainedRun], colors: Sequence[str], name: str) -> dict[int, Panel]:
    """The panels of one number by their column: over steps, over minutes."""
    title, scale = PANELS[name]
    panels = {}
    for column, (along, key, unit) in enumerate((("steps", "step", 1.0), ("minutes", "seconds", MINUTE))):
        curves = tuple(
            Curve(color, points)
            for run, color in zip(runs, colors, strict=True)
            if (key == "step" or knows_time(run))
            and (points := _points(run, name, key, unit, positive=scale == "log"))
        )
        if curves:
            panels[column] = Panel(title, along, scale, curves)
    return panels


def _points(
    run: TrainedRun, name: str, key: str, unit: float, *, positive: bool
) -> tuple[tuple[float, float], ...]:
    return tuple(
        (line[key] / unit, float(line[name]))
        for line in run.metrics
        if _number(line.get(name)) and (line[name] > 0.0 or not positive)
    )


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


class _Line(NamedTuple):
    """A part of the legend, and where what follows may begin."""

    text: str
    bottom: int


def _legend(names: dict[str, str], width: int) -> Iterator[_Line]:
    """Name after name beside its colour, in lines."""
    x, y = 14.0, LINE
    for name, color in names.items():
        wide = 44.0 + LETTER * len(name)
        if x > 14.0 and x + wide > width:
            x, y = 14.0, y + LINE
        yield _Line(
            f'<line x1="{x}" y1="{y - 4}" x2="{x + 22}" y2="{y - 4}" stroke="{color}" stroke-width="3"/>'
            f'<text x="{x + 28}" y="{y}">{escape(name)}</text>',
            y + LINE // 2,
        )
        x += wide


def _panel(panel: Panel, *, x: int, y: int) -> str:
    """A panel whose frame has its upper left corner at x, y."""
    values = [value for curve in panel.curves for _, value in curve.points]
    ticks = log_ticks(values) if panel.scale == "log" else linear_ticks(values)
    places = linear_ticks([0.0, *(place for curve in panel.curves for place, _ in curve.points)])
    last = max(place for curve in panel.curves for place, _ in curve.points) or 1.0
    places = [place for place in places if place <= last]

    def right(place: float) -> float:
        return x + WIDTH * place / last

    def down(value: float) -> float:
        low, high, at = (math.log(v) if panel.scale == "log" else v for v in (ticks[0], ticks[-1], value))
        return y + HEIGHT * (high - at) / (high - low)

    parts = [f'<text x="{x}" y="{y - 10}" font-weight="bold">{panel.title}, over {panel.along}</text>']
    for tick in ticks:
        parts.append(_rule(x, down(tick), x + WIDTH, down(tick)))
        parts.append(f'<text x="{x - 8}" y="{down(tick) + 4:.1f}" text-anchor="end">{_said(tick)}</text>')
    for place in places:
        parts.append(_rule(right(place), y, right(place), y + HEIGHT))
        parts.append(
            f'<text x="{right(place):.1f}" y="{y + HEIGHT + 18}" text-anchor="middle">{_said(place)}</text>'
        )
    for color, points in panel.curves:
        drawn = " ".join(f"{right(place):.1f},{down(value):.1f}" for place, value in points)
        parts.append(
            f'<polyline points="{drawn}" fill="none" stroke="{color}" stroke-width="1.6" '
            'stroke-linejoin="round"/>'
        )
        if len(points) <= 40:  # few enough to be told apart; a single one is no line
            dots = (
                f'<circle cx="{right(place):.1f}" cy="{down(value):.1f}" r="2.6"/>' for place, value in points
            )
            parts.append(f'<g fill="{color}">{"".join(dots)}</g>')
    return f"<g>{''.join(parts)}</g>"


def _rule(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{GRID}"/>'


def linear_ticks(values: Sequence[float]) -> list[float]:
    """Round numbers, evenly spaced, about six of them, that reach round all values."""
    low, high = min(values), max(values)
    rough = max(high - low, 1e-3 * max(abs(high), abs(low), 1e-3)) / 5.0
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1.0, 2.0, 5.0, 10.0) if unit * factor >= 0.999 * rough)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [step * number for number in range(first, max(last, first + 1) + 1)]


def log_ticks(values: Sequence[float]) -> list[float]:
    """1, 2 and 5 times powers of ten that reach round all values, which are positive."""
    low, high = min(values), max(values)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)
    steps = [factor * 10.0**power for power in powers for factor in (1.0, 2.0, 5.0)]
    first = max(number for number, step in enumerate(steps) if step <= low * (1.0 + 1e-9))
    last = min(number for number, step in enumerate(steps) if step >= high * (1.0 - 1e-9))
    return steps[first : max(last, first + 1) + 1]


def _said(value: float) -> str:
    """A tick's number, without what floating point adds to it."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.4g}"
