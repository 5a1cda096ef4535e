"""Four small subjects on two cores, one of them broken, one of whose workers is killed."""

import json
import os
import re
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
from subjects import TESTS
from warm_start import warm_python

from samira_warp.fleet import FleetConfig, fleet, stages
from samira_warp.support.errors import UserError

ray = pytest.importorskip("ray", reason="Ray is not installed (the extra fleet)")

MANIFEST = """
[train]
preset = "cpu"
encoder = "random"
max-steps = 6
checkpoint-every = 3
preview-every = 3

[resources.train]
memory-gb = 0.5
[resources.evaluate]
memory-gb = 0.5
[resources.export]
memory-gb = 0.5
"""

LONG = 30
"""Steps of the subject whose worker is killed: some of them are left when its first checkpoint is there."""


@pytest.fixture(scope="module", autouse=True)
def one_ray():
    """Two cores; started once for all tests of this file."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    ray.init(
        address="local", num_cpus=2, num_gpus=0, include_dashboard=False, log_to_driver=False,
        object_store_memory=80_000_000, logging_level="error",
    )  # fmt: skip
    yield
    ray.shutdown()


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    """Verbs begin at once, and train small avatars."""
    monkeypatch.setattr(stages, "PYTHON", (*warm_python(), str(TESTS / "fleet" / "small.py")))


def row(name, data, more=""):
    return f'\n[[subject]]\nname = "{name}"\ndata = "{data}"\n{more}\n'


def kill_worker(folder, killed):
    """Kill the worker of a training once its first checkpoint is there."""
    mark, checkpoint = folder / "stages" / "train.json", folder / "run" / "checkpoints" / "step_000003"
    while not killed.wait(0.01):
        if checkpoint.exists():
            os.kill(json.loads(mark.read_text())["worker"], signal.SIGKILL)
            return


@pytest.fixture(scope="module")
def four(made_once, tiny_dataset):
    """The folder of a fleet that has ended, with its manifest and what it said in the end."""

    def make(folder):
        folder.mkdir()
        broken = shutil.copytree(tiny_dataset, folder / "broken")
        (broken / "images" / sorted(path.name for path in (broken / "images").iterdir())[1]).write_bytes(b"x")
        manifest = folder / "four.toml"
        rows = [
            row("anna", tiny_dataset),
            row("ben", "broken"),
            row("cleo", tiny_dataset, f"train.max-steps = {LONG}"),
        ]
        rows += [row("dora", tiny_dataset, f"train.max-steps = {LONG}")]
        manifest.write_text(MANIFEST + "".join(rows))
        over = threading.Event()
        killer = threading.Thread(target=kill_worker, args=(folder / "out" / "dora", over))
        killer.start()
        patch = pytest.MonkeyPatch()
        patch.setattr(stages, "PYTHON", (*warm_python(), str(TESTS / "fleet" / "small.py")))
        try:
            with pytest.raises(UserError) as failed:
                fleet(FleetConfig(manifest, folder / "out"))
        finally:
            patch.undo()
            over.set()
            killer.join()
        (folder / "said").write_text(str(failed.value))

    return made_once("fleet", make)


def results(folder):
    return {row["subject"]: row for row in json.loads((folder / "out" / "fleet.json").read_text())}


def test_the_others_finish_and_the_table_says_which_failed_and_why(four):
    found = results(four)
    assert {name: row["state"] for name, row in found.items()} == {
        "anna": "done", "ben": "failed", "cleo": "done", "dora": "done",
    }  # fmt: skip
    assert found["ben"]["stage"] == "train"
    image = r"broken/images/\S+: expected "
    assert re.search(image, found["ben"]["why"])
    assert re.search(
        r"all 4 subjects to be done, found 1 failed, the first is ben \(train: .*" + image,
        (four / "said").read_text(),
    )
    table = (four / "out" / "fleet.md").read_text()
    assert table.startswith("# 4 subjects: 3 done, 1 failed\n")
    assert "| ben | failed: train |" in table
    assert f"- **ben**, train: {found['ben']['why']}" in table


def test_a_subject_that_is_done_has_scores_and_files(four):
    anna = results(four)["anna"]
    scores = json.loads((four / "out" / "anna" / "run" / "results.json").read_text())
    # the same pictures, scored by another verb
    assert anna["scores"]["psnr"] == pytest.approx(scores["psnr"], abs=1e-6)
    assert anna["scores"]["ssim"] == pytest.approx(scores["ssim"], abs=1e-6)
    assert anna["test_frames"] == 2
    assert set(anna["files"]) == {"avatar", "pictures", "export"}
    assert all((four / "out" / path).exists() for path in anna["files"].values())
    links = re.findall(r"\]\(([^)]+)\)", (four / "out" / "fleet.md").read_text())
    assert len(links) == 3 * 3 + 1  # and the broken one's log
    assert all((four / "out" / link).exists() for link in links)


def test_a_subjects_bits_are_those_of_the_verb_alone(four, tiny_run):
    """Which worker had it, and what that had done before, changes nothing."""
    if json.loads((tiny_run / "config.json").read_text())["torch_threads"] != 1:
        pytest.skip(
            "the run that is compared with has other threads than the stages' one (OMP_NUM_THREADS=1)"
        )
    alone = (tiny_run / "avatar" / "avatar.safetensors").read_bytes()
    assert (four / "out" / "anna" / "run" / "avatar" / "avatar.safetensors").read_bytes() == alone
    assert (four / "out" / "cleo" / "run" / "avatar" / "avatar.safetensors").read_bytes() != alone


def test_a_killed_workers_training_goes_on_to_the_same_bits(four):
    mark = json.loads((four / "out" / "dora" / "stages" / "train.json").read_text())
    assert (mark["state"], mark["tries"]) == ("done", 2)
    steps = [
        json.loads(line)["step"]
        for line in (four / "out" / "dora" / "run" / "metrics.jsonl").read_text().splitlines()
    ]
    assert steps == sorted(set(steps))  # each once
    assert {25, LONG} <= set(steps)
    others = [json.loads(path.read_text()) for path in four.glob("out/*/stages/*.json")]
    assert sum(record["tries"] for record in others) == len(others) + 1
    log = (four / "out" / "dora" / "stages" / "train.log").read_text()
    assert log.count("4 training and 2 test frames") == 2
    whole, killed = (
        four / "out" / name / "run" / "avatar" / "avatar.safetensors" for name in ("cleo", "dora")
    )
    assert whole.read_bytes() == killed.read_bytes()


def test_the_same_command_again_keeps_what_is_done(four, capsys):
    """Whatever ended it, a killed head too: the marks on the disk are all that it knows."""
    mark = {path: path.read_bytes() for path in four.glob("out/*/stages/*.json")}
    before = {path: path.stat().st_mtime_ns for path in four.glob("out/*/run/avatar/*")}
    with pytest.raises(UserError, match="1 failed, the first is ben"):
        fleet(FleetConfig(four / "four.toml", four / "out"))
    said = capsys.readouterr()
    assert "anna" not in said.err
    assert said.out == (four / "out" / "fleet.md").read_text()
    assert {path: path.stat().st_mtime_ns for path in four.glob("out/*/run/avatar/*")} == before
    ben = four / "out" / "ben" / "stages" / "train.json"
    assert {path for path, content in mark.items() if path.read_bytes() != content} == {ben}
    assert json.loads(ben.read_text())["tries"] == 2


def test_one_row_without_ray(tiny_dataset, tmp_path):
    """What a task of the SLURM array does; its script is a shell's."""
    script = tmp_path / "job.sh"
    manifest = tmp_path / "two.toml"
    manifest.write_text(
        MANIFEST + "[resources.prepare]\ncores = 3\n" + row("one", tiny_dataset) + row("gone", "nowhere")
    )
    fleet(FleetConfig(manifest, tmp_path / "out", slurm=script))
    text = script.read_text()
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    assert "#SBATCH --array=0-1\n" in text
    assert "#SBATCH --cpus-per-task=1\n" in text  # nothing is prepared
    assert "#SBATCH --mem=500M\n" in text
    assert "gres" not in text
    assert f'{manifest} --out {tmp_path / "out"} --retries 2 --row "$SLURM_ARRAY_TASK_ID"' in text
    with pytest.raises(UserError, match=r"gone \(train: .*nowhere: expected"):
        fleet(FleetConfig(manifest, tmp_path / "out", row=1))
    rows = {row["subject"]: row["state"] for row in json.loads((tmp_path / "out" / "fleet.json").read_text())}
    assert rows == {"one": "waiting", "gone": "failed"}
    with pytest.raises(UserError, match="--row: expected 0 to 1, of the manifest, found 2"):
        fleet(FleetConfig(manifest, tmp_path / "out", row=2))


