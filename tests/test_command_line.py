"""``samira-warp VERB``, ``python -m samira_warp VERB`` and ``python -m samira_warp.VERB``, from outside."""

import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import samira_warp
from samira_warp.__main__ import VERBS, main

HEAVY = {"torch", "warp", "numpy", "transformers", "kornia", "scipy", "OpenImageIO", "av", "samira_subject"}


def command(*words, **options):
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=120, check=False, **options
    )


def test_every_verb_is_in_the_list_and_nothing_else():
    packages = {module.name for module in pkgutil.iter_modules(samira_warp.__path__, "") if module.ispkg}
    with_commands = {
        name
        for name in packages
        if "__main__"
        in {module.name for module in pkgutil.iter_modules([f"{samira_warp.__path__[0]}/{name}"])}
    }
    assert set(VERBS) == with_commands


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_help_lists_the_verbs_a_line_each(capsys, option):
    assert main([option]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [re.match(r"  (\w+)  +\w.*", line)[1] for line in lines if line.startswith("  ")] == list(VERBS)
    assert max(map(len, lines)) <= 80


def test_the_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"samira-warp {samira_warp.__version__}\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "expected a verb, one of prepare, "),
        (["rendr", "--help"], "rendr is none of the verbs prepare, "),
        (["rendr"], "did you mean render?"),
        (["--verson"], "--verson is none of the verbs"),
        (["xyz"], "bench; see samira-warp --help"),
    ],
)
def test_a_word_that_is_no_verb_is_one_line_and_status_two(capsys, words, complaint):
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("error: ")
    assert complaint in line
    assert line.endswith("; see samira-warp --help")


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("words", [["--help"], ["--resolutoin", "3"]], ids=["help", "wrong option"])
def test_a_verb_answers_without_loading_what_it_works_with(verb, words):
    """Help and a wrong option come at once: torch alone takes seconds."""
    script = (
        "import sys, runpy\n"
        f"sys.argv = ['samira-warp', {verb!r}, *{words!r}]\n"
        "try: runpy.run_module('samira_warp', run_name='__main__')\n"
        "except SystemExit as end: status = end.code\n"
        "print('loaded', status or 0, *sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    done = command("-c", script)
    status, *loaded = done.stderr.splitlines()[-1].removeprefix("loaded ").split()
    assert not HEAVY & set(loaded)
    assert status == ("0" if words == ["--help"] else "2"), done.stderr
    if words == ["--help"]:
        assert done.stdout.startswith(f"usage: samira-warp {verb} ")
    else:
        assert done.stderr.startswith("error: unknown option --resolutoin")


@pytest.mark.parametrize("verb", VERBS)
def test_a_verbs_module_is_the_same_command(verb):
    done = command("-m", f"samira_warp.{verb}", "--help")
    assert done.returncode == 0
    assert done.stdout.startswith(f"usage: python -m samira_warp.{verb} ")


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [("--region", "chin", "one of forehead"), ("--roughness", "rough", "a factor"), ("--exposure", "-1", "")],
)
def test_what_a_library_calls_an_argument_is_named_as_the_option_that_it_is(capsys, option, value, expected):
    words = ["render", "--avatar", "none", "--out", "none", "--specular", "x2", option, value]
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(f"error: {option}: expected {expected}")


def test_an_output_folder_is_tried_before_anything_long_begins(capsys, tmp_path):
    """The avatar is not there either, and would be looked for next."""
    (tmp_path / "file").write_text("mine")
    assert main(["render", "--avatar", "none", "--out", str(tmp_path / "file" / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        f"error: {tmp_path / 'file' / 'out'}: expected a folder that can be written, found "
    )


@pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="needs a folder that not even root may write into"
)
@pytest.mark.parametrize("verb", ["export", "check"])
def test_the_folder_of_an_output_file_is_tried_before_anything_long_begins(capsys, verb):
    names = {
        "export": ["--avatar", "none", "--out", "/proc/avatar.ply"],
        "check": ["--data", "none", "--out", "/proc/sheet.png"],
    }
    assert main([verb, *names[verb]]) == 2
    assert capsys.readouterr().err.startswith("error: /proc: expected a folder that can be written, found ")


def test_help_into_head_is_quiet():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "samira_warp", "--help"], stdout=write, stderr=subprocess.PIPE, timeout=120
    )
    os.close(write)
    assert done.stderr == b""
