"""Many pictures of one size in a labelled grid."""

from __future__ import annotations

import math

import numpy as np

from samira_warp.io.images import text_line

_GAP = 0.03
"""Space between the pictures, as a share of their width."""

_LABEL = 0.09
"""Height of the line under a picture, as a share of its width."""

_SMALLEST_LABEL = 14
"""Pixels; letters in a lower line cannot be read."""


def contact_sheet(pictures: list[np.ndarray], labels: list[str], *, columns: int | None = None) -> np.ndarray:
    """Lay pictures (H, W, 3) out by rows, each with its name below it, on white.

    Names that are too long for their picture are cut in the middle.

    Args:
        pictures: At least one; all of one size, display values.
        labels: One name each.
        columns: Pictures in a row; None makes the sheet about as wide as high.

    Returns:
        (rows, columns, 3) float32 display values.
    """
    height, width = pictures[0].shape[:2]
    gap, line = max(round(_GAP * width), 2), max(round(_LABEL * width), _SMALLEST_LABEL)
    cell_height, cell_width = height + line + gap, width + gap
    if columns is None:
        square = round(math.sqrt(len(pictures) * cell_height / cell_width))
        columns = min(max(square, 1), len(pictures))
    rows = math.ceil(len(pictures) / columns)
    sheet = np.ones((rows * cell_height + gap, columns * cell_width + gap, 3), np.float32)
    for index, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        row, column = divmod(index, columns)
        top, left = row * cell_height + gap, column * cell_width + gap
        sheet[top : top + height, left : left + width] = picture
        sheet[top + height : top + height + line, left : left + width] = text_line(
            label, width=width, height=line
        )
    return sheet