def test_a_stage_that_no_machine_has_room_for_is_refused(tiny_dataset, tmp_path):
    manifest = tmp_path / "big.toml"
    manifest.write_text("[resources.train]\ncores = 3\n" + row("one", tiny_dataset))
    with pytest.raises(UserError, match="a machine with 3 cores, 0 GPUs and 4 GB, found 2 cores"):
        fleet(FleetConfig(manifest, tmp_path / "out"))


def test_what_a_worker_started_dies_with_it(tmp_path):
    """Where the system can: the stage is begun again, and may not find the first try at work."""
    if stages._end_with(os.getpid()) is None:
        pytest.skip("only Linux ends a process with the one that started it")

    @ray.remote(max_retries=0)
    def work(path):
        import subprocess
        import sys

        from samira_warp.fleet import stages

        command = [sys.executable, "-S", "-c", "import time; time.sleep(60)"]
        child = subprocess.Popen(command, preexec_fn=stages._end_with(os.getpid()))
        path.write_text(f"{os.getpid()} {child.pid} ")
        child.wait()

    path = tmp_path / "processes"
    task = work.remote(path)
    while not (path.exists() and path.read_text().endswith(" ")):
        time.sleep(0.01)
    worker, child = map(int, path.read_text().split())
    os.kill(worker, signal.SIGKILL)
    with pytest.raises(ray.exceptions.WorkerCrashedError):
        ray.get(task)
    for _ in range(500):
        try:
            state = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return
        if state == "Z":
            return
        time.sleep(0.01)
    raise AssertionError("the child lives on")
