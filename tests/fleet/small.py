"""``python tests/fleet/small.py -m samira_warp.VERB OPTIONS``: a verb, with `subjects`' preset."""

import runpy
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import subjects

if __name__ == "__main__":
    with subjects.small_preset():
        del sys.argv[:2]
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
