"""Processes that begin without importing torch and Warp anew, which takes seconds: most of what tests of the
command line would take.

`warm_python` is a command that stands for ``sys.executable``: ``[*warm_python(), "-m", "samira_warp", ...]``.
A process that has imported the package, which starts nothing (tests/test_package.py), forks for each of them.
The command has the child's standard streams, working folder, environment and exit status, hands signals on to
it, and ends it where it is itself killed. The child does not wait for the disk. Where a variable differs that
is read when Python or torch is loaded, it is a new process. So is every ``sys.executable``: each verb has a
test that starts it that way.

``python tests/warm_start.py FOLDER`` is the process that forks.
"""

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import pkgutil
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import types
from pathlib import Path

from warm_client import ADDRESS, STARTED

import samira_subject
import samira_warp

CLIENT = Path(__file__).with_name("warm_client.py")


def received(connection):
    """What is asked for, and the standard streams."""
    length, streams, _, _ = socket.recv_fds(connection, 8, 3)
    count, asked = int.from_bytes(length, "big"), b""
    while len(asked) < count:
        asked += connection.recv(count - len(asked))
    return json.loads(asked), streams


def forked(listener, parent):
    """Serve until the parent's pipe is closed; None then, and in a child what it is asked for."""
    running = {}
    while True:
        ready, _, _ = select.select([listener, parent, *running], [], [], 0.02 if running else None)
        if parent in ready:
            for child in running.values():
                os.kill(child, signal.SIGKILL)
            return None
        if listener in ready:
            connection, _ = listener.accept()
            asked, streams = received(connection)
            child = os.fork()
            if child == 0:
                for number, stream in enumerate(streams):
                    os.dup2(stream, number)
                for each in (
                    *streams,
                    listener.detach(),
                    connection.detach(),
                    *(c.detach() for c in running),
                ):
                    os.close(each)
                return asked
            for stream in streams:
                os.close(stream)
            running[connection] = child
            connection.sendall(b"%d\n" % child)
        for connection, child in list(running.items()):
            if connection in ready:  # nothing is sent: its end is closed
                os.kill(child, signal.SIGKILL)
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                with contextlib.suppress(OSError):
                    connection.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
                connection.close()
                del running[connection]


def become(asked):
    """Run what a Python that was started with these arguments would."""
    before, environment = os.environ.get("PYTHONPATH", ""), asked["environment"]
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(asked["folder"])
    arguments = asked["arguments"]
    sys.orig_argv = [sys.executable, *arguments]
    added = [
        entry
        for entry in environment.get("PYTHONPATH", "").split(os.pathsep)
        if entry and entry not in before.split(os.pathsep)
    ]
    sys.path[:1] = added
    if any(os.path.exists(os.path.join(entry, "sitecustomize.py")) for entry in added):
        sys.modules.pop("sitecustomize", None)
        importlib.import_module("sitecustomize")
    kind, *rest = arguments
    if kind == "-m":
        sys.argv, sys.path[:0] = rest, [os.getcwd()]
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif kind == "-c":
        sys.argv, sys.path[:0] = ["-c", *rest[1:]], [""]
        module = types.ModuleType("__main__")
        sys.modules["__main__"] = module
        exec(compile(rest[0], "<string>", "exec"), module.__dict__)
    else:
        sys.argv, sys.path[:0] = arguments, [os.path.dirname(os.path.abspath(kind))]
        runpy.run_path(kind, run_name="__main__")


def status_of(work):
    """Do what a Python that was started anew would, to its end; its exit status, or minus a signal."""
    try:
        work()
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return (ended.code or 0) & 0xFF
        print(ended.code, file=sys.stderr)
        return 1
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        return -signal.SIGINT if isinstance(error, KeyboardInterrupt) else 1
    return 0


def end(status):
    """Without taking modules and memory apart, which takes longer than most commands."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    if status < 0:
        signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status)


def serve(folder):
    """Import the package, listen in a folder, and fork: `forked`."""
    for package in (samira_warp, samira_subject):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    with open(os.path.join(folder, STARTED), "w", encoding="utf-8") as file:
        json.dump(dict(os.environ), file)
    importlib.import_module("torch._dynamo")  # a second or more, when the first optimiser is made
    os.fsync = lambda descriptor: None  # as in the tests' own processes: tests/conftest.py says why
    gc.freeze()  # a child's collector then leaves the pages of what is there shared
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(os.path.join(folder, "new"))
    listener.listen(16)
    os.rename(os.path.join(folder, "new"), os.path.join(folder, ADDRESS))
    return forked(listener, 0)


@functools.cache
def warm_python():
    """The command; the process that forks is started by the first call, and ends with this one.

    Where processes are not known to fork well it is Python itself.
    """
    if sys.platform != "linux":
        return [sys.executable]
    folder = tempfile.mkdtemp(prefix="warm")
    server = subprocess.Popen(
        [sys.executable, __file__, folder], stdin=subprocess.PIPE, start_new_session=True
    )

    def end():
        server.stdin.close()
        server.wait()
        shutil.rmtree(folder)

    atexit.register(end)
    while not os.path.exists(os.path.join(folder, ADDRESS)):
        assert server.poll() is None, "the process that forks has ended"
        time.sleep(0.01)
    return [sys.executable, "-I", "-S", str(CLIENT), folder]


if __name__ == "__main__":
    wanted = serve(sys.argv[1])
    end(0 if wanted is None else status_of(lambda: become(wanted)))
