"""Warp starts without a word, and no word of anybody else's is lost."""

import os
import subprocess
import sys
import textwrap

import pytest

STAND_IN = """
import os, sys
import warp as wp
from samira_warp.support import warp_start

def init():
    os.write(2, b"from native code\\n")
    os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. No GPU.\\n")
    print("from Python", file=sys.stderr)
    os.write(2, b"without an end")

wp.init = init
warp_start._has_driver = lambda: DRIVER
print("before", file=sys.stderr)
warp_start.start_warp()
print("; after", file=sys.stderr)
"""


def run(code, *, shell_ending=""):
    command = [sys.executable, "-c", textwrap.dedent(code)]
    if shell_ending:
        command = ["sh", "-c", f'exec "$@" {shell_ending}', "sh", *command]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done


def test_nothing_is_said_and_warp_works():
    done = run(
        """
        from samira_warp.support.warp_start import start_warp
        start_warp()
        import warp as wp
        assert "cpu" in {device.alias for device in wp.get_devices()}
        assert wp.config.log_level == wp.LOG_WARNING
        """
    )
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the driver's name is Linux's")
def test_only_the_line_about_the_driver_is_left_out():
    kept = ["before", "from native code", "from Python", "without an end; after"]
    assert run(STAND_IN.replace("DRIVER", "False")).stderr.splitlines() == kept
    said = run(STAND_IN.replace("DRIVER", "True")).stderr.splitlines()
    assert [line for line in said if "NVIDIA" not in line] == kept
    assert len(said) == len(kept) + 1


@pytest.mark.skipif(os.name != "posix", reason="closes standard error by a shell")
@pytest.mark.parametrize("ending", ["2>&-", "2>/dev/full"])
def test_it_starts_where_nothing_can_be_written(ending):
    code = "from samira_warp.support.warp_start import start_warp; start_warp(); print('started')"
    assert run(code, shell_ending=ending).stdout == "started\n"


def test_whoever_has_started_warp_keeps_what_was_set():
    run(
        """
        import warp as wp
        wp.config.log_level = wp.LOG_ERROR
        wp.init()
        from samira_warp.support.warp_start import start_warp, warp_may_talk
        start_warp()
        assert wp.config.log_level == wp.LOG_ERROR
        assert not warp_may_talk()
        """
    )
