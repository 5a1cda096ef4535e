import errno
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
from tyro.conf import Positional

from samira_warp.support.cli import nearest, run
from samira_warp.support.errors import UserError, in_words


@dataclass(frozen=True)
class Config:
    """A verb."""

    size: int = 1
    """A size."""
    frame_count: int = 1
    """Frames."""
    mode: Literal["slow", "fast"] | None = None
    """How."""
    dry: bool = False
    """Do nothing."""
    out: Path | None = None
    """Where."""


def outcome(main, *arguments):
    return run(main, Config, program="verb", arguments=arguments)


def raising(error):
    def main(config):
        raise error

    return main


def test_success_passes_the_options():
    seen = []
    assert outcome(seen.append, "--size", "3") == 0
    assert seen == [Config(3)]
    assert outcome(seen.append, "--frame_count=2", "--dry", "--no-dry", "--size", "-1") == 0
    assert seen[1] == Config(-1, frame_count=2)


@pytest.mark.parametrize(
    "error",
    [UserError("f.png", expected="an image", found="none"), FileNotFoundError(2, "No such\nfile", "f.png")],
)
def test_a_users_mistake_is_one_line_and_status_two(capsys, error):
    assert outcome(raising(error)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert "f.png" in captured.err


SYSTEMS = {
    FileNotFoundError(errno.ENOENT, "No such file", "f.png"): "f.png: expected a file or folder, found none",
    PermissionError(
        errno.EACCES, "Denied", "f.png"
    ): "f.png: may not be read or written by this user (Denied)",
    OSError(errno.ENOSPC, "No space left on device", "f.png"): "f.png: cannot be written: the disk is full",
    OSError(
        errno.ENOSPC, "No space left on device"
    ): "a file of this run: cannot be written: the disk is full",
    IsADirectoryError(errno.EISDIR, "Is a directory", "f"): "f: expected a file, found a folder",
    OSError(errno.ETXTBSY, "Text file busy", "f"): "f: cannot be read or written (Text file busy)",
    OSError(errno.EXDEV, "Invalid link", "a", None, "b"): "a to b: cannot be read or written (Invalid link)",
    OSError("f.png: cannot be written: 3 bytes"): "f.png: cannot be written: 3 bytes",
    OSError(errno.ECONNREFUSED, "Connection refused"): "[Errno 111] Connection refused",
    OSError(): "a file cannot be read or written (OSError)",
}


@pytest.mark.parametrize("error", SYSTEMS)
def test_the_systems_errors_become_sentences(error, capsys):
    assert outcome(raising(error)) == 2
    assert capsys.readouterr().err.startswith(f"error: {SYSTEMS[error]}")


def test_a_failed_call_of_the_system_names_its_file(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(OSError) as caught:
            path.read_text()
        assert in_words(caught.value).startswith(f"{path}: expected a file")


def test_options_are_named_with_their_dashes(capsys):
    assert outcome(raising(UserError("size", expected="a size", found="none"))) == 2
    assert capsys.readouterr().err == "error: --size: expected a size, found none\n"
    assert outcome(raising(UserError("frame_count", expected="1", found=0))) == 2
    assert capsys.readouterr().err == "error: --frame-count: expected 1, found 0\n"
    # a path may be called as its option is, and other things have names too
    for subject in (Path("out"), "colour", "size of it"):
        assert outcome(raising(UserError(subject, expected="a size", found="none"))) == 2
        assert capsys.readouterr().err == f"error: {subject}: expected a size, found none\n"


def test_ctrl_c_is_status_130(capsys):
    assert outcome(raising(KeyboardInterrupt())) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_a_defect_of_ours_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        outcome(raising(ZeroDivisionError()))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--size", "large"), "--size"),
        (("--size", "1", "--colour", "red"), "--colour"),
        (("--size",), "--size"),
    ],
)
def test_a_wrong_option_is_one_line_and_status_two(capsys, options, named):
    with pytest.raises(SystemExit) as left:
        outcome(print, *options)
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert "─" not in line
    assert line.endswith("; see verb --help")


@dataclass(frozen=True)
class Named:
    """A verb with a word of its own."""

    what: Positional[str]
    """What."""
    size: int
    """A size."""
    tie_light: bool | None = None
    """Tied."""


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("a", "--sizes", "3"), "unknown option --sizes, did you mean --size?"),
        (("a", "--Size=3"), "unknown option --Size, did you mean --size?"),
        (
            ("a", "--size", "3", "--no-tie_lihgt"),
            "unknown option --no-tie-lihgt, did you mean --no-tie-light?",
        ),
        (("a", "--what", "3"), "unknown option --what"),
        (("a", "--colour", "red"), "unknown option --colour"),
    ],
)
def test_an_unknown_option_names_the_nearest(capsys, words, complaint):
    """Also where another option is missing because of it."""
    with pytest.raises(SystemExit) as left:
        run(print, Named, program="verb", arguments=words)
    assert left.value.code == 2
    assert capsys.readouterr().err == f"error: {complaint}; see verb --help\n"


def test_wrong_choices_are_told_from_right_ones_in_their_order(capsys):
    with pytest.raises(SystemExit):
        outcome(print, "--mode", "quick")
    assert "Expected one of ('slow', 'fast')" in capsys.readouterr().err


def test_nearest():
    assert nearest("rendr", ["train", "render"]) == "render"
    assert nearest("paint", ["render", "check"]) is None


WRITER = """
import sys
from dataclasses import dataclass
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

@dataclass(frozen=True)
class Config:
    \"\"\"A verb.\"\"\"
    lines: int = 1

def main(config):
    for _ in range(config.lines):
        print("a line of some words")
    if config.lines == 2:
        raise UserError("it", expected="one line", found="two")

sys.exit(run(main, Config, program="verb"))
"""


@pytest.mark.parametrize("options", [["--help"], ["--lines", "1"], ["--lines", "2"], ["--lines", "100000"]])
@pytest.mark.parametrize("buffered", [True, False], ids=["buffered", "unbuffered"])
def test_a_reader_that_leaves_is_no_defect(options, buffered):
    """As ``| head -1`` does: no traceback, and no complaint of the interpreter at its end."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, *(() if buffered else ("-u",)), "-c", WRITER, *options],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        check=False,
    )
    os.close(write)
    assert done.returncode == 141
    # what is wrong is said where it was known before the reader left
    said = "error: it: expected one line, found two\n" if options[1:] == ["2"] and buffered else ""
    assert done.stderr == said


def test_a_pipe_of_our_own_that_breaks_is_a_mistake(capsys):
    assert outcome(raising(BrokenPipeError(errno.EPIPE, "Broken pipe"))) == 2
    assert "Broken pipe" in capsys.readouterr().err


def test_help_goes_to_standard_output(capsys):
    with pytest.raises(SystemExit) as left:
        outcome(print, "--help")
    assert left.value.code == 0
    said = capsys.readouterr()
    assert "--size" in said.out
    assert not said.err
