"""The runtime of the networks: what it is told, what it says, and where it is missing."""

import builtins

import numpy as np
import pytest

from samira_warp.support.errors import UserError
from samira_warp.vision.runtime import Network
from samira_warp.vision.weights import IRIS, read_network


def test_a_missing_runtime_is_named_with_the_extra(monkeypatch):
    really = builtins.__import__

    def without(name, *rest):
        if name.startswith("ai_edge_litert"):
            raise ImportError(f"No module named {name!r}")
        return really(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"ai-edge-litert: expected .*pip install 'samira-warp\[track\]'"):
        Network(b"", name="eyes.tflite", value_range=(0.0, 1.0))


def test_what_is_no_network_is_named():
    with pytest.raises(UserError, match=r"eyes.tflite: expected a TFLite network"):
        Network(b"no network at all", name="eyes.tflite", value_range=(0.0, 1.0))


def test_it_is_quiet_and_shows_pictures_in_the_range_asked_for(networks, capfd):
    content = read_network(IRIS)
    eye = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    half, full = (Network(content, name="iris", value_range=(low, 1.0)) for low in (0.5, 0.0))
    assert capfd.readouterr().err == ""
    # 0.5 to 1 of a picture is 0 to 1 of one with half its contrast about the brighter end
    brighter = 127.5 + eye / 2.0
    for name, values in half(eye).items():
        assert np.allclose(full(brighter)[name], values, atol=1e-3)
        assert not np.allclose(full(eye)[name], values, atol=0.1)


def test_threads_change_no_bit(networks):
    content = read_network(IRIS)
    eye = np.random.default_rng(1).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    one, two = (Network(content, name="iris", value_range=(0.0, 1.0), threads=count)(eye) for count in (1, 2))
    assert all(np.array_equal(one[name], two[name]) for name in one)
