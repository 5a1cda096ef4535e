"""What a process says of compiling kernels: a line before and a line after, once, and only where it does."""

import os
import re
import subprocess
import textwrap

import pytest
from warm_start import warm_python

RAYS = """
    import torch
    from samira_warp.kernels import RayMesh, visible
    mesh = RayMesh(torch.eye(3), torch.tensor([[0, 1, 2]]))
    print(visible(torch.ones(2, 3), mesh, origin=torch.zeros(3)).tolist())
"""

MORE = """
    import time
    from samira_warp.kernels import rasterize_uv
    from samira_warp.kernels.runtime import loading
    time.sleep(PAUSE)
    triangle = torch.tensor([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])
    rasterize_uv(triangle, torch.tensor([[0, 1, 2]]), size=8)
"""


def run(code, cache, *, before=""):
    """A process with a kernel cache of its own: what it writes to standard output and error."""
    done = subprocess.run(
        [*warm_python(), "-c", textwrap.dedent(before) + textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "WARP_CACHE_PATH": str(cache)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "[False, False]\n"
    return done.stderr


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """A kernel cache that has what both scripts need, and what was said while it was filled."""
    cache = tmp_path_factory.mktemp("kernels")
    return cache, run(RAYS + MORE.replace("PAUSE", "0"), cache)


def test_the_first_compilation_is_said_and_how_long_all_took(warm):
    cache, said = warm
    first, last = said.splitlines()
    assert re.fullmatch(rf"compiling kernels for cpu, once, into {re.escape(str(cache))}\S*", first)
    found = re.fullmatch(r"compiled kernels for cpu in ([0-9]+\.[0-9]) s", last)
    assert found
    # two modules: Warp takes more than this for what it puts before every one of them
    assert float(found[1]) > 0.2


def test_nothing_is_said_where_the_cache_has_the_kernels(warm):
    cache, _ = warm
    assert run(RAYS + MORE.replace("PAUSE", "0"), cache) == ""


def test_what_is_compiled_later_is_not_said_again(tmp_path):
    """A second module, long after the first one's end was said."""
    later = MORE.replace("PAUSE", "loading.QUIET_SECONDS + 1.0")
    assert len(run(RAYS + later, tmp_path).splitlines()) == 2


def test_whoever_quiets_warp_hears_nothing(tmp_path):
    quiet = "import warp; warp.config.log_level = warp.LOG_WARNING"
    assert run(RAYS, tmp_path, before=quiet) == ""
    assert list(tmp_path.glob("*/wp_*visibility*/*.o")), "nothing was compiled"
