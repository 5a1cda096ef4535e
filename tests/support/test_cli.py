from dataclasses import dataclass

import pytest

from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class Config:
    """A verb."""

    size: int = 1
    """A size."""


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


def test_help_goes_to_standard_output(capsys):
    with pytest.raises(SystemExit) as left:
        outcome(print, "--help")
    assert left.value.code == 0
    said = capsys.readouterr()
    assert "--size" in said.out
    assert not said.err
