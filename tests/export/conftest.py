"""An avatar's folder, made without training."""

import pytest
from sources import saved_avatar


@pytest.fixture(scope="session")
def saved(made_once):
    """The folder of `saved_avatar`. Tests write beside it, not into it."""
    return made_once("saved avatar", saved_avatar)
