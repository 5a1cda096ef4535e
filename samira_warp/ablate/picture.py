"""The differences in PSNR from the full method as a picture: a dot a variant, region by region."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from samira_warp.ablate.table import Difference, Table
from samira_warp.io.images import resize_box, to_uint8

COLORS = (
    "#332288",
    "#88ccee",
    "#44aa99",
    "#117733",
    "#999933",
    "#ddcc77",
    "#cc6677",
    "#882255",
    "#aa4499",
    "#777777",
)
"""Told apart by those who see few colours, too: Paul Tol's muted scheme and a grey."""

WHOLE_FRAMES = {"psnr": "whole frame", "psnr_foreground": "foreground"}
"""Groups before those of the regions."""

_INK, _GRID, _BAND = "#202020", "#d8d8d8", "#f5f5f5"
_HEIGHT, _MARGIN, _LEFT, _LINE = 400, 16, 64, 24
"""Pixels: the plot's height, what is left round all, room for the scale's numbers, from line to line of
text."""

_STEP, _DOT, _CAP = 15, 4.5, 4
"""Pixels: from dot to dot of a group, from a dot's middle to its edge, half the cap of a bar."""

_LEAST_WIDTH = 560
"""Pixels; below it the title does not fit."""


def draw_regions(table: Table) -> np.ndarray:
    """Draw a table's differences: of the whole frame, the foreground and every region, in this order.

    A group of dots a place, in the order of the legend, on a scale that has the full method at 0. Bars show
    the differences' spreads, where those are known.

    Args:
        table: With at least one variant beside the full method.

    Returns:
        (H, W, 3) uint8 display values.
    """
    groups, names = _groups(table), list(table.differences)
    plot = _Plot.of(groups, names)
    canvas = _Canvas(plot.width, plot.bottom + 2 * _LINE + _MARGIN)
    _draw_legend(canvas, names, columns=plot.columns, column=plot.column)
    _draw_scale(canvas, plot, bands=len(groups))
    for number, (name, differences) in enumerate(groups.items()):
        middle = _LEFT + plot.group * (number + 0.5)
        canvas.text((middle, plot.bottom + _LINE / 2), name, anchor="mm")
        _draw_differences(canvas, plot, differences, middle)
    canvas.text((_LEFT, plot.bottom + 1.5 * _LINE), _footnote(table), anchor="lm")
    return canvas.pixels()


