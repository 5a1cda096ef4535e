"""Export one frame of an avatar as a 3DGS .ply, as ``samira-warp export`` does.

usage: python tools/export_ply.py --avatar DIR [--frame N] [--albedo] --out FILE.ply
"""

from __future__ import annotations

import sys

from samira_warp.export.__main__ import main
from samira_warp.export.config import ExportConfig
from samira_warp.support.cli import run

if __name__ == "__main__":
    sys.exit(run(main, ExportConfig, program="python tools/export_ply.py"))
