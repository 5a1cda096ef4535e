import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import films
import pytest
import stand_ins

from samira_warp.support.errors import UserError
from samira_warp.vision.mattes import load_segmentation
from samira_warp.vision.networks import FaceNetworks


@pytest.fixture(scope="session")
def filmed_dataset(built_in_datasets):
    """What is known of the subject in the video."""
    return built_in_datasets["VHAP export"]


@pytest.fixture(scope="session")
def video(filmed_dataset, tmp_path_factory):
    """Twelve pictures of 144 x 96 pixels, half a second."""
    return stand_ins.write_video(tmp_path_factory.mktemp("video") / "me, talking.mp4", filmed_dataset)


@pytest.fixture
def vhap(filmed_dataset, tmp_path):
    return stand_ins.make_vhap(tmp_path / "VHAP", filmed_dataset)


@pytest.fixture(scope="session")
def track_networks():
    """Has the networks fetched that the package's own tracker needs."""
    try:
        FaceNetworks.load()
        load_segmentation()
    except UserError as fault:
        pytest.skip(f"the networks of faces and mattes cannot be had: {fault}")


@pytest.fixture(scope="session")
def taken(track_networks, made_once):
    """A second of the built-in subject, 256 x 256, in which it blinks, and what is known of it."""
    return films.read_taken(made_once("taken", films.write_taken))


@pytest.fixture(scope="session")
def film(taken, tmp_path_factory):
    """The same as a video of 600 x 290 pixels."""
    pictures = [films.placed(picture) for picture in taken.pictures]
    return films.write_film(tmp_path_factory.mktemp("film") / "me.mp4", pictures)
