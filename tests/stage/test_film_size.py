"""Films of pictures whose sizes a codec does not hold."""

import imageio_ffmpeg
import numpy as np
import pytest

from samira_warp.stage.video import VideoWriter, film_size


@pytest.mark.parametrize("size", [(32, 32), (33, 32), (32, 35), (255, 17)])
def test_a_film_has_the_size_that_is_said(tmp_path, size):
    width, height = size
    with VideoWriter(tmp_path / "film.mp4", frames_per_second=10) as film:
        film.add(np.zeros((height, width, 3), np.uint8))
    facts = next(imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4")))
    assert facts["size"] == film_size(width, height)
    assert [length - said for length, said in zip(size, film_size(*size), strict=True)] == [
        width % 2,
        height % 2,
    ]


def test_frames_of_another_shape_are_fitted_on_white(tmp_path):
    """A grey portrait frame in a landscape film: its columns where they belong, white beside them."""
    path, grey = tmp_path / "film.mp4", 100
    with VideoWriter(path, frames_per_second=10) as film:
        film.add(np.full((48, 64, 3), grey, np.uint8))
        film.add(np.full((64, 32, 3), grey, np.uint8))  # 24 x 48 in the film
        film.add(np.full((16, 16, 3), grey, np.uint8))  # smaller: not enlarged
    stream = imageio_ffmpeg.read_frames(str(path))
    assert next(stream)["size"] == (64, 48)
    frames = [np.frombuffer(frame, np.uint8).reshape(48, 64, 3) for frame in stream]
    assert len(frames) == 3
    for frame, (rows, columns) in zip(
        frames,
        [((0, 48), (0, 64)), ((0, 48), (20, 44)), ((16, 32), (24, 40))],
        strict=True,
    ):
        inside = np.zeros((48, 64), bool)
        inside[slice(*rows), slice(*columns)] = True
        # half grey is half white; the codec rings at borders, by less than would turn one into the other
        np.testing.assert_array_equal(frame.mean(axis=2) < 178, inside)
