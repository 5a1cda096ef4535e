"""The whole job on a CUDA device: training with LPIPS, going on, rendering, exporting and measuring."""

import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData
from safetensors.torch import load_file
from subjects import TESTS, render_command, train_arguments, train_command, write_lpips_weights
from warm_start import warm_python

from samira_warp import Avatar
from samira_warp.bench.__main__ import BenchConfig
from samira_warp.bench.__main__ import main as bench_main
from samira_warp.io.images import read_image
from samira_warp.support.cli import run

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine"),
]


@pytest.fixture(scope="module")
def arguments(tiny_dataset, tmp_path_factory):
    """Options of a run on CUDA with the small preset, and LPIPS of random weights in its fifth step."""
    root = tmp_path_factory.mktemp("gpu")
    weights = write_lpips_weights(root / "weights", "alex")
    return train_arguments(tiny_dataset, root / "run", "--device", "cuda", "--lpips-weights", weights)


@pytest.fixture(scope="module")
def trained(arguments):
    assert train_command(*arguments) == 0
    return Path(arguments[arguments.index("--out") + 1])


def test_training_and_scoring(trained):
    last = json.loads((trained / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["lpips"] > 0
    assert all(math.isfinite(value) for value in last.values())
    results = json.loads((trained / "results.json").read_text())
    assert results["lpips"] > 0
    assert "lpips_reason" not in results
    assert 10 < results["psnr"] < 40


def test_going_on_from_a_checkpoint(trained, arguments):
    """A run whose second half is done again ends near where it ended: torch's own operators may add in
    another order."""
    last = trained / "checkpoints" / "step_000006"
    before, scored = (
        load_file(trained / "avatar" / "avatar.safetensors"),
        json.loads((trained / "results.json").read_text()),
    )
    (last / "training.json").unlink()
    assert train_command(*arguments, "--resume") == 0
    after = load_file(trained / "avatar" / "avatar.safetensors")
    assert (last / "training.json").is_file()
    # three steps at rates up to 1e-2: noise turns single ones that have next to no gradient, a lost optimiser
    # state turns them all
    assert (after["light.diffuse"] - before["light.diffuse"]).abs().mean() < 1e-3
    assert json.loads((trained / "results.json").read_text())["psnr"] == pytest.approx(
        scored["psnr"], abs=0.1
    )


def test_rendering_agrees_with_the_cpu(trained, tmp_path):
    for device in ("cuda", "cpu"):
        assert (
            render_command(
                "--avatar", trained, "--out", tmp_path / device, "--layers", "image", "normal", device=device
            )
            == 0
        )
    for layer in ("image", "normal"):
        ours, theirs = (
            read_image(tmp_path / device / layer / "00004_00.png", channels=3) for device in ("cuda", "cpu")
        )
        # sums in other orders move a value across a rounding edge of 8 bits, and at silhouettes a pixel
        # across COVERED_ALPHA
        assert (np.abs(ours - theirs) > 1.5 / 255).mean() < 0.01, layer


def test_exporting(trained, tmp_path):
    path = tmp_path / "avatar.ply"
    command = [
        *warm_python(),
        str(TESTS.parent / "tools" / "export_ply.py"),
        "--avatar",
        str(trained),
        "--out",
        str(path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert PlyData.read(str(path))["vertex"].count == len(Avatar.load(trained).gaussians)


def test_measuring(capsys):
    arguments = ["avatar", "--device", "cuda", "--json"]
    assert run(bench_main, BenchConfig, program="python -m samira_warp.bench", arguments=arguments) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["size"] for row in rows] == [256, 512]
    assert all(row["total_ms"] > 0 and row["gaussians"] > 0 for row in rows)
