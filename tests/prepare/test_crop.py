"""The head in drawn silhouettes, and the square around it."""

import numpy as np
import pytest

from samira_warp.prepare.crop import Box, Crop, crop_around, find_head, middle, parse_crop
from samira_warp.support.errors import UserError


def silhouette(*, width=160, height=120, x=80, top=20, hair=0):
    """A person: a head of 30 x 40 pixels, a neck of 16 to 10 rows below it, shoulders to the picture's end;
    ``hair`` hides the neck."""
    rows, columns = np.mgrid[:height, :width] + 0.5
    head = ((columns - x) / 15) ** 2 + ((rows - top - 20) / 20) ** 2 < 1
    neck = (np.abs(columns - x) < 8) & (rows > top + 30) & (rows < top + 50)
    shoulders = (np.abs(columns - x) < np.minimum(10 + 8 * (rows - top - 48), 45)) & (rows > top + 48)
    locks = (np.abs(columns - x) < hair) & (rows > top + 20) & (rows < top + 60)
    return (head | neck | shoulders | locks).astype(np.float32)


def test_a_head_ends_at_the_neck():
    box = find_head(silhouette())
    assert (box.left, box.top, box.right) == (65, 20, 95)
    # the chin is at 60, the shoulders begin at 68
    assert 56 <= box.bottom <= 69


def test_a_head_without_shoulders_is_all_of_the_piece():
    assert find_head(silhouette()[:55]) == Box(65, 20, 95, 55)
    rows, columns = np.mgrid[:60, :60] + 0.5
    assert find_head((np.hypot(rows - 30, columns - 30) < 20).astype(float)) == Box(10, 10, 50, 50)


def test_under_long_hair_it_is_the_whole_person():
    box = find_head(silhouette(hair=16))
    assert (box.top, box.bottom) == (20, 120)


def test_small_pieces_do_not_count():
    matte = silhouette()
    matte[2:5, 100:110] = 1.0
    assert find_head(matte) == find_head(silhouette())


def test_what_covers_nothing_has_no_head():
    assert find_head(np.full((10, 10), 0.4)) is None
    assert crop_around([], width=10, height=10) is None


def test_a_picture_that_is_all_covered():
    assert find_head(np.ones((10, 12))) == Box(0, 0, 12, 10)
    assert crop_around([Box(0, 0, 12, 10)], width=12, height=10) == Crop(1, 0, 10)


def test_the_square_is_half_again_as_large_as_the_head_and_about_it():
    assert crop_around([Box(400, 300, 480, 400)], width=1920, height=1080) == Crop(365, 275, 150)


def test_the_square_holds_the_head_wherever_it_goes():
    heads = [Box(400 + 10 * step, 300, 480 + 10 * step, 400) for step in range(20)]
    crop = crop_around(heads, width=1920, height=1080)
    assert crop.x <= 400
    assert crop.x + crop.side >= 480 + 190


@pytest.mark.parametrize(("left", "top"), [(0, 0), (1840, 0), (0, 980), (1840, 980)])
def test_the_square_stays_in_the_picture(left, top):
    crop = crop_around([Box(left, top, left + 80, top + 100)], width=1920, height=1080)
    assert crop.side == 150
    assert 0 <= crop.x <= 1920 - 150
    assert 0 <= crop.y <= 1080 - 150


def test_one_bad_matte_of_many_does_not_widen_the_square():
    heads = [Box(400, 300, 480, 400)] * 30
    assert crop_around([*heads, Box(0, 0, 1920, 1080)], width=1920, height=1080) == crop_around(
        heads, width=1920, height=1080
    )


def test_the_middle_is_the_largest_square():
    assert middle(width=1920, height=1080) == Crop(420, 0, 1080)
    assert middle(width=1080, height=1921) == Crop(0, 420, 1080)


def test_a_crop_is_read_and_checked():
    assert parse_crop("420, 0,1080", width=1920, height=1080) == Crop(420, 0, 1080)
    for text in ("", "1,2", "1,2,3,4", "a,b,c", "1.5,0,10"):
        with pytest.raises(UserError, match=r"^--crop: expected X,Y,SIDE"):
            parse_crop(text, width=100, height=50)
    for text in ("-1,0,10", "0,0,51", "60,0,41", "0,0,0", "0,41,10"):
        with pytest.raises(UserError, match="100 x 50"):
            parse_crop(text, width=100, height=50)


def test_a_crop_takes_its_part():
    picture = np.arange(5 * 7 * 3).reshape(5, 7, 3)
    assert np.array_equal(Crop(2, 1, 3).of(picture), picture[1:4, 2:5])
