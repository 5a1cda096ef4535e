"""Videos as they come: turned, cut off, broken, without pictures."""

import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from stand_ins import HEIGHT, LEFT, SIDE, TOP, WIDTH, filmed

from samira_warp.data.video import Picture, VideoFacts, read_facts, read_pictures
from samira_warp.io.images import read_image
from samira_warp.prepare.crop import Crop
from samira_warp.prepare.frames import Written, frame_name, sampled, thinned, write_frames
from samira_warp.support.errors import UserError


def ffmpeg(*arguments):
    subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y", *map(str, arguments)], check=True
    )


def test_pictures_come_in_their_order_and_colours(video, filmed_dataset):
    pictures = list(read_pictures(video))
    assert len(pictures) == 12
    assert [picture.seconds for picture in pictures] == pytest.approx(
        [number / 25 for number in range(12)], abs=1e-3
    )
    images = sorted((filmed_dataset / "images").iterdir())
    for number, picture in enumerate(pictures):
        # 8-bit YCbCr and a codec of which little is asked: a wrong matrix or range would be wrong by tens
        assert np.abs(picture.pixels().astype(int) - filmed(images[number % len(images)])).mean() < 2.0


def test_facts_are_those_of_the_pictures(video):
    assert read_facts(video) == VideoFacts(WIDTH, HEIGHT, 12)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_video_that_lies_on_its_side_is_put_upright(video, tmp_path, degrees):
    turned = tmp_path / "turned.mp4"
    ffmpeg("-display_rotation", degrees, "-i", video, "-c", "copy", turned)
    ffmpeg("-i", turned, "-frames:v", 1, tmp_path / "upright.png")  # FFmpeg's own program puts it upright
    expected = read_image(tmp_path / "upright.png", channels=3) * 255.0
    upright = next(read_pictures(turned)).pixels()
    assert upright.shape == expected.shape
    assert np.abs(upright - expected).max() <= 3.0
    facts = read_facts(turned)
    assert (facts.width, facts.height) == (upright.shape[1], upright.shape[0])


def test_frames_are_cropped_resized_and_numbered(video, tmp_path):
    crop = Crop(LEFT, TOP, SIDE)
    assert write_frames(
        video, read_facts(video), tmp_path / "images", crop=crop, size=SIDE // 2, fps=None
    ) == (Written(12, 25.0))
    assert sorted(path.name for path in (tmp_path / "images").iterdir()) == [
        frame_name(number) for number in range(12)
    ]
    for number, picture in enumerate(read_pictures(video)):
        kept = picture.pixels()[TOP : TOP + SIDE, LEFT : LEFT + SIDE].astype(float)
        kept = kept.reshape(SIDE // 2, 2, SIDE // 2, 2, 3).mean(axis=(1, 3))
        frame = read_image(tmp_path / "images" / frame_name(number), channels=3) * 255.0
        assert np.abs(frame - kept).max() < 12.0  # JPEG at hard edges
        assert np.abs(frame - kept).mean() < 1.5


def test_a_crop_is_never_enlarged(video, tmp_path):
    write_frames(video, read_facts(video), tmp_path, crop=Crop(0, 0, 30), size=512, fps=None)
    assert read_image(tmp_path / frame_name(0), channels=3).shape == (30, 30, 3)


@pytest.mark.parametrize(
    ("fps", "kept"),
    [
        (None, range(12)),
        (25.0, range(12)),
        (60.0, range(12)),
        (12.5, range(0, 12, 2)),
        (10.0, (0, 3, 5, 8, 10)),
        (5.0, (0, 5, 10)),
        (0.1, (0,)),
    ],
)
def test_fewer_frames_of_a_second(fps, kept):
    pictures = [
        Picture(0.2 + number / 25, None, None) for number in range(12)
    ]  # some videos do not begin at 0
    assert [round(25 * (picture.seconds - 0.2)) for picture in thinned(iter(pictures), fps)] == list(kept)


def test_uneven_pictures_keep_the_mean_rate():
    pictures = [Picture(seconds, None, None) for seconds in (0.0, 0.09, 0.11, 0.19, 0.21, 1.0, 1.01, 1.09)]
    assert [picture.seconds for picture in thinned(iter(pictures), 10.0)] == [0.0, 0.11, 0.21, 1.0, 1.01]


def test_samples_are_spread_over_the_whole_video(video):
    assert len(list(sampled(video, read_facts(video)))) == 12
    assert len(list(sampled(video, VideoFacts(WIDTH, HEIGHT, 32 * 4)))) == 3


def refused(path):
    with pytest.raises(UserError) as caught:
        list(read_pictures(path))
    message = str(caught.value)
    assert message.startswith(f"{path}: expected ")
    assert "\n" not in message
    return message


def test_what_is_no_video_is_refused_by_name(video, tmp_path):
    whole = video.read_bytes()
    assert "no such file" in refused(tmp_path / "none.mp4")
    assert "a folder" in refused(tmp_path)
    for name, content in {
        "text.mp4": b"hello",
        "empty.mp4": b"",
        "cut.mp4": whole[: len(whole) // 2],
    }.items():
        (tmp_path / name).write_bytes(content)
        assert "Invalid data" in refused(tmp_path / name)
    ffmpeg("-f", "lavfi", "-i", "sine=d=1", tmp_path / "sound.m4a")
    assert "only sound" in refused(tmp_path / "sound.m4a")


@pytest.fixture(scope="module")
def long_video(tmp_path_factory):
    """Two seconds of noise with its index before its pictures, as videos for the web have it."""
    path = tmp_path_factory.mktemp("long") / "noise.mp4"
    ffmpeg(
        "-f",
        "lavfi",
        "-i",
        "nullsrc=s=64x64:d=2:r=25,geq=random(1)*255:128:128",
        "-g",
        5,
        "-movflags",
        "faststart",
        path,
    )
    return path


def test_a_video_that_was_cut_off_is_refused(long_video, tmp_path):
    assert len(list(read_pictures(long_video))) == 50
    whole = long_video.read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    assert " after " in refused(tmp_path / "cut.mp4")


def test_a_video_with_broken_pictures_is_refused_or_read_whole(long_video, tmp_path):
    """Never a silent loss: every fault that FFmpeg cannot bridge is said."""
    whole = long_video.read_bytes()
    rng, complaints = np.random.default_rng(0), []
    for trial in range(8):
        broken = bytearray(whole)
        start = rng.integers(len(whole) // 4, len(whole) - 2000)
        broken[start : start + 1000] = rng.bytes(1000)
        path = tmp_path / f"{trial}.mp4"
        path.write_bytes(broken)
        pictures = 0
        try:
            for _ in read_pictures(path):
                pictures += 1
        except UserError as mistake:
            complaints.append(str(mistake))
        else:
            assert pictures >= 45
    assert all(".mp4: expected " in complaint for complaint in complaints)
