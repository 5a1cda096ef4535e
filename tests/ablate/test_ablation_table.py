"""From scores to tables, against numbers that are worked out by hand and by numpy."""

import math

import numpy as np
import pytest

from samira_warp.ablate.config import PAPER
from samira_warp.ablate.table import (
    Difference,
    Score,
    Summary,
    as_json,
    markdown,
    scores_in,
    tabulate,
)
from samira_warp.train.config import Ablation

PSNR, EYE = Score("psnr"), Score("psnr", "eye")


def test_a_mean_and_its_spread():
    # deviations -1, 0, 1: the squares' sum 2 over 3 - 1 seeds
    assert Summary.of([4.0, 5.0, 6.0]) == Summary(5.0, 1.0, 3)
    assert Summary.of([7.5]) == Summary(7.5, None, 1)
    values = np.random.default_rng(0).normal(30.0, 0.3, 5)
    found = Summary.of(values.tolist())
    assert found.mean == pytest.approx(values.mean(), rel=1e-14)
    # deviations are a hundredth of the values: they lose two of float64's sixteen digits
    assert found.spread == pytest.approx(values.std(ddof=1), rel=1e-12)


def test_a_difference_and_its_spread():
    full, variant = Summary.of([30.0, 32.0]), Summary.of([29.0, 30.0, 31.0, 32.0])
    # squares' sums 2 and 5 over 1 + 3 degrees of freedom: a pooled variance of 7 / 4
    found = Difference.between(variant, full)
    assert found.mean == -0.5
    assert found.spread == pytest.approx(math.sqrt(2.0 * 7.0 / 4.0), rel=1e-15)
    assert found.within_spread is True
    # of as many runs each it is the root of the sum of both variances
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(2, 6))
    found = Difference.between(Summary.of(first.tolist()), Summary.of(second.tolist()))
    assert found.spread == pytest.approx(np.sqrt(first.var(ddof=1) + second.var(ddof=1)), rel=1e-12)


@pytest.mark.parametrize(
    ("variant", "within"), [([28.0, 30.0], False), ([30.0, 32.0], True), ([31.0, 33.0], True)]
)
def test_what_is_not_larger_than_the_spread_is_within_it(variant, within):
    # each has a variance of 2, and so the spread is 2; the full method's mean is 31.5
    found = Difference.between(Summary.of(variant), Summary.of([30.5, 32.5]))
    assert found.spread == pytest.approx(2.0, rel=1e-15)
    assert found.within_spread is within


def test_a_difference_as_large_as_the_spread_is_within_it():
    # variances of 2, 2 and a difference of 2
    found = Difference.between(Summary(32.0, math.sqrt(2.0), 2), Summary(30.0, math.sqrt(2.0), 2))
    assert found.mean == 2.0
    assert found.spread >= 2.0
    assert found.within_spread is True


def test_one_seed_has_no_spread():
    found = Difference.between(Summary.of([30.0]), Summary.of([31.0]))
    assert (found.mean, found.spread, found.within_spread) == (-1.0, None, None)
    # one run of either kind adds nothing to the pooled variance
    found = Difference.between(Summary.of([30.0]), Summary.of([30.0, 32.0]))
    assert found.spread == pytest.approx(2.0, rel=1e-15)


def result(psnr, eye, *, lpips=None):
    """What `evaluate_images` gives, in short; a region that no frame shows has nothing."""
    return {
        "psnr": psnr,
        "ssim": 0.9,
        "l1": 1.0,
        "lpips": lpips,
        "psnr_foreground": psnr - 3.0,
        "psnr_gain": psnr + 1.0,
        "regions": {"eye": {"psnr": eye, "ssim": 0.8}, "hat": {"psnr": None, "ssim": None}},
        "frames": {},
        "protocol": {},
    }


