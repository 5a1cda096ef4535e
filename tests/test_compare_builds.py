"""Two revisions beside each other, on small repositories whose one number is known."""

import importlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time

import pytest
from subjects import TESTS
from warm_start import warm_python

TOOL = TESTS.parent / "tools" / "compare_builds.py"
AUTHOR = ["-c", "user.name=Nobody", "-c", "user.email=nobody@example.org"]


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    return importlib.import_module("compare_builds")


def git(repository, *words):
    command = ["git", "-C", str(repository), *AUTHOR, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def repository(tmp_path):
    """Two revisions of a package: it says 1.5, then 3.0."""
    root = tmp_path / "repository"
    package = root / "samira_warp"
    package.mkdir(parents=True)
    git(root, "init", "--quiet")
    for name, number in (("before", 1.5), ("after", 3.0)):
        (package / "__init__.py").write_text(f"NUMBER = {number}\n")
        git(root, "add", ".")
        git(root, "commit", "--quiet", "-m", f"Say {number}")
        git(root, "tag", name)
    return root


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder in which temporary ones are made."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def arguments(repository, program, *more):
    command = shlex.join(["python", "-c", f"import samira_warp, json; {program}"])
    return [
        *("before", "--repository", str(repository), "--reuse-environment", "--rounds", "2"),
        *("--command", command, *more),
    ]


def nothing_is_left(repository, temporary):
    listed = git(repository, "worktree", "list").splitlines()
    return len(listed) == 1 and not any(temporary.glob("builds-*"))


def test_a_number_that_doubled_is_found_as_a_user_finds_it(repository, temporary):
    rows = "[{'of': w, 'size': 3, 'ms': k * samira_warp.NUMBER} for w, k in (('a', 1), ('b', 2))]"
    program = f"print('some text'); print(json.dumps({rows}))"
    command = [*warm_python(), str(TOOL), *arguments(repository, program)]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [told[side]["commit"].split(" ", 1)[1] for side in ("old", "new")] == ["Say 1.5", "Say 3.0"]
    assert "PYTHONPATH" in told["environment"]
    (job,) = told["jobs"]
    numbers = {row["what"]: row for row in job["numbers"]}
    # the size, a whole number that never changes, is none of them
    assert set(numbers) == {"seconds", "processor seconds", "of=a ms", "of=b ms"}
    for name, old in (("of=a ms", 1.5), ("of=b ms", 3.0)):
        row = numbers[name]
        assert (row["old"], row["new"], row["difference"]) == (old, 2 * old, old)
        assert (row["ratio"], row["least"], row["greatest"]) == (2.0, 2.0, 2.0)
    assert 0 < numbers["seconds"]["least"] <= numbers["seconds"]["ratio"] <= numbers["seconds"]["greatest"]
    assert nothing_is_left(repository, temporary)

    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "environment: this one for both" in done.stdout
    assert "| of=a ms | 1.5 | 3 | 2.000 | 2.000 to 2.000 | +1.5 |" in done.stdout.splitlines()


def test_both_are_run_in_turns(tool, repository, temporary, tmp_path):
    log = tmp_path / "log"
    program = f"open({str(log)!r}, 'a').write(f'{{samira_warp.NUMBER}} ')"
    words = arguments(repository, program)
    assert tool.run(tool.main, tool.BuildsConfig, program="compare_builds", arguments=words) == 0
    # a warm-up of each, then A B B A
    assert log.read_text().split() == ["3.0", "1.5", "1.5", "3.0", "3.0", "1.5"]


def test_a_command_that_fails_is_said_and_leaves_nothing(tool, repository, temporary, capsys):
    words = arguments(repository, "raise SystemExit('no such option')")
    assert tool.run(tool.main, tool.BuildsConfig, program="compare_builds", arguments=words) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "status 1: no such option" in said
    assert nothing_is_left(repository, temporary)


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--new", "nowhere"], "--new"),
        (["--rounds", "0"], "--rounds"),
        (["--data", "."], "--data"),
        (["--steps", "0"], "--steps"),
        (["--command", ""], "--command"),
    ],
)
def test_what_cannot_be_is_refused(tool, repository, temporary, capsys, more, named):
    words = [*arguments(repository, "pass"), *more]
    assert tool.run(tool.main, tool.BuildsConfig, program="compare_builds", arguments=words) == 2
    assert named in capsys.readouterr().err.splitlines()[-1]
    assert nothing_is_left(repository, temporary)


