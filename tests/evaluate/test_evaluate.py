"""What is reported of a set of images: per frame, averaged, over the foreground, by region."""

import json
import math

import pytest
import torch

from samira_warp.evaluate import ImagePair, evaluate_images, metrics

NAMES = {1: "eye", 2: "lips", 3: "ear"}
IMAGE_SCORES = {"psnr", "ssim", "l1", "lpips", "psnr_foreground", "psnr_gain"}


@pytest.fixture
def pairs(generator):
    """Two frames with a mask; the first shows labels 1 and 2, the second 1 alone."""
    made = []
    for index in range(2):
        truth, mask = torch.rand(16, 20, 3, generator=generator), torch.zeros(16, 20)
        mask[4:12, 5:15] = 1.0
        labels = torch.zeros(16, 20, dtype=torch.uint8)
        labels[4:8, 5:15] = 1
        labels[8:12, 5:15] = 0 if index else 2
        noise = 0.05 * (index + 1) * torch.randn(truth.shape, generator=generator)
        made.append(ImagePair(f"{index:05d}_00", (truth + noise).clamp(0, 1), truth, mask, labels))
    return made


def evaluate(pairs, **options):
    return evaluate_images(pairs, protocol={"split": "test"}, **options)


class FakeDistance:
    """Stands for LPIPS where only its use is looked at."""

    net = "alex"

    def __call__(self, prediction, truth):
        return (prediction - truth).square().mean()


def test_scores_of_a_frame_are_the_metrics(pairs):
    frames = evaluate(pairs)["frames"]
    assert list(frames) == ["00000_00", "00001_00"]
    for pair in pairs:
        inside, scores = pair.mask > 0.5, frames[pair.name]
        assert set(scores) == IMAGE_SCORES
        assert scores["psnr"] == metrics.psnr(pair.prediction, pair.truth).item()
        assert scores["ssim"] == metrics.ssim(pair.prediction, pair.truth).item()
        assert scores["l1"] == metrics.l1(pair.prediction, pair.truth).item()
        assert scores["psnr_foreground"] == metrics.psnr_where(pair.prediction, pair.truth, inside).item()
        assert scores["psnr_gain"] == metrics.psnr_gain(pair.prediction, pair.truth, pair.mask).item()


def test_averages_are_means_over_frames(pairs):
    result = evaluate(pairs)
    for name in IMAGE_SCORES - {"lpips"}:
        assert result[name] == pytest.approx(sum(frame[name] for frame in result["frames"].values()) / 2)


def test_without_lpips_there_is_a_reason(pairs):
    result = evaluate(pairs, lpips="no weights here")
    assert result["lpips"] is None
    assert result["lpips_reason"] == "no weights here"
    assert result["protocol"]["lpips_net"] is None


def test_lpips_of_images_that_are_too_small_is_null_with_the_reason(pairs):
    result = evaluate(pairs, lpips=FakeDistance())
    assert result["lpips"] is None
    assert "smaller than 32 pixels" in result["lpips_reason"]


def test_lpips_is_averaged_and_its_net_named(generator):
    first, second, truth = torch.rand(3, 32, 40, 3, generator=generator)
    pairs = [ImagePair("first", first, truth), ImagePair("second", second, truth)]
    result = evaluate(pairs, lpips=FakeDistance())
    assert result["lpips"] == pytest.approx(
        sum((pair.prediction - pair.truth).square().mean().item() for pair in pairs) / 2
    )
    assert "lpips_reason" not in result
    assert result["protocol"]["lpips_net"].startswith("alex")


@pytest.mark.parametrize("small_first", [True, False])
def test_lpips_of_two_sizes_is_that_of_the_frames_that_are_large_enough(generator, small_first):
    large, truth = torch.rand(2, 32, 40, 3, generator=generator)
    pairs = [ImagePair("large", large, truth), ImagePair("small", large[:31], truth[:31])]
    result = evaluate(pairs[::-1] if small_first else pairs, lpips=FakeDistance())
    assert result["lpips"] == result["frames"]["large"]["lpips"] is not None
    assert result["frames"]["small"]["lpips"] is None
    assert "smaller than 32 pixels" in result["lpips_reason"]


def test_without_masks_the_foreground_has_no_score(generator):
    result = evaluate(
        [
            ImagePair(
                "a", torch.rand(16, 16, 3, generator=generator), torch.rand(16, 16, 3, generator=generator)
            )
        ]
    )
    assert result["psnr_foreground"] is result["psnr_gain"] is None
    assert result["psnr"] > 0


def test_a_frame_with_an_empty_mask_does_not_count_for_the_foreground(pairs):
    empty = ImagePair("empty", pairs[0].prediction, pairs[0].truth, torch.zeros(16, 20))
    result = evaluate([pairs[0], empty])
    assert result["frames"]["empty"]["psnr_foreground"] is None
    assert result["psnr_foreground"] == result["frames"]["00000_00"]["psnr_foreground"]


