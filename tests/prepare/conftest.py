import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import pytest
import stand_ins


@pytest.fixture(scope="session")
def video(tiny_dataset, tmp_path_factory):
    """Twelve pictures of 96 x 64 pixels, half a second."""
    return stand_ins.write_video(tmp_path_factory.mktemp("video") / "me, talking.mp4", tiny_dataset)


@pytest.fixture
def vhap(tmp_path):
    return stand_ins.make_vhap(tmp_path / "VHAP")
