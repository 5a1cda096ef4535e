#!/usr/bin/env bash
# OpenImageIO 3.2.2.0 takes two of the eight pixel orders of Radiance .hdr files for each other.
#
# 2026-11-30, Python 3.11, Linux x86-64. A Radiance file says in its last header line in which order its pixels
# lie: the slow axis first, "-Y H +X W" being the usual rows from the top. The eight orders match EXIF's eight
# orientations one to one: "+X W +Y H" stores columns from the left, each from the bottom up, which is EXIF's 8;
# "-X W -Y H" stores columns from the right, each from the top down, which is EXIF's 6. OpenImageIO reports 6
# for the first and 8 for the second, so both pictures come out turned by 180 degrees by who follows its
# "Orientation". The other six are right. The pixels themselves are handed on as they are stored.
#
# Why it matters here: environment maps in .hdr. A light whose file is read so shines from below.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check OpenImageIO==3.2.2.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

folder = Path(sys.argv[1])
upright = np.arange(6).reshape(2, 3)  # two rows of three pixels, each of its own brightness
orders = {  # how the stored pixels come out of the upright picture, by Radiance's header line
    "-Y 2 +X 3": upright,
    "-Y 2 -X 3": upright[:, ::-1],
    "+Y 2 -X 3": upright[::-1, ::-1],
    "+Y 2 +X 3": upright[::-1],
    "+X 3 -Y 2": upright.T,
    "-X 3 -Y 2": upright.T[::-1],
    "-X 3 +Y 2": upright.T[::-1, ::-1],
    "+X 3 +Y 2": upright.T[:, ::-1],
}


def shown(stored, orientation):
    """What EXIF says that a picture stored so shows."""
    turned = stored.T if orientation in (5, 6, 7, 8) else stored
    turned = turned[:, ::-1] if orientation in (2, 3, 6, 7) else turned
    return turned[::-1] if orientation in (3, 4, 7, 8) else turned


found = {}
for number, (line, stored) in enumerate(orders.items()):
    path = folder / f"{number}.hdr"
    pixels = b"".join(bytes([16 * value + 16] * 3 + [128]) for value in stored.ravel().tolist())
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + line.encode() + b"\n" + pixels)
    image = oiio.ImageInput.open(str(path))
    orientation = image.spec().get_int_attribute("Orientation", 1)
    read = np.rint(image.read_image("float")[..., 0] * 16).astype(int) - 2
    read = np.unique(read, return_inverse=True)[1].reshape(read.shape)  # ranks: brightness is not the point
    right = np.array_equal(shown(read, orientation), upright)
    found[line] = (orientation, right)
    print(f"{line}: Orientation {orientation}, {'right' if right else 'wrong'}")
wrong = [line for line, (_, right) in found.items() if not right]
print("OpenImageIO", oiio.VERSION_STRING, "shows wrongly:", ", ".join(wrong))
sys.exit(0 if wrong == ["-X 3 -Y 2", "+X 3 +Y 2"] else "this has changed")
PYTHON
