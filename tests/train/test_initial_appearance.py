"""What a run starts from where the tracker left albedo and light."""

import math
import shutil

import numpy as np
import pytest
import torch
from data.tiny import LIGHT, SKIN
from safetensors.torch import load_file
from subjects import train_arguments, train_command

from samira_warp.avatar import CanonicalHead
from samira_warp.data import PixelCache, open_sequence
from samira_warp.data.appearance import APPEARANCE_FILE, TrackedAppearance
from samira_warp.head.regions import REGIONS
from samira_warp.kernels.cubemap.layout import texel_directions
from samira_warp.light import Environment, decode_srgb
from samira_warp.light.harmonics import harmonics, irradiance_functions
from samira_warp.train.appearance import initial_appearance
from samira_warp.train.initialize import image_view, unwrap_views
from samira_warp.train.skin import SKIN_LUMINANCE, luminance

UNSEEN = (0.21, 0.13, 0.4)
"""The tracker's albedo, which only what no frame shows may have."""


def sun():
    """(9, 3) of the tiny dataset's light: 0.35 from all around and 0.65 from a point, as far as nine tell."""
    light = 0.65 * math.pi * harmonics(torch.from_numpy(LIGHT).float())
    light[0] += 0.35 * 2.0 * math.sqrt(math.pi)
    return light[:, None].expand(9, 3).clone()


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """The tiny dataset, larger, without albedo files."""
    from data.tiny import make_tiny_dataset

    root = make_tiny_dataset(tmp_path_factory.mktemp("bare") / "subject", size=96)
    shutil.rmtree(root / "albedo")
    return root


@pytest.fixture(scope="module")
def head(bare):
    sequence = open_sequence(bare)
    canonical = CanonicalHead.build(
        sequence.template, shape=sequence.shape, static_offset=sequence.static_offset, uv_size=64
    )
    with PixelCache(sequence.frames, resolution=96) as pixels:
        yield sequence, canonical, pixels


def started(head, *, scale=1.0):
    sequence, canonical, pixels = head
    albedo = torch.tensor(UNSEEN).expand(len(canonical.vertices), 3) / scale
    tracked = TrackedAppearance(albedo, sun() * scale)
    return initial_appearance(sequence, pixels, canonical, tracked, reference=sequence.train[0])


def inner_skin(canonical):
    """(h, w) bool: skin away from other paint, before the face."""
    names = [REGIONS.index(name) for name in ("forehead", "nose", "cheeks")]
    inside = canonical.atlas.soft_masks[names].sum(dim=0) > 0.999
    return inside & (canonical.positions[..., 2] > canonical.positions[..., 2].max() - 0.06)


def spread(values):
    """Standard deviation of luminance as a share of its mean."""
    values = luminance(values)
    return float(values.std() / values.mean())


def test_shading_is_taken_off(head):
    sequence, canonical, pixels = head
    skin = inner_skin(canonical)
    picture = unwrap_views([image_view(sequence, pixels, canonical, sequence.train[0])], canonical)
    found = started(head).albedo[skin]
    assert spread(decode_srgb(picture)[skin]) > 0.12
    # nine harmonics tell a point's light to some percent; pictures were encoded by a power of 2.2
    assert spread(found) < 0.06
    colour = found.mean(dim=0) / found.mean()
    torch.testing.assert_close(colour, torch.tensor(SKIN) / np.mean(SKIN), rtol=0.05, atol=0)


def test_albedo_times_light_is_the_picture(head):
    sequence, canonical, pixels = head
    start = started(head)
    view = image_view(sequence, pixels, canonical, sequence.train[0])
    normals = torch.nn.functional.normalize(view.vertices - view.vertices[:280].mean(dim=0), dim=1)
    shading = canonical.atlas.positions(irradiance_functions(normals) @ start.light)
    picture = decode_srgb(unwrap_views([view], canonical))
    skin = inner_skin(canonical)
    error = (start.albedo * shading - picture)[skin].abs().mean() / picture[skin].mean()
    assert error < 0.06  # as above


def test_the_trackers_scale_and_colour_do_not_matter(head):
    one, other = started(head), started(head, scale=torch.tensor([3.0, 0.5, 0.1]))
    torch.testing.assert_close(one.albedo, other.albedo, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(one.light, other.light, rtol=1e-4, atol=1e-5)


def test_what_no_frame_shows_is_the_trackers(head):
    _, canonical, _ = head
    start = started(head)
    behind = canonical.atlas.valid & (canonical.positions[..., 2] < -0.08)
    assert behind.any()
    behind = start.albedo[behind]
    assert torch.allclose(behind, behind[0])
    white = (
        irradiance_functions(torch.tensor([0.0, 0.0, 1.0]))
        @ sun()
        / (irradiance_functions(torch.tensor([0.0, 0.0, 1.0])) @ start.light)
    )
    torch.testing.assert_close(behind[0], torch.tensor(UNSEEN) * white, rtol=1e-3, atol=0)


def test_skin_starts_as_bright_as_skin_may_be(head, monkeypatch):
    from samira_warp.train import appearance

    before = started(head)
    monkeypatch.setattr(appearance, "SKIN_LUMINANCE", type(SKIN_LUMINANCE)(0.05, 0.1))
    after = started(head)
    _, canonical, _ = head
    names = [REGIONS.index(name) for name in ("forehead", "nose", "cheeks")]
    skin = canonical.atlas.soft_masks[names].sum(dim=0) > 0.5
    assert float(luminance(after.albedo[skin].mean(dim=0))) == pytest.approx(0.1, rel=1e-3)
    product = luminance(after.albedo[skin].mean(dim=0)) * after.light
    expected = luminance(before.albedo[skin].mean(dim=0)) * before.light
    torch.testing.assert_close(product, expected, rtol=1e-3, atol=1e-6)


def with_appearance(root, copy):
    root = shutil.copytree(root, copy)
    count = len(np.load(root / "template.npz")["v_template"])
    albedo = np.tile(np.float32(UNSEEN), (count, 1))
    np.savez(root / APPEARANCE_FILE, albedo=albedo, light=sun().numpy())
    return root


def test_a_run_starts_from_it_and_says_so(bare, tmp_path, capfd):
    data = with_appearance(bare, tmp_path / "subject")
    for name, root in (("tracked", data), ("plain", bare)):
        assert train_command(*train_arguments(root, tmp_path / name, "--max-steps", 1)) == 0
        said = capfd.readouterr().err
        assert (f"start from the tracker's, in {APPEARANCE_FILE}" in said) == (name == "tracked")
    # one step moves radiance by a hundredth at most
    lights = {name: Environment.load(tmp_path / name).diffuse.mean(dim=-1) for name in ("tracked", "plain")}
    assert lights["plain"].max() / lights["plain"].min() < 1.1
    assert lights["tracked"].max() / lights["tracked"].min() > 3.0
    brightest = texel_directions(16).flatten(0, 2)[lights["tracked"].argmax()]
    assert float(brightest @ torch.from_numpy(LIGHT).float()) > 0.95


def test_albedo_files_outweigh_it_to_the_bit(tiny_dataset, tiny_run, tmp_path):
    data = with_appearance(tiny_dataset, tmp_path / "subject")
    assert train_command(*train_arguments(data, tmp_path / "run")) == 0
    found, expected = (
        load_file(run / "avatar" / "avatar.safetensors") for run in (tmp_path / "run", tiny_run)
    )
    assert all(torch.equal(found[name], expected[name]) for name in expected)
