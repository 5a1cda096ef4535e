import sys
from pathlib import Path

import pytest

sys.path += [
    str(Path(__file__).parent),
    *(str(Path(__file__).parents[1] / room) for room in ("prepare", "tracker")),
]

import films

from samira_warp.support.errors import UserError
from samira_warp.vision.networks import FaceNetworks


@pytest.fixture(scope="session")
def face_networks():
    """The networks that look at faces."""
    try:
        return FaceNetworks.load()
    except UserError as fault:
        pytest.skip(f"the networks of faces cannot be had: {fault}")


@pytest.fixture(scope="session")
def taken(face_networks, made_once):
    """A second of the built-in subject, 256 x 256, in which it blinks, and what is known of it."""
    return films.read_taken(made_once("taken", films.write_taken))


@pytest.fixture(scope="session")
def film(taken, tmp_path_factory):
    """The same as a video of 600 x 290 pixels."""
    pictures = [films.placed(picture) for picture in taken.pictures]
    return films.write_film(tmp_path_factory.mktemp("driving") / "me.mp4", pictures)