def test_equal_images_score_the_cap(pairs):
    result = evaluate([ImagePair("a", pairs[0].truth, pairs[0].truth, pairs[0].mask)])
    assert result["psnr"] == result["psnr_foreground"] == result["psnr_gain"] == pytest.approx(100.0)
    assert (result["ssim"], result["l1"]) == (pytest.approx(1.0), 0.0)


def test_regions_are_scored_over_their_own_pixels(pairs):
    result = evaluate(pairs, region_names=NAMES)
    first, second = (result["frames"][pair.name]["regions"] for pair in pairs)
    assert (set(first), set(second)) == ({"eye", "lips"}, {"eye"})
    pair = pairs[0]
    for label, name in ((1, "eye"), (2, "lips")):
        where = pair.labels == label
        assert first[name]["psnr"] == metrics.psnr_where(pair.prediction, pair.truth, where).item()
        assert first[name]["ssim"] == metrics.ssim_map(pair.prediction, pair.truth)[where].mean().item()
    assert result["regions"]["eye"]["psnr"] == pytest.approx(
        (first["eye"]["psnr"] + second["eye"]["psnr"]) / 2
    )
    assert result["regions"]["lips"] == first["lips"]  # over the one frame that shows it
    assert "ear" not in result["regions"]


def test_an_error_elsewhere_leaves_a_regions_psnr(pairs):
    spoilt = pairs[0].prediction.clone()
    spoilt[12:] = 0.0
    before, after = (
        evaluate([ImagePair("a", prediction, pairs[0].truth, None, pairs[0].labels)], region_names=NAMES)[
            "regions"
        ]["eye"]["psnr"]
        for prediction in (pairs[0].prediction, spoilt)
    )
    assert before == after


def test_labels_without_names_are_not_scored(pairs):
    assert "regions" not in evaluate(pairs)
    assert set(evaluate(pairs, region_names={2: "lips"})["regions"]) == {"lips"}


def test_albedo_is_scored_over_the_foreground_as_well(pairs):
    result, pair = evaluate(pairs[:1], layer="albedo"), pairs[0]
    inside = pair.mask > 0.5
    assert result["l1_foreground"] == metrics.l1(pair.prediction[inside], pair.truth[inside]).item()
    assert result["ssim_foreground"] == metrics.ssim_map(pair.prediction, pair.truth)[inside].mean().item()
    assert result["protocol"]["layer"] == "albedo"


def turned(degrees):
    angle = math.radians(degrees)
    return torch.tensor([math.sin(angle), 0.0, math.cos(angle)]).expand(16, 20, 3)


def test_normals_are_scored_by_angle_alone(pairs):
    made = [
        ImagePair(pair.name, turned(degrees), turned(0), pair.mask, pair.labels)
        for pair, degrees in zip(pairs, (10, 20), strict=True)
    ]
    result = evaluate(made, layer="normal", region_names=NAMES, lpips="normals are scored by angle")
    assert result["normal_angle"] == pytest.approx(15.0, abs=1e-3)
    assert not IMAGE_SCORES & set(result)
    assert "lpips_reason" not in result
    assert result["regions"]["eye"]["normal_angle"] == pytest.approx(15.0, abs=1e-3)
    assert result["regions"]["lips"]["normal_angle"] == pytest.approx(10.0, abs=1e-3)


def test_normals_outside_the_mask_do_not_count(pairs):
    prediction = turned(10).clone()
    prediction[pairs[0].mask <= 0.5] = torch.tensor([0.0, 0.0, -1.0])
    with_mask, without = (
        evaluate([ImagePair("a", prediction, turned(0), mask)], layer="normal")
        for mask in (pairs[0].mask, None)
    )
    assert with_mask["normal_angle"] == pytest.approx(10.0, abs=1e-3)
    assert without["normal_angle"] == pytest.approx((80 * 10 + 240 * 180) / 320, abs=1e-2)


def test_the_protocol_says_how(pairs):
    protocol = evaluate(pairs, region_names=NAMES)["protocol"]
    assert protocol["split"] == "test"
    assert (protocol["layer"], protocol["frames"], protocol["background"]) == ("image", 2, "white")
    assert {"psnr", "ssim", "l1", "psnr_foreground", "psnr_gain", "average", "lpips_net"} <= set(protocol)
    assert evaluate(pairs, layer="normal")["protocol"]["layer"] == "normal"


def test_the_result_is_json_without_infinities(pairs):
    empty = ImagePair("empty", pairs[0].truth, pairs[0].truth, torch.zeros(16, 20), pairs[0].labels)
    for layer in ("image", "albedo", "normal"):
        json.dumps(evaluate([*pairs, empty], layer=layer, region_names=NAMES), allow_nan=False)


def test_pairs_are_taken_one_by_one(pairs):
    assert evaluate(iter(pairs))["frames"].keys() == evaluate(pairs)["frames"].keys()


def test_no_images(generator):
    result = evaluate([])
    assert result["frames"] == {}
    assert result["protocol"]["frames"] == 0
    json.dumps(result, allow_nan=False)