def test_scores_of_a_run():
    scores = scores_in(result(30.0, 25.0))
    assert scores == {
        PSNR: 30.0,
        Score("ssim"): 0.9,
        Score("l1"): 1.0,
        Score("psnr_foreground"): 27.0,
        EYE: 25.0,
        Score("ssim", "eye"): 0.8,
    }
    assert scores_in(result(30.0, 25.0, lpips=0.1))[Score("lpips")] == 0.1


@pytest.fixture
def table():
    """Two seeds of the full method, and of one that is worse as a whole and much better at eyes."""
    full = [scores_in(result(30.0, 25.0)), scores_in(result(30.2, 25.1))]
    other = [scores_in(result(30.0, 27.0)), scores_in(result(30.1, 27.2))]
    return tabulate({"full": full, "no-residual": other})


def test_variants_are_compared_with_the_full_method(table):
    assert table.seeds == 2
    assert list(table.differences) == ["no-residual"]
    assert table.summaries["full"][PSNR].mean == pytest.approx(30.1, rel=1e-15)
    found = table.differences["no-residual"]
    assert found[PSNR].mean == pytest.approx(-0.05, abs=1e-12)
    # variances 0.02 and 0.005
    assert found[PSNR].spread == pytest.approx(math.sqrt(0.025), rel=1e-9)
    assert (found[PSNR].within_spread, found[EYE].within_spread) == (True, False)


def test_a_score_that_some_runs_lack_is_left_out_of_the_mean():
    lacking = scores_in(result(30.0, None))
    assert EYE not in lacking
    table = tabulate({"full": [lacking, scores_in(result(31.0, 25.0))], "no-residual": [lacking, lacking]})
    assert table.summaries["full"][EYE] == Summary(25.0, None, 1)
    assert EYE not in table.differences["no-residual"]
    assert "none" in markdown(table, title="t", about=[])


def cells(text, heading):
    """Rows of the table below a heading, by their first cell."""
    lines = text.split(f"## {heading}\n\n")[1].split("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in rows}


def test_the_words(table):
    text = markdown(table, title="Title", about=["About it."])
    assert text.startswith("# Title\n\nAbout it.\n\nAfter ± stands ")
    whole = cells(text, "Whole frame")
    assert whole["variant"] == ["PSNR", "SSIM", "L1 x 100", "PSNR of the foreground"]
    assert whole["full"][0] == "30.10 ± 0.14"
    differences = cells(text, "Whole frame: difference from full")
    assert set(differences) == {"variant", "-" * len("no-residual"), "no-residual"}
    assert differences["no-residual"][:2] == [
        "-0.05 ± 0.16, within the spread",
        "+0.0000 ± 0.0000, within the spread",
    ]
    # variances 0.005 and 0.02
    assert cells(text, "PSNR by region: difference from full")["no-residual"] == ["+2.05 ± 0.16"]
    assert cells(text, "SSIM by region")["full"] == ["0.8000 ± 0.0000"]
    # as wide as the widest cell: every line of a table has one length
    for block in text.split("\n\n"):
        if block.startswith("|"):
            assert len({len(line) for line in block.splitlines()}) == 1


def test_the_words_of_one_seed():
    run = [scores_in(result(30.0, 25.0))]
    text = markdown(tabulate({"full": run, "no-albedo": run}), title="t", about=[])
    assert "the spread over seeds is not known" in text
    assert "±" not in text
    assert "within" not in text
    assert cells(text, "Whole frame: difference from full")["no-albedo"][0] == "+0.00"


def test_for_machines(table):
    content = as_json(table)
    assert set(content) == {"full", "no-residual"}
    assert "differences" not in content["full"]
    eye = content["no-residual"]["differences"]["regions"]["eye"]["psnr"]
    assert eye["mean"] == pytest.approx(2.05, rel=1e-12)
    assert eye["within_spread"] is False
    assert content["full"]["scores"]["psnr"]["count"] == 2


def test_the_papers_variants_are_this_packages():
    assert PAPER[0] == "full"
    assert set(PAPER[1:]) < set(Ablation.__args__)
    assert len(set(PAPER)) == len(PAPER) == 9
