"""Squares of pictures: where their pixels come from, and where their points go."""

import numpy as np
import pytest

from samira_warp.vision.crops import Square, cut

SQUARES = [
    Square(60.0, 50.0, 40.0),
    Square(61.3, 47.8, 48.0, roll=0.4),
    Square(58.2, 52.6, 30.0, roll=-2.5, mirrored=True),
    Square(64.0, 48.0, 90.0, roll=1.1),
    Square(28.0, 70.0, 60.0, roll=0.2, mirrored=True),  # crosses the picture's border
]


def blob(x, y, *, width=120, height=96, sigma=3.0):
    """A smooth spot about (x, y), whose centroid is known to a fraction of a pixel."""
    rows, columns = np.indices((height, width)) + 0.5
    return np.rint(255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))).astype(np.uint8)


def centroid(values):
    """In shares of the picture's sides."""
    rows, columns = np.indices(values.shape) + 0.5
    weights = values.astype(np.float64)
    return np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum() / len(values)


@pytest.mark.parametrize("square", SQUARES)
def test_points_come_back(square):
    points = np.random.default_rng(0).uniform(-1.0, 2.0, (20, 2))
    assert np.allclose(square.from_picture(square.to_picture(points)), points, atol=1e-12)
    corners = square.to_picture(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    sides = np.linalg.norm(corners[1:] - corners[0], axis=1)
    assert np.allclose(sides, square.side)


def test_a_roll_turns_clockwise_as_one_sees_it():
    square = Square(0.0, 0.0, 2.0, roll=np.pi / 2)
    assert np.allclose(
        square.to_picture(np.array([1.0, 0.5])), [0.0, 1.0]
    )  # its right is the picture's below


@pytest.mark.parametrize("square", SQUARES)
@pytest.mark.parametrize("size", [24, 64, 192])
def test_pixels_are_where_the_points_say(square, size):
    """A spot's centroid in the cut-out is where `from_picture` puts it.

    Bytes are cut off below, not rounded, and a spot on grey levels has some thousand of them: a tenth of a
    pixel of the picture bounds what that moves.
    """
    place = square.to_picture(np.array([0.45, 0.55]))
    picture = blob(*place, sigma=max(3.0, 1.2 * square.side / size))
    found = square.to_picture(centroid(cut(picture, square, size)))
    assert np.linalg.norm(found - place) < 0.1


def test_shrinking_averages():
    """Stripes of one pixel are grey from afar; a plain bilinear sample at every fourth would keep them."""
    picture = np.zeros((96, 120), np.uint8)
    picture[:, ::2] = 255
    seen = cut(picture, Square(60.0, 48.0, 80.0), 20).astype(float)
    assert abs(seen.mean() - 127.5) < 1.0
    assert seen.std() < 2.0


@pytest.mark.parametrize("roll", [0.0, 0.3])
def test_beyond_the_picture_its_border_goes_on_or_it_is_black(roll):
    picture = np.full((40, 50, 3), 200, np.uint8)
    square = Square(0.0, 20.0, 30.0, roll=roll)
    assert (cut(picture, square, 30) >= 199).all()
    black = cut(picture, square, 30, outside="black")
    assert (black[13:17, :10] == 0).all()
    assert (black[13:17, 20:] >= 199).all()


@pytest.mark.parametrize("square", [Square(-90.0, 20.0, 30.0), Square(25.0, 300.0, 10.0)])
def test_squares_that_miss_the_picture_are_its_border(square):
    picture = np.full((40, 50, 3), 77, np.uint8)
    assert (cut(picture, square, 16) >= 76).all()
    assert cut(picture, square, 16, outside="black").max() == 0
