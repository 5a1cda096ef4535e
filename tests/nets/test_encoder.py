import logging
import re
import socket
import subprocess
import sys

import huggingface_hub.constants
import pytest
import torch
from transformers import ResNetBackbone, ResNetConfig

from samira_warp.nets import encode_reference
from samira_warp.nets.encoder import DEFAULT_ENCODER
from samira_warp.nets.random_features import RandomFeatures
from samira_warp.support.errors import UserError


@pytest.fixture
def no_network(monkeypatch):
    """Whoever opens a connection fails the test: this is no OSError, which the encoder would take for a
    missing network."""

    def refuse(*arguments):
        raise AssertionError(f"a connection was opened: {arguments[1:]}")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


@pytest.fixture
def image(generator):
    return torch.rand(64, 64, 3, generator=generator)


def test_random_features_are_the_same_every_time_and_leave_the_generator_alone(device, image, no_network):
    before = torch.random.get_rng_state()
    first, origin = encode_reference(image.to(device), encoder="random")
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.rand(3)
    second, _ = encode_reference(image.to(device), encoder="random")
    assert origin == "random"
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_features_are_a_pyramid_standardised_per_channel(image):
    features, _ = encode_reference(image, encoder="random")
    assert [tuple(level.shape) for level in features] == [(1, 64, 16, 16), (1, 128, 8, 8), (1, 256, 4, 4)]
    for level in features:
        assert not level.requires_grad
        mean, deviation = level.mean((2, 3)), level.std((2, 3), correction=0)
        torch.testing.assert_close(mean, torch.zeros_like(mean), atol=1e-5, rtol=0)
        assert (deviation < 1 + 1e-4).all()  # below 1 where a channel hardly varies: the 1e-5 under its root
        assert deviation.median() > 0.9


@pytest.mark.parametrize("levels", [1, 3, 4])
def test_random_features_are_those_of_transformers_own_network(image, levels):
    config = ResNetConfig(
        embedding_size=64,
        hidden_sizes=[64, 128, 256, 512],
        depths=[2, 2, 2, 2],
        layer_type="basic",
        out_features=[f"stage{stage}" for stage in range(1, levels + 1)],
    )
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        theirs = ResNetBackbone(config).eval()
        torch.manual_seed(0)
        ours = RandomFeatures(levels).eval()
        pixels = image.permute(2, 0, 1)[None]
        assert all(torch.equal(a, b) for a, b in zip(ours(pixels), theirs(pixels).feature_maps, strict=True))


def test_random_features_load_no_library_of_backbones():
    code = (
        "import sys, torch\nfrom samira_warp.nets import encode_reference\n"
        "encode_reference(torch.rand(64, 64, 3), encoder='random')\nassert 'transformers' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


def test_features_depend_on_the_image(image):
    first, _ = encode_reference(image, encoder="random")
    second, _ = encode_reference(image.flip(0), encoder="random")
    assert not torch.allclose(first[0], second[0])


def test_a_local_folder_needs_no_network(tmp_path, image, no_network):
    torch.manual_seed(5)
    config = ResNetConfig(
        embedding_size=4, hidden_sizes=[4, 6, 8, 10], depths=[1, 1, 1, 1], layer_type="basic"
    )
    ResNetBackbone(config).save_pretrained(tmp_path)
    features, origin = encode_reference(image, encoder=str(tmp_path))
    assert origin == str(tmp_path)
    assert [level.shape[1] for level in features] == [4, 6, 8]
    torch.manual_seed(5)
    config.out_indices = [1, 2, 3]
    pixels = (
        image.permute(2, 0, 1)[None] - torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1)
    ) / torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1)
    with torch.no_grad():
        expected = ResNetBackbone(config).eval()(pixels).feature_maps
    for level, truth in zip(features, expected, strict=True):
        torch.testing.assert_close(level, torch.nn.functional.instance_norm(truth), atol=1e-5, rtol=1e-5)


def test_an_unreachable_hub_falls_back_to_random_features_and_says_so(
    monkeypatch, caplog, tmp_path, image, no_network
):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    with caplog.at_level(logging.WARNING, logger="samira_warp"):
        features, origin = encode_reference(image, encoder=DEFAULT_ENCODER)
    assert origin == "random"
    assert DEFAULT_ENCODER in caplog.text
    assert "random features" in caplog.text
    random, _ = encode_reference(image, encoder="random")
    assert all(torch.equal(a, b) for a, b in zip(features, random, strict=True))


def test_an_encoder_that_was_asked_for_is_never_replaced(tmp_path, monkeypatch, image, no_network):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    for encoder in (str(tmp_path), "samira/no-such-backbone"):
        with pytest.raises(UserError, match=re.escape(encoder)):
            encode_reference(image, encoder=encoder)


def test_loading_leaves_the_random_state_alone(image):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    encode_reference(image, encoder="random")
    assert torch.equal(torch.rand(4), expected)
