#!/usr/bin/env bash
# xatlas 0.0.11: faces of less than 1.2e-7 of the unit squared are left out of the atlas, without a word.
#
# 2026-11-30, Python 3.11, Linux x86-64. They keep their place in the output, with the UV coordinates (0, 0) at all
# three corners: a degenerate face's. The limit is float32's epsilon, whatever the mesh measures. Head models come in
# metres, where that is a triangle with legs of half a millimetre: 702 of 45,644 faces of ICT-FaceKit's light model
# (lids, lips, teeth), all where it is finest. Here a grid of 200 faces, and a large one beside it, is unwrapped in
# metres and in millimetres. Where all faces are as small, every coordinate is NaN: 0 / 0, of an atlas of no size.
#
# Why it matters here: a texel that no face has is never learned, and a corner at (0, 0) samples another chart.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check xatlas==0.0.11 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import xatlas

SIDE = 11
row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
corner = (row * SIDE + column).reshape(SIDE, SIDE)[:-1, :-1].ravel()
faces = np.concatenate(
    [
        np.stack([corner, corner + 1, corner + SIDE + 1], axis=1),
        np.stack([corner, corner + SIDE + 1, corner + SIDE], axis=1),
    ]
).astype(np.uint32)


def left_out(edge):
    """How many faces of a grid with edges of a length have no area in the atlas."""
    large = 100.0 * np.array([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0]])
    points = edge * np.concatenate([np.column_stack([column, row, np.zeros(SIDE * SIDE)]), large])
    corners = np.concatenate([faces, [[SIDE**2, SIDE**2 + 1, SIDE**2 + 2]]]).astype(np.uint32)
    atlas = xatlas.Atlas()
    atlas.add_mesh(points.astype(np.float32), corners)
    atlas.generate()
    _, found, uvs = atlas.get_mesh(0)
    found = found[: len(faces)]
    one, other = uvs[found[:, 1]] - uvs[found[:, 0]], uvs[found[:, 2]] - uvs[found[:, 0]]
    return int((np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) < 1e-12).sum())


print(f"a grid of {len(faces)} faces")
counts = {}
for edge, what in ((4e-4, "0.4 mm in metres"), (6e-4, "0.6 mm in metres"), (0.4, "0.4 mm in millimetres")):
    counts[what] = left_out(edge)
    print(f"edges of {what}: {counts[what]} faces without an area in UV")
seen = counts["0.4 mm in metres"] == len(faces) and counts["0.4 mm in millimetres"] == 0
print("as described" if seen else "not as described")
sys.exit(0 if seen else 1)
PYTHON
