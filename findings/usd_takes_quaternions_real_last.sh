#!/usr/bin/env bash
# usd-core 26.11: an array of quaternions takes numpy's rows as x, y, z, w, and everything else of USD has w first.
#
# 2026-11-30, Python 3.11, Linux x86-64. Gf.Quatf(w, x, y, z) is made real part first, is printed so, and a .usda
# file has it so. Vt.QuatfArray.FromNumpy, and numpy's view of such an array, have the order of memory: imaginary
# parts first. Rows (N, 4) in w, x, y, z, as splats, scipy's scalar_first and USD's own text have them, are taken
# without a word, and are unit quaternions of other rotations.
#
# Seen: the row 1, 2, 3, 4 becomes (4, 1, 2, 3); Quatf(1, 2, 3, 4) comes back to numpy as 2, 3, 4, 1; the list
# constructor refuses rows of numbers, so that the fast way in is this one.
#
# Why it matters here: every splat of a ParticleField3DGaussianSplat would be turned wrongly.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check usd-core==26.11 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from pxr import Gf, Sdf, Usd, Vt

row = np.float32([[1, 2, 3, 4]])
taken = Vt.QuatfArray.FromNumpy(row)
single = Gf.Quatf(1, 2, 3, 4)
back = np.array(Vt.QuatfArray([single]))[0].tolist()
stage = Usd.Stage.CreateInMemory()
attribute = stage.DefinePrim("/p").CreateAttribute("turns", Sdf.ValueTypeNames.QuatfArray)
attribute.Set(taken)
(text,) = (line.strip() for line in stage.GetRootLayer().ExportToString().splitlines() if "turns" in line)
print(f"Gf.Quatf(1, 2, 3, 4): {single}, its real part {single.real:g}, in numpy {back}")
print(f"numpy's row 1, 2, 3, 4: {taken[0]}, its real part {taken[0].real:g}, in a file {text}")
seen = (
    single.real == 1
    and str(single) == "(1, 2, 3, 4)"
    and taken[0] == Gf.Quatf(4, 1, 2, 3)
    and back == [2, 3, 4, 1]
    and text.endswith("[(4, 1, 2, 3)]")
)
print("as described" if seen else "not as described")
sys.exit(0 if seen else 1)
PYTHON
