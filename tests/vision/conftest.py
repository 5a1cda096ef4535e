import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import pytest

from samira_warp.support.errors import UserError
from samira_warp.vision.mattes import load_segmentation
from samira_warp.vision.networks import FaceNetworks


@pytest.fixture(scope="session")
def networks():
    """The networks that look at faces, as the package fetches them."""
    try:
        return FaceNetworks.load()
    except UserError as fault:
        pytest.skip(f"face_detection_short_range, face_landmark and iris_landmark cannot be had: {fault}")


@pytest.fixture(scope="session")
def segmentation():
    """The network that cuts people out, as the package fetches it."""
    try:
        return load_segmentation()
    except UserError as fault:
        pytest.skip(f"selfie_segmentation cannot be had: {fault}")


@pytest.fixture(scope="session")
def portraits(made_once):
    """The built-in subject's head, by frame of its performance."""
    from portraits import read_portraits, write_portraits

    return read_portraits(made_once("portraits", write_portraits))