def test_ctrl_c_takes_the_worktrees_away(repository, temporary, tmp_path):
    begun = tmp_path / "begun"
    program = f"import time; open({str(begun)!r}, 'w').close(); time.sleep(60)"
    command = [sys.executable, str(TOOL), *arguments(repository, program)]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        while not begun.exists():
            assert process.poll() is None
            time.sleep(0.02)
        assert len(git(repository, "worktree", "list").splitlines()) == 3
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=60) == 130
    finally:
        process.kill()
        process.wait()
    assert nothing_is_left(repository, temporary)


def test_each_build_has_an_environment_of_its_own(tool, repository, tmp_path, monkeypatch):
    (repository / "constraints.txt").touch()
    called = []

    def checked(words, folder, variables):
        called.append((words, folder))
        assert "PYTHONPATH" not in variables
        return str(repository / "samira_warp" / "__init__.py")

    monkeypatch.setattr(tool, "_checked", checked)
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    build = tool.make_build("after", repository, tmp_path)
    own = tmp_path / "repository_environment"
    assert build.python == str(own / "bin" / "python")
    assert called[0][0] == [sys.executable, "-m", "venv", str(own)]
    installed = [build.python, "-m", "pip", "install", "--quiet", "-c", "constraints.txt", "-e", "."]
    assert called[1] == (installed, repository)


def test_a_package_from_elsewhere_is_not_compared(tool, repository, tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "_checked", lambda *_: str(tmp_path / "samira_warp" / "__init__.py"))
    with pytest.raises(tool.UserError, match=f"expected samira_warp of {repository}"):
        tool.make_build("after", repository, None)


def run_folder(folder, *, psnr, seconds, avatar):
    (folder / "avatar").mkdir(parents=True)
    (folder / "avatar" / "avatar.safetensors").write_bytes(avatar)
    (folder / "results.json").write_text(json.dumps({"psnr": psnr, "lpips": None, "frames": {}}))
    (folder / "metrics.jsonl").write_text(f'{{"step": 1}}\n{{"step": 2, "seconds": {seconds}}}\n')
    return folder


def test_trainings_are_compared_by_scores_and_bits(tool, tmp_path):
    olds = [run_folder(tmp_path / f"old{n}", psnr=30.0, seconds=10 + n, avatar=b"one") for n in range(3)]
    news = [
        run_folder(tmp_path / f"new{n}", psnr=31.0, seconds=5 + n, avatar=b"one" if n else b"two")
        for n in range(3)
    ]
    rounds = [(tool.scores(old), tool.scores(new)) for old, new in zip(olds, news, strict=True)]
    lines = {line.what: line for line in tool.compared(rounds)}
    assert set(lines) == {"psnr", "seconds of the steps"}
    assert lines["psnr"].difference == 1.0
    seconds = lines["seconds of the steps"]
    # 5/10, 6/11, 7/12
    assert (seconds.old, seconds.new) == (11.0, 6.0)
    assert (seconds.least, seconds.ratio, seconds.greatest) == (0.5, 6 / 11, 7 / 12)
    assert tool.equal_avatars(rounds) == 2
    assert tool.equal_avatars([({"ms": 1.0}, {"ms": 1.0})]) is None


def test_training_words_and_its_warm_up(tool, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(tool, "timed", lambda build, words: asked.append(words) or ("", {"seconds": 1.0}))
    monkeypatch.setattr(tool, "scores", lambda out: {"psnr": 30.5})
    config = tool.BuildsConfig("before", steps=300, data=tmp_path / "data")
    ((says, warm_up, job),) = tool.jobs(config)  # training alone, where no command is named
    assert says == "300 steps of training"
    assert warm_up(None, tmp_path) == job(None, tmp_path) == {"seconds": 1.0, "psnr": 30.5}
    assert [words[-1] for words in asked] == [str(tool.WARM_UP_STEPS), "300"]
    assert ["--data", str(tmp_path / "data")] == asked[1][3:5]
    assert len([*tool.jobs(tool.BuildsConfig("before", steps=1, command="true"))]) == 2
