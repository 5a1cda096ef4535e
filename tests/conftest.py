"""Fixtures: the devices of this machine, the real subject, and a seeded generator."""

import os
from pathlib import Path

os.environ.setdefault("PYTHONHASHSEED", "0")

import pytest
import torch

SUBJECT = Path(__file__).resolve().parents[2] / "shared" / "data" / "heads" / "ict_a"

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


@pytest.fixture(params=DEVICES)
def device(request):
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    return torch.device(request.param)


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture
def subject():
    if not SUBJECT.is_dir():
        pytest.skip(f"the real subject is absent: {SUBJECT.name} is not part of the project")
    return SUBJECT
