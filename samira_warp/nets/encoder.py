"""The pretrained image encoder E_img, run once per avatar on the reference image."""

from __future__ import annotations

import logging
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from samira_warp.nets.random_features import RandomFeatures
from samira_warp.support.errors import UserError

logger = logging.getLogger(__name__)

IMAGE_MEAN = (0.485, 0.456, 0.406)
"""ImageNet's mean in display values, which the pretrained backbones expect to be subtracted."""

IMAGE_DEVIATION = (0.229, 0.224, 0.225)
"""ImageNet's standard deviation in display values."""

DEFAULT_ENCODER = "microsoft/resnet-18"
"""ResNet-18: 11 M parameters, features at strides 4, 8 and 16; any backbone of transformers may stand in."""

HUB_TIMEOUT = 5.0
"""Seconds to wait for the hub's first answer."""

RANDOM_ENCODER = "random"
"""Fixed random ResNet-18 features, seeded: what is used where pretrained weights cannot be had."""

Backbone = Callable[[Tensor], Sequence[Tensor]]
"""From a (1, 3, H, W) standardised image to its features, finest first."""


@torch.no_grad()
def encode_reference(
    image: Tensor, *, encoder: str = DEFAULT_ENCODER, levels: int = 3
) -> tuple[list[Tensor], str]:
    """Multi-level features {F_l^img} of the reference image.

    Args:
        image: (H, W, 3) float32 in display values, 0 to 1.
        encoder: A backbone's id on the hub, a local folder, or "random".
        levels: L, number of pyramid levels, from the finest.

    Returns:
        The features, finest first, each (1, C_l, H_l, W_l) and standardised per channel; and what made them,
        for the record.
    """
    backbone, origin = _load_backbone(encoder, levels)
    mean, deviation = (
        torch.tensor(values, dtype=image.dtype, device=image.device).view(1, 3, 1, 1)
        for values in (IMAGE_MEAN, IMAGE_DEVIATION)
    )
    pixels = (image.permute(2, 0, 1)[None] - mean) / deviation
    return [nn.functional.instance_norm(level).contiguous() for level in backbone(pixels)], origin


def _load_backbone(encoder: str, levels: int) -> tuple[Backbone, str]:
    """The backbone and its name.

    Random features stand in for the default one where it cannot be had, and for no other.
    """
    with torch.random.fork_rng(devices=[]):
        if encoder == RANDOM_ENCODER:
            return _random_backbone(levels), RANDOM_ENCODER
        try:
            return _pretrained_backbone(encoder, levels), encoder
        except (OSError, ValueError, KeyError, ImportError) as error:
            reason = str(error).strip().splitlines()[0]
            if encoder != DEFAULT_ENCODER:
                raise UserError(
                    f"--encoder {encoder}",
                    expected="a backbone of transformers, by hub id or folder",
                    found=reason,
                ) from error
            logger.warning(
                "image encoder %s cannot be had (%s): fixed random features stand in for it", encoder, reason
            )
            return _random_backbone(levels), RANDOM_ENCODER


def _pretrained_backbone(encoder: str, levels: int) -> Backbone:
    """The backbone from a local folder, the hub's cache or the hub.

    Raises:
        OSError: It is in none of them, or is no backbone.
    """
    # not needed where features are random or the encoder is not asked
    from huggingface_hub import try_to_load_from_cache

    folder = Path(encoder).is_dir()
    local = folder or not _hub_answers(encoder)
    if local and not folder and not isinstance(try_to_load_from_cache(encoder, "config.json"), str):
        raise OSError("the hub does not answer, and its cache has none of it")
    # seconds to load, and not needed before
    from transformers import AutoBackbone, AutoConfig

    config = AutoConfig.from_pretrained(
        encoder, out_indices=list(range(1, levels + 1)), local_files_only=local
    )
    # AutoBackbone asks the hub even for a local folder; the concrete class does not.
    concrete = type(AutoBackbone.from_config(config))
    network = concrete.from_pretrained(encoder, config=config, local_files_only=local)
    return lambda pixels: network.to(pixels.device).eval()(pixels).feature_maps


def _hub_answers(encoder: str) -> bool:
    """Whether the hub can be reached, asked once: transformers would retry for half a minute."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        return False
    request = urllib.request.Request(
        f"{constants.ENDPOINT}/{encoder}/resolve/main/config.json", method="HEAD"
    )
    try:
        urllib.request.urlopen(request, timeout=HUB_TIMEOUT).close()
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False
    return True


def _random_backbone(levels: int) -> Backbone:
    torch.manual_seed(0)
    network = RandomFeatures(levels)
    return lambda pixels: network.to(pixels.device).eval()(pixels)
