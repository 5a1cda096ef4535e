"""Mattes by a network with a memory, and by other programs."""

import numpy as np
import pytest
from PIL import Image

from samira_warp.data.pictures import pictures_of
from samira_warp.io.images import read_image, write_png
from samira_warp.prepare import matting
from samira_warp.prepare.frames import write_whole
from samira_warp.support.errors import UserError


class Network:
    """Its mattes are a running mean of the pictures' brightness, and it counts how often it is asked."""

    def __init__(self, stop_after=None):
        self.asked, self.stop_after = 0, stop_after

    def __call__(self, picture, state):
        if self.asked == self.stop_after:
            raise KeyboardInterrupt
        self.asked += 1
        alpha = picture.mean(axis=2, dtype=np.float32) / 255.0
        alpha = alpha if state[0] is None else 0.5 * (state[0] + alpha)
        return alpha, [alpha, None, None, None]


@pytest.fixture
def frames(tmp_path):
    (tmp_path / "images").mkdir()
    rng = np.random.default_rng(1)
    for number in range(25):
        write_whole(tmp_path / "images" / f"{number:06d}.jpg", rng.random((8, 8, 3)))
    return pictures_of(tmp_path / "images")


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr(matting, "CHUNK", 10)
    monkeypatch.setattr(matting, "WARM_UP", 3)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_every_frame_gets_a_grey_matte_of_its_name(frames, tmp_path):
    network = Network()
    matting.write_mattes(network, frames, tmp_path / "mattes")
    assert set(contents(tmp_path / "mattes")) == {path.name for path in frames.values()}
    assert Image.open(tmp_path / "mattes" / "000000.jpg").mode == "L"
    # each of three chunks is begun with three pictures before it
    assert network.asked == 25 + 3 * 3


def test_the_first_matte_is_that_of_a_film_that_stood_still_before(frames, tmp_path):
    matting.write_mattes(Network(), frames, tmp_path / "mattes")
    first = read_image(tmp_path / "mattes" / "000000.jpg", channels=1)
    expected = read_image(frames["000000"], channels=3).mean(axis=2, keepdims=True)
    assert np.abs(first - expected).max() < 3 / 255


@pytest.mark.parametrize("stop_after", [0, 1, 5, 13, 17, 30])
def test_an_interrupted_run_goes_on_to_the_same_mattes(frames, tmp_path, stop_after):
    matting.write_mattes(Network(), frames, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        matting.write_mattes(Network(stop_after), frames, tmp_path / "parts")
    assert not list((tmp_path / "parts").glob(".*"))
    (tmp_path / "parts" / ".000011.jpg").write_bytes(b"what a killed process leaves")
    again = Network()
    matting.write_mattes(again, frames, tmp_path / "parts")
    assert contents(tmp_path / "whole") == contents(tmp_path / "parts")
    assert again.asked <= 34 - 13 * (stop_after // 13)


def test_a_run_that_is_done_asks_nothing(frames, tmp_path):
    matting.write_mattes(Network(), frames, tmp_path / "mattes")
    again = Network()
    matting.write_mattes(again, frames, tmp_path / "mattes")
    assert again.asked == 0


def test_a_still_is_looked_at_until_the_network_has_warmed_up():
    network = Network()
    matting.matte_still(network, np.zeros((4, 4, 3), np.uint8))
    assert network.asked == 3


def test_mattes_of_another_program_may_be_alpha_or_brightness_at_any_size(frames, tmp_path):
    rng = np.random.default_rng(2)
    (tmp_path / "given").mkdir()
    expected = {}
    for number, name in enumerate(frames):
        coverage = rng.random((16, 16))
        grey, straight = coverage[..., None], np.dstack([rng.random((16, 16, 3)), coverage])
        write_png(tmp_path / "given" / f"{name}.PNG", straight if number % 2 else grey)
        expected[name] = coverage.reshape(8, 2, 8, 2).mean(axis=(1, 3))
    matting.copy_mattes(tmp_path / "given", frames, tmp_path / "mattes")
    for name, coverage in expected.items():
        matte = read_image(tmp_path / "mattes" / f"{name}.jpg", channels=1)[..., 0]
        assert np.abs(matte - coverage).max() < 5 / 255


def test_a_frame_without_a_matte_is_named(frames, tmp_path):
    (tmp_path / "given").mkdir()
    with pytest.raises(
        UserError, match=r"given: expected a matte of every frame, as 000000.png, found 0 pictures"
    ):
        matting.copy_mattes(tmp_path / "given", frames, tmp_path / "mattes")


def test_a_matte_of_another_shape_is_refused(frames, tmp_path):
    (tmp_path / "given").mkdir()
    write_png(tmp_path / "given" / "000000.png", np.ones((8, 16)))
    with pytest.raises(
        UserError, match=r"given.000000.png: expected the shape of .*000000.jpg \(8 x 8\), found 16 x 8"
    ):
        matting.copy_mattes(tmp_path / "given", frames, tmp_path / "mattes")


def test_opaque_mattes_cover_everything(frames, tmp_path):
    matting.write_opaque(frames, tmp_path / "mattes")
    assert all((read_image(path, channels=1) == 1.0).all() for path in (tmp_path / "mattes").iterdir())
    assert len(contents(tmp_path / "mattes")) == 25


@pytest.mark.parametrize(
    "fault",
    [
        OSError("no route\nto host"),
        ImportError("operator torchvision::nms does not exist"),
        RuntimeError("Missing dependencies"),
    ],
)
def test_what_keeps_the_network_away_is_said_on_one_line(monkeypatch, fault):
    def fail(*arguments, **options):
        raise fault

    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr("torch.hub.load", fail)
    with pytest.raises(matting.MattingMissing) as missing:
        matting.load_matting("cpu")
    assert str(missing.value) == f"{type(fault).__name__}: {' '.join(str(fault).split())}"


def test_without_torchvision_nothing_is_fetched(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("torch.hub.load", lambda *_, **__: pytest.fail("fetched"))
    with pytest.raises(matting.MattingMissing, match="torchvision is not installed"):
        matting.load_matting("cpu")
