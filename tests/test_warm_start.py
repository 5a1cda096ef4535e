"""Processes that begin without importing anew end as any other would."""

import os
import signal
import subprocess
import sys
import time

import pytest
from warm_start import warm_python

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere they are processes like any other")


def run(*arguments, python=None, **options):
    return subprocess.run(
        [*(python or warm_python()), *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        **options,
    )


PROGRAMS = {
    "arguments": "import sys; print(sys.argv[1:])",
    "streams": "import sys; print(sys.stdin.read()); print('said', file=sys.stderr)",
    "a status": "raise SystemExit(3)",
    "a line": "raise SystemExit('no')",
    "a signal": "import os; os.kill(os.getpid(), 9)",
    "at its end": "import atexit; atexit.register(print, 'bye')",
    "a folder": "import os; print(os.getcwd(), os.environ['OWN'])",
    "threads": "import torch; print(torch.get_num_threads())",
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_does_as_in_a_process_of_its_own(tmp_path, name):
    options = {"input": "typed", "cwd": tmp_path, "env": {**os.environ, "OWN": "mine"}}
    warm = run("-c", PROGRAMS[name], "a", "b c", **options)
    fresh = run("-c", PROGRAMS[name], "a", "b c", python=[sys.executable], **options)
    assert (warm.returncode, warm.stdout, warm.stderr) == (fresh.returncode, fresh.stdout, fresh.stderr)


def test_modules_and_files_run_as_programs(tmp_path):
    (tmp_path / "beside.py").write_text("NAME = 'beside'")
    (tmp_path / "program.py").write_text("import beside, sys\nprint(__name__, beside.NAME, sys.argv)")
    said = run("program.py", "a", cwd=tmp_path)
    assert said.stdout == "__main__ beside ['program.py', 'a']\n", said.stderr
    assert run("-m", "program", "a", cwd=tmp_path).stdout.startswith("__main__ beside [")


def test_a_traceback_is_the_programs_and_the_status_one():
    ended = run("-c", "raise ValueError('mine')")
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1] == "ValueError: mine"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_signals_reach_it(number):
    waits = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*warm_python(), "-c", waits], **options) as begun:
        child = int(begun.stdout.readline())
        begun.send_signal(number)
        begun.communicate(timeout=60)
    assert begun.returncode == -number
    deadline = time.monotonic() + 60
    while is_there(child):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def is_there(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_what_is_read_at_loading_is_read_anew():
    own = run("-c", "import sys; print(sys.flags.utf8_mode)", env={**os.environ, "PYTHONUTF8": "1"})
    assert own.stdout == "1\n"
