"""What a training takes of memory, by stage; and that the system's own count is read rightly."""

import json
import mmap
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from subjects import SMALL, small_preset

from samira_warp.bench import memory, resident
from samira_warp.bench.__main__ import BenchConfig
from samira_warp.bench.__main__ import main as bench_main
from samira_warp.support.errors import UserError

SIZE = 64 << 20

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads what Linux tells")


@linux
def test_a_peak_is_that_since_it_was_forgotten():
    resident.forget_peak()
    before = resident.resident()
    with mmap.mmap(-1, SIZE) as block:  # of the system's own pages, which go back to it
        for page in range(0, SIZE, mmap.PAGESIZE):
            block[page] = 1
        during = resident.resident()
    after = resident.resident()
    # what else this process does meanwhile is less than a sixteenth of it
    assert during.now - before.now >= 15 / 16 * SIZE
    assert after.now - before.now <= 1 / 16 * SIZE
    assert after.peak >= before.now + 15 / 16 * SIZE
    resident.forget_peak()
    assert resident.resident().peak <= after.peak - 15 / 16 * SIZE


@pytest.mark.parametrize(("name", "call"), [("_STATUS", resident.resident), ("_CLEAR", resident.forget_peak)])
def test_a_system_that_does_not_tell_is_a_users_mistake(monkeypatch, tmp_path, name, call):
    monkeypatch.setattr(resident, name, tmp_path / "nowhere" / "status")
    with pytest.raises(UserError, match=r"bench memory.*nowhere.*No such file"):
        call()


@linux
def test_rows_follow_a_training(tiny_dataset, monkeypatch, capsys):
    monkeypatch.setattr(memory, "STEPS", 12)
    monkeypatch.setattr(memory, "LAST_STEPS", 2)
    with small_preset():
        bench_main(BenchConfig("memory", device="cpu", json=True, data=tiny_dataset))
    rows = json.loads(capsys.readouterr().out)
    assert all(set(row) == {field.name for field in fields(memory.Row)} | {"hardware"} for row in rows)
    assert [row["stage"] for row in rows] == [
        *("imports", "dataset opened", "avatar made", "first step", "steps", "Gaussians added"),
        *("unseen guessed", "all frames kept", "steps after it", "saved", "scored"),
    ]
    for row in rows:
        assert row["peak_bytes"] >= row["after_bytes"] > 50 * 2**20
        assert row["gpu_peak_bytes"] is None
    by_name = {row["stage"]: row for row in rows}
    assert by_name["dataset opened"]["frames_bytes"] == by_name["dataset opened"]["gaussians"] == 0
    assert by_name["first step"]["gaussians"] == SMALL.gaussians < by_name["scored"]["gaussians"]
    assert 0 < by_name["first step"]["traced_bytes"] < by_name["all frames kept"]["traced_bytes"]
    kept = by_name["all frames kept"]["frames_bytes"]
    assert by_name["first step"]["frames_bytes"] <= kept == by_name["scored"]["frames_bytes"]


def test_a_table_is_in_megabytes(capsys, monkeypatch):
    row = memory.Row("steps", 900_400_000, 800_600_000, 1_000_000, 0, 20_000, None)
    monkeypatch.setattr(memory, "measure", lambda device, data: [row])
    memory.main("cpu", False, Path())
    _, head, line = capsys.readouterr().out.splitlines()
    assert head.split() == ["stage", "peak_mb", "after_mb", "frames_mb", "traced_mb", "gaussians"]
    assert line.split() == ["steps", "900", "801", "1", "0", "20000"]


@pytest.mark.parametrize(("option", "what"), [("data", "train"), ("film", "memory"), ("hdri", "memory")])
def test_an_option_of_another_measurement_is_refused(tmp_path, option, what):
    with pytest.raises(UserError, match=f"--{option}"):
        bench_main(BenchConfig(what, device="cpu", **{option: tmp_path}))
