"""Which perceptual distance a run learns from, and by which it is scored."""

import shutil
from types import SimpleNamespace

from subjects import write_lpips_weights

from samira_warp.evaluate import Lpips
from samira_warp.train.perceptual import PerceptualDistances


def test_the_papers_preset_learns_from_vgg_and_is_scored_by_alexnet(tmp_path):
    weights = write_lpips_weights(tmp_path / "weights", "alex")
    shutil.copytree(write_lpips_weights(tmp_path / "vgg", "vgg"), weights, dirs_exist_ok=True)
    found = PerceptualDistances.find("paper", weights)
    assert (found.training.net, found.scoring.net, found.learned_from) == ("vgg", "alex", "vgg")
    found = PerceptualDistances.find("cpu", weights)
    assert (found.training.net, found.scoring.net, found.learned_from) == ("alex", "alex", "alex")


def test_each_is_there_where_its_weights_are(tmp_path):
    found = PerceptualDistances.find("paper", write_lpips_weights(tmp_path / "weights", "alex"))
    assert found.learned_from is None
    assert "vgg16" in found.training
    assert isinstance(found.scoring, Lpips)


def test_small_images_have_neither(tmp_path):
    found = PerceptualDistances.find("cpu", write_lpips_weights(tmp_path / "weights", "alex"))
    plan = SimpleNamespace(sizes=((40, 30),), settings=SimpleNamespace(resolution=40))
    assert (
        found.at_sizes(plan).training == found.at_sizes(plan).scoring == "images are smaller than 32 pixels"
    )
    larger = SimpleNamespace(sizes=((64, 48),), settings=SimpleNamespace(resolution=64))
    assert found.at_sizes(larger) == found