class _Plot(NamedTuple):
    """Where everything is; pixels.

    Attributes:
        width: Of the whole picture.
        group: Width of a group of dots.
        columns: Of the legend.
        column: Width of one of them.
        top: Of the plot, the last tick's height.
        ticks: Numbers of the scale, rising.
    """

    width: int
    group: int
    columns: int
    column: int
    top: int
    ticks: list[float]

    @classmethod
    def of(cls, groups: Mapping[str, Sequence[Difference | None]], names: Sequence[str]) -> _Plot:
        least = max(_STEP * (len(names) + 1), *(_Canvas.wide(name) + _MARGIN for name in groups))
        group = max(least, (_LEAST_WIDTH - _LEFT - _MARGIN) // len(groups))
        column = max(map(_Canvas.wide, names)) + 4 * _MARGIN
        columns = max(group * len(groups) // column, 1)
        return cls(
            width=_LEFT + group * len(groups) + _MARGIN,
            group=group,
            columns=columns,
            column=column,
            top=2 * _MARGIN + (1 + math.ceil(len(names) / columns)) * _LINE,
            ticks=_ticks([one for differences in groups.values() for one in differences if one]),
        )

    @property
    def bottom(self) -> int:
        return self.top + _HEIGHT

    def height_of(self, value: float) -> float:
        """Where a number of the scale is, from the top."""
        return self.top + _HEIGHT * (self.ticks[-1] - value) / (self.ticks[-1] - self.ticks[0])


def _draw_legend(canvas: _Canvas, names: Sequence[str], *, columns: int, column: int) -> None:
    canvas.text((_LEFT, _MARGIN + _LINE / 2), "PSNR less that of the full method, dB", anchor="lm")
    for number, name in enumerate(names):
        x, y = _LEFT + number % columns * column, _MARGIN + (1.5 + number // columns) * _LINE
        canvas.dot((x + _DOT, y), _color(number))
        canvas.text((x + _MARGIN, y), name, anchor="lm")


def _draw_scale(canvas: _Canvas, plot: _Plot, *, bands: int) -> None:
    """Every other group on grey, lines at the ticks, a dark one at 0."""
    for number in range(0, bands, 2):
        left = _LEFT + plot.group * number
        canvas.box((left, plot.top, left + plot.group, plot.bottom), _BAND)
    for tick in plot.ticks:
        y = plot.height_of(tick)
        canvas.line((_LEFT, y, plot.width - _MARGIN, y), _INK if tick == 0.0 else _GRID)
        canvas.text((_LEFT - 8, y), "0" if tick == 0.0 else f"{tick:+.4g}", anchor="rm")


def _draw_differences(
    canvas: _Canvas, plot: _Plot, differences: Sequence[Difference | None], middle: float
) -> None:
    """The dots of one group with their bars, side by side about x."""
    for place, difference in enumerate(differences):
        if difference is None:
            continue
        x, color = middle + _STEP * (place - 0.5 * (len(differences) - 1)), _color(place)
        if difference.spread is not None:
            ends = [plot.height_of(difference.mean + sign * difference.spread) for sign in (-1, 1)]
            canvas.line((x, ends[0], x, ends[1]), color)
            for end in ends:
                canvas.line((x - _CAP, end, x + _CAP, end), color)
        canvas.dot((x, plot.height_of(difference.mean)), color)


def _groups(table: Table) -> dict[str, list[Difference | None]]:
    """Differences in PSNR by place, a variant each; None where a variant has none."""
    places = {score: WHOLE_FRAMES.get(score.name) for score in table.scores if score.region is None}
    places |= {score: score.region for score in table.scores if score.region and score.name == "psnr"}
    # a region may be called as the whole frame is
    taken = [name for name in places.values() if name is not None]
    return {
        f"{name} (region)" if score.region and taken.count(name) > 1 else name: [
            own.get(score) for own in table.differences.values()
        ]
        for score, name in places.items()
        if name is not None
    }


def _footnote(table: Table) -> str:
    if table.seeds == 1:
        return "One seed: the spread over seeds is not known."
    return f"Bars: spread of the difference of two runs, one of each, over {table.seeds} seeds."


def _color(number: int) -> str:
    return COLORS[number % len(COLORS)]


def _ticks(differences: Sequence[Difference]) -> list[float]:
    """Round numbers, evenly spaced, 0 among them, that span all differences with their spreads."""
    reach = [
        difference.mean + sign * (difference.spread or 0.0) for difference in differences for sign in (-1, 1)
    ]
    low, high = min(0.0, *reach), max(0.0, *reach)
    rough = max(high - low, 0.01) / 6.0
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1.0, 2.0, 5.0, 10.0) if unit * factor >= rough)
    # a dot on the frame of the plot would be cut in half
    first, last = math.floor(low / step - 0.1), math.ceil(high / step + 0.1)
    return [step * number for number in range(first, last + 1)]


class _Canvas:
    """White paper: everything is drawn on a grid several times as fine, and averaged."""

    _FINE = 3
    _FONT = 15

    def __init__(self, width: int, height: int) -> None:
        self._size = (width, height)
        self._image = Image.new("RGB", (self._FINE * width, self._FINE * height), "white")
        self._draw = ImageDraw.Draw(self._image)
        self._font = ImageFont.load_default(self._FINE * self._FONT)

    @classmethod
    def wide(cls, text: str) -> int:
        """Pixels that a line of text takes."""
        return math.ceil(ImageFont.load_default(cls._FONT).getlength(text))

    def line(self, ends: Sequence[float], color: str) -> None:
        """From x, y to x, y, a pixel and a third thick."""
        self._draw.line([self._FINE * value for value in ends], fill=color, width=self._FINE + 1)

    def box(self, corners: Sequence[float], color: str) -> None:
        """From x, y to x, y, filled."""
        self._draw.rectangle([self._FINE * value for value in corners], fill=color)

    def dot(self, middle: tuple[float, float], color: str) -> None:
        """A disc about x, y."""
        x, y = middle
        edges = (x - _DOT, y - _DOT, x + _DOT, y + _DOT)
        self._draw.ellipse([self._FINE * value for value in edges], fill=color)

    def text(self, place: tuple[float, float], text: str, *, anchor: str) -> None:
        """A line of text at x, y, which is where the two letters of ``anchor`` say, as Pillow has them."""
        x, y = (self._FINE * value for value in place)
        self._draw.text((x, y), text, fill=_INK, font=self._font, anchor=anchor)

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8."""
        width, height = self._size
        values = np.asarray(self._image, np.float32) / 255.0
        return to_uint8(resize_box(values, width=width, height=height))
