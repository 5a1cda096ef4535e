"""Counts of small functions whose launches, operations and waits are known."""

import json
import re
import warnings

import pytest
import torch
import warp as wp
from subjects import TESTS, small_preset

from samira_warp.bench import counting, train
from samira_warp.bench.__main__ import main as bench_main
from samira_warp.bench.config import BenchConfig
from samira_warp.bench.counting import WorkCounter
from samira_warp.kernels.runtime.commands import Command
from samira_warp.kernels.runtime.launch import launch, launch_range, warp_array
from samira_warp.support.errors import UserError

CPU = torch.device("cpu")


@wp.kernel
def double(first: wp.int32, values: wp.array[wp.float32]):
    index = first + wp.tid()
    values[index] = 2.0 * values[index]


def counted(work):
    """The counts of a function, as one stage."""
    with WorkCounter(CPU) as counter, counter.stage("all"):
        work()
    return counter.counts["all"]


def test_launches_are_counted_as_a_gpu_has_them(use_threads):
    values = torch.ones(64)
    keys, order = torch.zeros(8, dtype=torch.int32), torch.zeros(8, dtype=torch.int32)

    def work():
        launch(double, 64, 0, values)
        launch_range(double, 64, values, grain=1)  # many pieces for two threads, one launch on a GPU
        launch_range(double, 0, values)  # nothing
        wp.utils.radix_sort_pairs(warp_array(keys), warp_array(order), 4)

    use_threads(2)
    run = Command.run
    counts = counted(work)
    assert counts.launches == {"double": 2, "radix_sort_pairs": 1}
    assert (values == 4.0).all()
    # all as it was
    assert torch.get_num_threads() == 2
    assert Command.run is run
    work()
    assert counts.launches["double"] == 2


def test_every_utility_of_warp_that_the_package_uses_is_counted():
    sources = (TESTS.parent / "samira_warp").rglob("*.py")
    used = {name for path in sources for name in re.findall(r"wp\.utils\.(\w+)\(", path.read_text("utf-8"))}
    assert used == set(counting.UTILITIES)


def test_operations_are_those_that_compute():
    values = torch.ones(4, 3)

    def work():
        values.view(3, 4).T[1:].expand(2, 3, 3)  # views
        torch.empty(5).shape, values.new_empty(2), values.detach().is_contiguous()
        torch.zeros(0)  # nothing in it
        (values + 1.0).contiguous()
        values.mul_(2.0)
        torch.cat([values, values])

    counts = counted(work)
    assert counts.operations == {"add": 1, "mul_": 1, "cat": 1}
    assert not counts.waits


def test_adjoints_are_counted_where_they_run():
    leaf = torch.ones(3, requires_grad=True)
    with WorkCounter(CPU) as counter:
        with counter.stage("forward"):
            squares = leaf * leaf
        with counter.stage("backward"):
            squares.sum().backward()
    assert counter.counts["forward"].operations == {"mul": 1}
    # the sum; the ones that it begins with; two products, and their sum
    assert counter.counts["backward"].operations == {"sum": 1, "ones_like": 1, "mul": 2, "add": 1}


def test_waits_are_told_by_what_they_want():
    values, mask = torch.ones(4), torch.tensor([True, False, True, False])

    def work():
        values[0].item(), float(values[1]), int(values[2])
        if values[3] > 0:
            pass
        mask.nonzero()
        values[mask]
        values[mask] = values[:2] + 1.0  # as many numbers as the mask has entries
        values[mask] = 0.0  # a masked fill, which need not know them
        values[torch.tensor([0, 1])]
        values.cpu(), values.tolist(), values.to("cpu"), values.to(CPU), values.to(torch.float64)
        torch.tensor([1.0], device=CPU), torch.as_tensor([1.0], device="cpu"), torch.tensor([1.0])
        torch.repeat_interleave(torch.tensor([1, 2]))
        torch.repeat_interleave(torch.tensor([1, 2]), output_size=3)

    counts = counted(work)
    # the reads of values stand in two lines
    reads = [times for wait, times in counts.waits.items() if wait.operation == "_local_scalar_dense"]
    assert sorted(reads) == [1, 3]
    others = {wait: times for wait, times in counts.waits.items() if wait.why != "a value read"}
    assert {(wait.why, wait.operation): times for wait, times in others.items()} == {
        ("a size read", "nonzero"): 1,
        ("a size read", "index"): 1,
        ("a size read", "index_put_"): 1,
        ("a size read", "repeat_interleave"): 1,
        ("a copy to the host", "cpu"): 1,
        ("a copy to the host", "tolist"): 1,
        ("a copy to the host", "to"): 1,
        ("a copy from the host", "tensor"): 1,
        ("a copy from the host", "as_tensor"): 1,
    }
    assert all(wait.where.startswith("test_counting.py:") for wait in counts.waits)


