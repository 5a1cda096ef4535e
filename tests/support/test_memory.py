"""The allocator keeps what is freed, for all threads: asked again, large blocks cost no page faults. In
processes of their own."""

import subprocess
import sys

import pytest

MEASURE = """
import resource, sys
from samira_warp.support.memory import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
for _ in range(2):
    block = bytearray(64 << 20)
    del block
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    block = bytearray(b"\\x01") * (64 << 20)
    del block
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


THREADS = """
import resource, sys, threading
from samira_warp.support.memory import keep_freed_memory
keep_freed_memory()
def work():
    block = bytearray(b"\\x01") * (16 << 20)
    del block
for _ in range(4):
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of glibc")


@linux
def test_what_one_thread_freed_another_takes():
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, check=True)
    # 16 MB are 4,096 pages of 4 KB, 8 of the largest that a CPU usually has; what else is touched is little
    assert int(done.stdout) < 100


@linux
def test_blocks_asked_for_again_cost_no_page_faults():
    faults = {}
    for mode in ("keep", "not"):
        done = subprocess.run(
            [sys.executable, "-c", MEASURE, mode], capture_output=True, text=True, check=True
        )
        faults[mode] = int(done.stdout)
    # five times 64 MB in pages of 4 KB are 81,920 faults; huge pages, where the system makes them, are fewer,
    # but never so few
    assert faults["keep"] < 100 <= faults["not"]
