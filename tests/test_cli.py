from dataclasses import dataclass

import pytest

from samira_warp.cli import run
from samira_warp.errors import UserError


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


@pytest.mark.parametrize("error", [UserError("f.png", expected="an image", found="none"), FileNotFoundError(2, "No such\nfile", "f.png")])
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


def test_a_wrong_option_is_status_two():
    with pytest.raises(SystemExit) as left:
        outcome(print, "--size", "large")
    assert left.value.code == 2
