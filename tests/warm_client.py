"""A command that has its arguments run by the process of `warm_start`, and ends as they do.

``python -I -S tests/warm_client.py FOLDER ARGUMENTS``: it loads but a few modules of Python's own.
"""

import json
import os
import signal
import socket
import sys

ADDRESS = "socket"
STARTED = "environment.json"

AT_LOADING = ("PYTHON", "OMP_", "MKL_", "OPENBLAS_", "LC_", "LANG", "LD_", "CUDA_", "HF_", "TORCH_")
"""Beginnings of the names of variables that are read when Python or a library is loaded."""

MATTER_NOT = ("PYTHONPATH", "HF_HUB_OFFLINE", "TORCH_HOME")
"""Those of them that the child takes over: it extends its path, and has not loaded the others' libraries."""


def read_at_loading(environment):
    return {
        name: value
        for name, value in environment.items()
        if name.startswith(AT_LOADING) and name not in MATTER_NOT
    }


def request(folder, arguments):
    """Have the arguments run, and end as they do."""
    environment = dict(os.environ)
    with open(os.path.join(folder, STARTED), encoding="utf-8") as file:
        if read_at_loading(json.load(file)) != read_at_loading(environment):
            os.execv(sys.executable, [sys.executable, *arguments])
    child, waiting = [], []

    def hand_on(number, _):
        if child:
            os.kill(child[0], number)
        else:
            waiting.append(number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, hand_on)
    asked = json.dumps({"arguments": arguments, "folder": os.getcwd(), "environment": environment}).encode()
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(os.path.join(folder, ADDRESS))
        socket.send_fds(server, [len(asked).to_bytes(8, "big")], [0, 1, 2])
        server.sendall(asked)
        with server.makefile("r") as answers:
            child.append(int(answers.readline()))
            for number in waiting:
                os.kill(child[0], number)
            status = int(answers.readline())
    if status < 0:
        if -status in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status)


if __name__ == "__main__":
    request(sys.argv[1], sys.argv[2:])
