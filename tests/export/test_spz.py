"""The packing of a .spz, by splats that no head has; its bytes are unpacked here as the format says."""

import gzip
import struct

import numpy as np
import pytest
import torch

from samira_warp.export.splats import Splats
from samira_warp.export.spz import encode
from samira_warp.support.errors import UserError

VERSIONS = [2, 3, 4]


def splats(count=200, seed=0, **given):
    """Splats of random rotations, some with w = 0, in a ball of half a metre; what is given instead."""
    generator = torch.Generator().manual_seed(seed)
    quaternions = torch.randn(count, 4, generator=generator)
    quaternions[::5, 0] = 0.0
    quaternions[1::7, 0] = -1e-3
    values = {
        "means": torch.rand(count, 3, generator=generator) - 0.5,
        "normals": torch.zeros(count, 3),
        "quaternions": torch.nn.functional.normalize(quaternions, dim=1),
        "scales": torch.full((count, 3), 1e-3),
        "opacity_logits": torch.zeros(count),
        "colors": torch.full((count, 3), 0.5),
    }
    return Splats(**{**values, **given})


def sections(content):
    """Header fields and the bytes of positions, opacities, colours, scales and rotations."""
    if content[:2] == b"\x1f\x8b":
        content, start = gzip.decompress(content), 16
        payload = content[start:]
    else:
        zstandard = pytest.importorskip("zstandard")
        count, table = struct.unpack_from("<BI", content, 15)
        lengths = [struct.unpack_from("<QQ", content, table + 16 * index) for index in range(count)]
        at, payload = table + 16 * count, b""
        for length, whole in lengths:
            payload += zstandard.ZstdDecompressor().decompress(
                content[at : at + length], max_output_size=whole
            )
            at += length
        assert at == len(content)
    magic, version, count, degree, bits, flags = struct.unpack_from("<4sIIBBB", content)
    assert magic == b"NGSP"
    assert degree == 0
    widths = [9, 1, 3, 3, 3 if version == 2 else 4]
    ends = np.cumsum([count * width for width in widths])
    assert ends[-1] == len(payload)
    parts = [payload[end - count * width : end] for end, width in zip(ends, widths, strict=True)]
    return (version, count, bits, flags), parts


@pytest.mark.parametrize("version", VERSIONS)
def test_a_header_says_version_count_and_how_splats_are_widened(version):
    (found, count, _, flags), _ = sections(encode(splats(), version=version))
    assert (found, count, flags) == (version, 200, 1)


@pytest.mark.parametrize("version", VERSIONS)
def test_opacities_stay_off_the_ends(version):
    """At bytes 0 and 255 gaussforge and spz-js have infinite logits."""
    logits = torch.tensor([-50.0, -6.0, 0.0, 6.0, 50.0]).repeat(40)
    _, parts = sections(encode(splats(opacity_logits=logits), version=version))
    assert list(parts[1][:5]) == [1, 1, 128, 254, 254]


@pytest.mark.parametrize(("farthest", "bits"), [(0.9, 22), (1.0, 21), (1.99, 21), (10.0, 18), (999.0, 12)])
def test_coordinates_have_the_bits_that_the_farthest_leaves(farthest, bits):
    means = torch.linspace(-farthest, farthest, 600).reshape(-1, 3)
    (_, _, found, _), parts = sections(encode(splats(means=means), version=2))
    assert found == bits
    read = np.frombuffer(parts[0], np.uint8).reshape(-1, 3, 3).astype(np.int64) @ [1, 256, 65536]
    read = np.where(read >= 1 << 23, read - (1 << 24), read) / 2.0**bits
    np.testing.assert_allclose(read, means.numpy(), atol=0.5 / 2.0**bits, rtol=0)


@pytest.mark.parametrize("farthest", [1000.0, float("inf"), float("nan")])
def test_a_splat_beyond_all_bits_is_refused(farthest):
    means = torch.zeros(200, 3)
    means[7, 1] = farthest
    with pytest.raises(UserError, match="from the origin"):
        encode(splats(means=means), version=2)


@pytest.mark.parametrize("version", VERSIONS)
def test_axes_of_flat_splats_keep_their_directions(version):
    """By reading them as the format's library does: 8 bits of x, y, z, or 10 of the smallest three.

    In version 2 as x, y, z of a rotation, w would be off by seven degrees where it is 0.
    """
    given = splats(2000)
    _, parts = sections(encode(given, version=version))
    if version == 2:
        vector = np.frombuffer(parts[4], np.uint8).reshape(-1, 3) / 127.5 - 1.0
        real = np.sqrt(np.maximum(0.0, 1.0 - (vector**2).sum(axis=1)))
        read = np.column_stack([real, vector])
    else:
        words = np.frombuffer(parts[4], "<u4").astype(np.int64)
        read = np.zeros((len(words), 4))
        largest = words >> 30
        for component in (3, 2, 1, 0):
            kept = largest != component
            value = (words & 511) / (511 * np.sqrt(2.0)) * np.where(words & 512, -1.0, 1.0)
            read[:, component] = np.where(kept, value, 0.0)
            words = np.where(kept, words >> 10, words)
        read[np.arange(len(read)), largest] = np.sqrt(1.0 - (read**2).sum(axis=1))
        read = np.roll(read, 1, axis=1)
    cosines = np.abs((axes(read) * axes(given.quaternions.double().numpy())).sum(axis=1))
    # radians between an axis and the same one of the other, as a line; test_splat_files.py derives them
    assert np.arccos(np.minimum(cosines, 1.0)).max() < (0.028 if version == 2 else 0.0042)


def axes(quaternions):
    """(N, 3, 3) rotation matrices, whose columns are the axes of splats."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


@pytest.mark.parametrize("version", VERSIONS)
def test_colours_beyond_white_and_small_scales_are_held(version):
    given = splats(
        colors=torch.tensor([[-1.0, 0.5, 9.0]]).repeat(200, 1),
        scales=torch.tensor([[1e-9, 1e-3, 1e9]]).repeat(200, 1),
    )
    _, parts = sections(encode(given, version=version))
    assert list(parts[2][:3]) == [0, 128, 255]
    assert list(parts[3][:3]) == [0, 49, 255]


def test_the_same_splats_are_the_same_bytes():
    assert all(encode(splats(), version=version) == encode(splats(), version=version) for version in VERSIONS)
