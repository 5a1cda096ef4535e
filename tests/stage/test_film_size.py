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
