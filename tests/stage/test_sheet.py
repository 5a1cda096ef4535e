import numpy as np
import pytest

from samira_warp.io.images import text_line
from samira_warp.stage.sheet import contact_sheet


@pytest.mark.parametrize(
    "text",
    ["studio", "lämp 1", "i", "a name that is far too long to fit under so small a picture", "W" * 300],
)
@pytest.mark.parametrize(("width", "height"), [(64, 14), (256, 23), (20, 14)])
def test_text_is_black_on_white_and_inside(text, width, height):
    line = text_line(text, width=width, height=height)
    assert line.shape == (height, width, 3)
    assert line.dtype == np.float32
    assert line.min() < 0.3
    assert line.mean() > 0.5
    # whole letters: nothing is cut at the strip's upper and lower edge
    assert (line[0] == 1).all()
    assert (line[-1] == 1).all()


def test_long_names_keep_their_ends():
    long = text_line("venice_sunset_over_the_lagoon_4k", width=120, height=20)
    ink = (long < 0.5).any(axis=(0, 2))
    # it fills the strip, but for the room of about one letter
    assert ink[:20].any()
    assert ink[-20:].any()
    shown = np.flatnonzero(ink)
    assert shown[0] >= 0
    assert shown[-1] - shown[0] > 90


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (2, 1), (3, 2), (4, 2), (9, 3), (25, 5)])
def test_pictures_lie_in_rows_in_their_order(count, columns):
    pictures = [np.full((40, 60, 3), index / 30, np.float32) for index in range(count)]
    labels = [f"light {index}" for index in range(count)]
    sheet = contact_sheet(pictures, labels)
    check_order(sheet, pictures, columns)
    check_order(contact_sheet(pictures, labels, columns=4), pictures, 4)


def check_order(sheet, pictures, columns):
    gap, line, count = 2, 14, len(pictures)
    rows = -(-count // columns)
    assert sheet.shape == (rows * (40 + line + gap) + gap, columns * (60 + gap) + gap, 3)
    for index in range(count):
        row, column = divmod(index, columns)
        top, left = gap + row * (40 + line + gap), gap + column * (60 + gap)
        assert (sheet[top : top + 40, left : left + 60] == pictures[index]).all()
    assert (sheet[:gap] == 1).all()
