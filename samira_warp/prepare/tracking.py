"""VHAP, called by its own command line: it needs an environment of its own, and is no part of this one."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from samira_warp.data import open_listing
from samira_warp.data.pictures import files_of
from samira_warp.support.errors import UserError

INSTALL = (
    "git clone https://github.com/ShenhanQian/VHAP && conda create -n VHAP -y python=3.10 "
    "&& conda run -n VHAP pip install torch torchvision --index-url https://download.pytorch.org/whl/cu121 "
    "&& conda run -n VHAP pip install -e VHAP"
)

TRACK, EXPORT = "vhap/track.py", "vhap/export_as_nerf_dataset.py"
TRACKED = "tracked_flame_params*.npz"


class Vhap(NamedTuple):
    """Where VHAP is.

    Attributes:
        folder: Its clone: it reads its assets from the working folder.
        python: Words that call the Python of its environment.
    """

    folder: Path
    python: tuple[str, ...]


def given_vhap(folder: Path, python: str) -> Vhap:
    """VHAP in a folder that somebody names.

    Raises:
        UserError: The folder is not VHAP's, or the Python is no command.
    """
    for script in (TRACK, EXPORT):
        if not (folder / script).is_file():
            raise UserError(
                f"--vhap {folder}", expected=f"VHAP's folder ({INSTALL})", found=f"no {script} in it"
            )
    words = _command(python)
    if shutil.which(words[0]) is None:
        raise UserError(
            "--vhap-python", expected="the Python of VHAP's environment", found=f"no command {words[0]}"
        )
    return Vhap(folder.resolve(), words)


def _command(text: str) -> tuple[str, ...]:
    try:
        words = tuple(shlex.split(text))
    except ValueError as fault:
        raise UserError("--vhap-python", expected="a command", found=f"{text!r} ({fault})") from fault
    if not words:
        raise UserError("--vhap-python", expected="a command", found="none")
    return words


def track(vhap: Vhap, film: Path, folder: Path, *, log: Path) -> None:
    """Track a film's images under its alpha_maps; VHAP writes into a folder of the time within ``folder``.

    Raises:
        UserError: VHAP ends with a fault or without parameters; the message names its log and its last line.
    """
    options = {
        "--data.root_folder": film.parent.resolve(),
        "--data.sequence": film.name,
        "--exp.output_folder": folder.resolve(),
    }
    _call(vhap, TRACK, options, log=log, says="tracking")
    if not files_of(folder, f"**/{TRACKED}"):
        raise UserError(log, expected=f"VHAP to leave {TRACKED}", found="none")


def export(vhap: Vhap, tracked: Path, folder: Path, *, log: Path) -> None:
    """Export what was tracked: the dataset that train reads, cut off below the neck.

    Raises:
        UserError: VHAP ends with a fault, or its export cannot be read.
    """
    newest = max(files_of(tracked, f"**/{TRACKED}"), key=lambda path: (path.stat().st_mtime_ns, path.name))
    options = {
        "--src_folder": newest.parent.resolve(),
        "--tgt_folder": folder.resolve(),
        "--background-color": "white",
    }
    _call(vhap, EXPORT, options, log=log, says="exporting")
    open_listing(folder)


def _call(vhap: Vhap, script: str, options: dict[str, object], *, log: Path, says: str) -> None:
    """Run a script of VHAP's to its end, its output in ``log``, its last line on show."""
    words = [*vhap.python, script, *(str(word) for pair in options.items() for word in pair)]
    print(f"VHAP is {says}; what it says is in {log}", file=sys.stderr)
    with (
        log.open("wb") as output,
        tqdm(desc=says, bar_format="{desc}: {elapsed}{postfix}", dynamic_ncols=True) as bar,
    ):
        process = subprocess.Popen(
            words, cwd=vhap.folder, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )
        try:
            while process.poll() is None:
                bar.set_postfix_str(_last_line(log)[:60])
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(timeout=1.0)
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait()
    if process.returncode != 0:
        found = f"status {process.returncode}: {_last_line(log) or 'nothing was said'}"
        raise UserError(log, expected=f"VHAP's {script} to end well", found=found)


def _last_line(log: Path) -> str:
    """The last line of a log that is being written; progress bars end theirs with a carriage return."""
    with log.open("rb") as file:
        file.seek(max(log.stat().st_size - 4096, 0))
        lines = file.read().decode("utf-8", "replace").replace("\r", "\n").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
