"""The prior on skin's albedo: what was measured costs nothing, and what was not comes back."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from skimage.color import lab2rgb
from subjects import small_avatar, small_preset, small_template, train_arguments, train_command

from samira_warp.data import PixelCache, open_sequence
from samira_warp.head.regions import REGIONS, route_faces
from samira_warp.light import decode_srgb
from samira_warp.train import schedule
from samira_warp.train.config import TrainConfig
from samira_warp.train.plan import make_plan
from samira_warp.train.settings import resolve
from samira_warp.train.setup import start
from samira_warp.train.skin import (
    SKIN_BLUE,
    SKIN_GREEN,
    SKIN_LUMINANCE,
    luminance,
    mean_skin,
    skin_faces,
    skin_prior,
)
from samira_warp.train.trainer import Trainer

MEASURED = [
    *[(59.6, 11.8, 14.6), (58.9, 11.4, 14.2), (60.7, 10.5, 17.2), (58.0, 11.7, 15.8)],  # cheeks, Xiao et al.
    *[(59.2, 11.6, 15.1), (56.4, 11.7, 16.3), (56.8, 11.6, 17.7), (56.1, 11.3, 16.4)],  # their foreheads
    *[(44.0, 14.0, 19.0), (48.0, 15.0, 20.0), (63.0, 16.0, 21.0)],  # De Rigal et al.
    *[(52.5, 17.0, 18.9), (37.7, 17.2, 14.7), (49.4, 22.0, 12.3), (41.5, 25.5, 13.3), (26.7, 14.6, 14.7)],
]
"""CIELAB under D65 of groups' means; the last row is the shade guide's clusters."""


def linear(lab):
    """(3,) linear sRGB, by another library."""
    return decode_srgb(torch.from_numpy(lab2rgb(np.array([[lab]], float))[0, 0]).float())


@pytest.mark.parametrize("lab", MEASURED)
def test_skin_as_it_was_measured_costs_nothing(lab):
    albedo = linear(lab).requires_grad_()
    cost = skin_prior(albedo)
    assert float(cost.detach()) == 0.0
    cost.backward()
    assert (albedo.grad == 0).all()


def test_the_ranges_are_those_of_the_colours_that_they_are_said_to_be_of():
    for end, lightness in zip(SKIN_LUMINANCE, (24.0, 76.0), strict=True):
        # two digits are written down
        assert end == pytest.approx(((lightness + 16.0) / 116.0) ** 3, rel=0.01)
    reddest, palest, yellowest = map(linear, [(41.5, 25.5, 13.3), (76.0, 5.6, 9.4), (44.0, 14.0, 21.0)])
    assert tuple(SKIN_GREEN) == pytest.approx([float(c[1] / c[0]) for c in (reddest, palest)], abs=0.015)
    assert tuple(SKIN_BLUE) == pytest.approx([float(c[2] / c[1]) for c in (yellowest, reddest)], abs=0.015)


@pytest.mark.parametrize("end", [0, 1])
def test_outside_it_costs_the_square_of_the_logarithm(end):
    typical = linear((59.6, 11.8, 14.6))
    at_end = typical * SKIN_LUMINANCE[end] / luminance(typical)
    beyond = at_end * (3.0 if end else 1 / 3.0)
    assert float(skin_prior(beyond)) == pytest.approx(np.log(3.0) ** 2, rel=1e-4)


@pytest.mark.parametrize(
    ("albedo", "wrong"), [((0.3, 0.3, 0.3), 2), ((0.5, 0.1, 0.08), 1), ((0.2, 0.3, 0.4), 2)]
)
def test_grey_scarlet_and_blue_are_no_skin(albedo, wrong):
    albedo = torch.tensor(albedo)
    excess = [
        max(np.log(low / value), np.log(value / high), 0.0)
        for value, (low, high) in (
            (float(albedo[1] / albedo[0]), SKIN_GREEN),
            (float(albedo[2] / albedo[1]), SKIN_BLUE),
        )
    ]
    assert sum(part > 0 for part in excess) == wrong
    assert float(skin_prior(albedo)) == pytest.approx(sum(part**2 for part in excess), rel=1e-4)


def test_black_skin_has_a_finite_cost_and_slope():
    albedo = torch.zeros(3, requires_grad=True)
    skin_prior(albedo).backward()
    assert albedo.grad.isfinite().all()


def test_skin_is_face_without_eyes_lips_and_hair():
    faces = skin_faces(small_template())
    names = {REGIONS[region] for region in route_faces(small_template())[faces]}
    assert names == {"forehead", "nose", "cheeks"}
    assert faces.any()
    assert not faces.all()


def test_a_head_without_masks_has_no_skin_that_is_known():
    bare = dataclasses.replace(small_template(), masks={})
    assert not skin_faces(bare).any()


def test_the_mean_is_over_the_area_that_skins_gaussians_cover(generator):
    gaussians = small_avatar(gaussians=300).gaussians
    on_skin = torch.from_numpy(skin_faces(small_template()))
    with torch.no_grad():
        gaussians.opacity_logits.normal_(generator=generator)
        gaussians.log_scales.add_(0.3 * torch.randn(300, 3, generator=generator))
    total, area = np.zeros(3), 0.0
    for row in range(300):
        if on_skin[gaussians.faces[row].long()]:
            first, second = sorted(gaussians.scales[row].tolist())[1:]
            weight = float(gaussians.opacities[row].detach()) * first * second
            total += weight * gaussians.albedo[row].detach().double().numpy()
            area += weight
    found = mean_skin(gaussians, on_skin)
    np.testing.assert_allclose(found.detach().numpy(), total / area, rtol=1e-4)
    found.sum().backward()
    touched = gaussians.albedo_logits.grad.abs().sum(dim=1) > 0
    assert torch.equal(touched, on_skin[gaussians.faces.long()])
    assert gaussians.opacity_logits.grad is None
    assert gaussians.log_scales.grad is None


@pytest.fixture
def unlit(built_in_datasets, tmp_path):
    """The built-in subject without albedo files."""
    root = shutil.copytree(built_in_datasets["VHAP export"], tmp_path / "subject")
    shutil.rmtree(root / "albedo")
    return root


@pytest.mark.parametrize(("factor", "steps"), [(3.0, 60), (1 / 25.0, 40)])
def test_skin_that_starts_too_bright_or_dark_comes_back(unlit, tmp_path, monkeypatch, factor, steps):
    """Albedo times a factor under light divided by it makes the same pictures: only the prior tells.

    Albedo learns twenty times as fast as in a run, which has thousands of steps.
    """
    monkeypatch.setitem(schedule.RATES, "albedo_logits", schedule.constant(0.1))
    config = TrainConfig(data=unlit, preset="cpu", device="cpu", encoder="random", max_steps=steps)
    sequence = open_sequence(unlit)
    with small_preset(), PixelCache(sequence.frames, resolution=32) as pixels:
        plan = make_plan(resolve(config, data=unlit, out=tmp_path), sequence, config)
        avatar = start(plan, sequence, pixels).avatar
        trainer = Trainer(plan, sequence, pixels, avatar)
        with torch.no_grad():
            albedo = (avatar.gaussians.albedo * factor).clamp(0.005, 0.995)
            avatar.gaussians.albedo_logits.copy_(torch.logit(albedo))
            for parameter in avatar.light.parameters():
                radiance = torch.nn.functional.softplus(parameter) / factor
                parameter.copy_(radiance + torch.log(-torch.expm1(-radiance)))
        before = skin_luminance(trainer)
        assert not SKIN_LUMINANCE.low < before < SKIN_LUMINANCE.high
        for _ in range(steps):
            trainer.train_step()
        after = skin_luminance(trainer)
    # a third beyond, the prior's slope is 0.2 log 1.35 = 0.06: pictures pull so while they are learnt
    assert SKIN_LUMINANCE.low / 1.35 < after < SKIN_LUMINANCE.high * 1.35
    assert abs(np.log(after / before)) > 0.4


def skin_luminance(trainer):
    return float(luminance(mean_skin(trainer.avatar.gaussians, trainer.known.skin).detach()))


def test_the_prior_is_on_where_no_albedo_is_compared_with(tiny_dataset, tmp_path, capfd):
    bare = shutil.copytree(tiny_dataset, tmp_path / "bare")
    shutil.rmtree(bare / "albedo")
    runs = {
        "files": (tiny_dataset, ()),
        "ablated": (tiny_dataset, ("--ablate", "no-albedo")),
        "bare": (bare, ()),
        "raw": (bare, ("--color-space", "raw")),
    }
    said, terms = {}, {}
    for name, (data, more) in runs.items():
        assert train_command(*train_arguments(data, tmp_path / name, *more)) == 0
        said[name] = capfd.readouterr().err
        terms[name] = set(json.loads((tmp_path / name / "metrics.jsonl").read_text().splitlines()[0]))
    assert {name for name in runs if "skin" in terms[name]} == {"bare"}
    assert "luminance 0.041 to 0.5" in said["bare"]
    assert "a factor of up to 12" in said["bare"]
    assert "hair and clothes" in said["bare"]
    assert "is undefined" in said["raw"]
    assert "pseudo-albedo" not in said["files"] + said["ablated"]
