"""A report: paragraphs, tables and pictures, written as HTML or as Markdown."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #202020; background: white;
  margin: 2rem auto; max-width: 70rem; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: 0.25rem 0.75rem; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top; }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
div.wide { overflow-x: auto; }
img { max-width: 100%; height: auto; }
"""


class Cell(NamedTuple):
    """A cell of a table.

    Attributes:
        text: As it is, without markup.
        best: Whether it is the best of its column, which is set in bold.
    """

    text: str
    best: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        columns: Headings of all columns, that of the rows' names first.
        rows: Cells by the row's name.
    """

    columns: Sequence[str]
    rows: Mapping[str, Sequence[Cell]]


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        file: Its name, with a suffix of `MEDIA_TYPES`.
        content: The file.
        says: What is seen in it.
    """

    file: str
    content: bytes
    says: str


@dataclass(frozen=True)
class Section:
    """A heading and what is below it.

    Attributes:
        heading: In a line.
        parts: Paragraphs, tables and pictures, in order.
    """

    heading: str
    parts: Sequence[str | Table | Picture]


@dataclass(frozen=True)
class Report:
    """All of it.

    Attributes:
        title: In a line.
        about: Paragraphs below it.
        sections: In order.
    """

    title: str
    about: Sequence[str]
    sections: Sequence[Section]

    @property
    def pictures(self) -> list[Picture]:
        """All of them, in order."""
        return [part for section in self.sections for part in section.parts if isinstance(part, Picture)]


def as_html(report: Report) -> str:
    """One HTML document that refers to nothing outside it."""
    parts = [f"<h1>{escape(report.title)}</h1>", *(f"<p>{escape(text)}</p>" for text in report.about)]
    for section in report.sections:
        parts.append(f"<h2>{escape(section.heading)}</h2>")
        parts += [_html_part(part) for part in section.parts]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{escape(report.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def as_markdown(report: Report, *, folder: str) -> str:
    """A Markdown document whose pictures lie in a folder beside it.

    Args:
        report: What to write.
        folder: The folder's name.
    """
    blocks = [f"# {_plain(report.title)}", *map(_plain, report.about)]
    for section in report.sections:
        blocks.append(f"## {_plain(section.heading)}")
        blocks += [_markdown_part(part, folder) for part in section.parts]
    return "\n\n".join(blocks) + "\n"


def _html_part(part: str | Table | Picture) -> str:
    if isinstance(part, str):
        return f"<p>{escape(part)}</p>"
    if isinstance(part, Picture):
        return f'<p><img src="{_data_address(part)}" alt="{escape(part.says)}"></p>'
    head = "".join(f"<th>{escape(column)}</th>" for column in part.columns)
    rows = (
        f"<tr><th>{escape(name)}</th>{''.join(_html_cell(cell) for cell in cells)}</tr>"
        for name, cells in part.rows.items()
    )
    return f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _html_cell(cell: Cell) -> str:
    text = escape(cell.text)
    return f"<td>{f'<b>{text}</b>' if cell.best else text}</td>"


def _data_address(picture: Picture) -> str:
    kind = MEDIA_TYPES[picture.file[picture.file.rindex(".") :]]
    return f"data:{kind};base64,{base64.b64encode(picture.content).decode('ascii')}"


def _markdown_part(part: str | Table | Picture, folder: str) -> str:
    if isinstance(part, str):
        return _plain(part)
    if isinstance(part, Picture):
        return f"![{_plain(part.says)}](<{folder}/{part.file}>)"
    lines = [[_plain(column) for column in part.columns]]
    for name, cells in part.rows.items():
        texts = (f"**{_plain(cell.text)}**" if cell.best else _plain(cell.text) for cell in cells)
        lines.append([_plain(name), *texts])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    )


def _plain(text: str) -> str:
    """Text that Markdown shows as it is, in a line."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", " ".join(text.split()))
