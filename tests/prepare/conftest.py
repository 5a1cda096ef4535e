import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import pytest
import stand_ins


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
