"""Albedo and light that a tracker left with its dataset."""

import shutil

import numpy as np
import pytest
import torch
from data.damage import change_arrays

from samira_warp.check.opening import open_collecting
from samira_warp.data import open_sequence
from samira_warp.data.appearance import APPEARANCE_FILE
from samira_warp.support.errors import UserError


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    """The tiny dataset with albedo and light."""
    root = shutil.copytree(tiny_dataset, tmp_path / "subject")
    count = len(np.load(root / "template.npz")["v_template"])
    generator = np.random.default_rng(0)
    albedo, light = generator.random((count, 3)), generator.random((9, 3)) + 0.1
    np.savez(root / APPEARANCE_FILE, albedo=albedo.astype(np.float32), light=light.astype(np.float32))
    return root


def test_it_comes_with_the_sequence(dataset):
    found = open_sequence(dataset).appearance
    with np.load(dataset / APPEARANCE_FILE) as written:
        assert torch.equal(found.albedo, torch.from_numpy(written["albedo"]))
        assert torch.equal(found.light, torch.from_numpy(written["light"]))


def test_no_dataset_has_to_have_it(tiny_dataset):
    assert open_sequence(tiny_dataset).appearance is None


def test_double_precision_and_other_arrays_are_taken(dataset):
    change_arrays(
        dataset / APPEARANCE_FILE,
        albedo=lambda values: values.astype(np.float64),
        note=np.array(["of others", None], object),
    )
    assert open_sequence(dataset).appearance.albedo.dtype == torch.float32


FAULTS = {
    "no albedo": ({"albedo": None}, "albedo: expected an array, found no such key"),
    "no light": ({"light": None}, "light: expected an array, found no such key"),
    "another head's": ({"albedo": lambda a: a[1:]}, "albedo: expected real numbers of shape ("),
    "16 harmonics": ({"light": np.ones((16, 3), np.float32)}, "float32 of shape (16, 3)"),
    "whole numbers": ({"albedo": lambda a: a.astype(int)}, "albedo: expected real numbers"),
    "albedo not a number": ({"albedo": lambda a: np.where(a > 0.5, np.nan, a)}, "albedo: expected finite"),
    "albedo below zero": ({"albedo": lambda a: a - 0.5}, "albedo: expected finite values of at least 0"),
    "light not finite": ({"light": lambda a: a * np.inf}, "light: expected finite"),
    "no light at all": ({"light": lambda a: 0 * a}, "light: expected finite values, the first ones positive"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named(dataset, name):
    changes, message = FAULTS[name]
    change_arrays(dataset / APPEARANCE_FILE, **changes)
    with pytest.raises(UserError) as caught:
        open_sequence(dataset)
    assert str(caught.value).startswith(f"{dataset / APPEARANCE_FILE}: ")
    assert message in str(caught.value)
    assert [fault.subject for fault in open_collecting(dataset, split="dataset", flame=None).faults] == [
        caught.value.subject
    ]


def test_a_file_of_another_kind(dataset):
    (dataset / APPEARANCE_FILE).write_bytes(b"albedo")
    with pytest.raises(UserError, match=r"expected an \.npz of plain arrays"):
        open_sequence(dataset)