def test_a_wait_in_an_adjoint_of_torchs_own_is_named_by_it():
    leaf, mask = torch.ones(4, requires_grad=True), torch.tensor([True, False, True, False])
    chosen = leaf[mask].sum()
    counts = counted(chosen.backward)
    (wait,) = counts.waits
    assert wait.why == "a size read"
    assert wait.where == "the adjoint IndexBackward0"


def test_an_error_inside_leaves_all_as_it_was():
    run, sort = Command.run, wp.utils.radix_sort_pairs
    with pytest.raises(ZeroDivisionError), WorkCounter(CPU) as counter, counter.stage("all"):
        raise ZeroDivisionError
    assert (Command.run, wp.utils.radix_sort_pairs) == (run, sort)
    torch.ones(2).sum()
    assert not counter.counts["all"].operations


def test_what_cuda_tells_of_is_counted_by_stage(monkeypatch):
    """Torch's switch and its warning, on a machine without a GPU."""
    modes = ["default"]
    monkeypatch.setattr(torch.cuda, "get_sync_debug_mode", lambda: modes[-1])
    monkeypatch.setattr(torch.cuda, "set_sync_debug_mode", modes.append)

    def wait():
        warnings.warn("called a synchronizing CUDA operation (Triggered internally ...)", stacklevel=1)

    def work():
        with WorkCounter(torch.device("cuda")) as counter:
            assert modes[-1] == "warn"
            with counter.stage("first"):
                wait()
                wait()
                warnings.warn("another", stacklevel=1)
                torch.ones(2).sum()  # the host's own
            with counter.stage("second"):
                pass
            wait()  # of no stage
        return counter

    with pytest.warns(UserWarning, match="another") as others:
        counter = work()
    assert modes[-1] == "default"
    assert {name: counts.warned for name, counts in counter.counts.items()} == {"first": 2, "second": 0}
    assert not counter.counts["first"].operations
    assert len(others) == 1


def test_a_steps_waits_are_found_where_they_are(monkeypatch, capsys):
    """A wait is put into the loss, and the table names stage and line."""
    loss = train.total_loss

    def waiting_loss(*arguments, **options):
        terms = loss(*arguments, **options)
        float(terms["l1"].detach())
        return terms

    monkeypatch.setattr(train, "total_loss", waiting_loss)
    with small_preset():
        bench_main(BenchConfig(what="train", device="cpu", json=True, count=True))
        rows = {row["stage"]: row for row in json.loads(capsys.readouterr().out)}
        bench_main(BenchConfig(what="train", device="cpu", count=True))
    stages = [
        "light",
        "motion",
        "arrival",
        "raster",
        "shading",
        "loss",
        "backward",
        "light learns",
        "optimizer",
    ]
    assert list(rows) == stages
    put = [wait for wait in rows["loss"]["waits"] if wait["where"].startswith("test_counting.py:")]
    assert [(wait["operation"], wait["times"]) for wait in put] == [("_local_scalar_dense", 1)]
    # the rasteriser reads the number of intersections
    assert any(wait["where"].startswith("kernels/raster/tiles.py:") for wait in rows["raster"]["waits"])
    for row in rows.values():
        assert row["told_by_cuda"] is None
        assert row["warp_launches"] == sum(row["kernels"].values())
        assert row["torch_operations"] == sum(row["operations"].values()) > 0
        assert row["synchronisations"] == sum(wait["times"] for wait in row["waits"])
    assert rows["raster"]["kernels"]["radix_sort_pairs"] >= 1
    assert rows["shading"]["warp_launches"] == 1

    _, stages_table, waits_table, most_table = re.split(r"\n\n|(?<=cpu)\n", capsys.readouterr().out)
    total, average = (line.split() for line in stages_table.splitlines()[-2:])
    sums = ("warp_launches", "torch_operations", "synchronisations")
    assert total == ["total", *(str(sum(row[name] for row in rows.values())) for name in sums)]
    # the light's stages are those of every fourth step
    spared = 0.75 * sum(rows[stage]["torch_operations"] for stage in ("light", "light learns"))
    assert average[:2] == ["on", "average"]
    assert float(average[3]) == pytest.approx(float(total[2]) - spared, abs=0.06)
    assert sum("test_counting.py:" in line for line in waits_table.splitlines()) == 1
    assert len(most_table.splitlines()) == 2 + train.MOST


def test_only_a_step_is_counted():
    with pytest.raises(UserError, match="--count: expected bench train, found bench raster"):
        bench_main(BenchConfig(what="raster", device="cpu", count=True))
