#!/usr/bin/env bash
# Pillow 13.0.0: turning or shifting an 8-bit picture darkens it by half a grey level, resizing it does not.
#
# 2026-11-30, Python 3.11, Linux x86-64. Image.transform and Image.rotate cut the fraction of what they interpolate
# off, with BILINEAR and BICUBIC alike, where Image.resize rounds. One turn costs up to half a level of 255, which
# nobody sees; a grey ramp that is turned by 10 degrees 36 times is 16 levels darker at its middle, around which it
# was turned. In floats (mode "F") nothing is lost.
#
# Why it matters here: crops for networks, and augmentation that turns frames before they are compared with renderings.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pillow==13.0.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import PIL
from PIL import Image

BILINEAR = Image.Resampling.BILINEAR
noise = np.random.default_rng(0).integers(0, 256, (200, 200)).astype(np.uint8)
ramp = (np.add.outer(np.arange(200), np.arange(200)) / 2).astype(np.uint8)


def inner(image):
    return np.asarray(image, np.float64)[5:-5, 5:-5]


def shifted(image):
    rows = (1, 0, 0.25, 0, 1, 0)
    return inner(image.transform(image.size, Image.Transform.AFFINE, rows, resample=BILINEAR))


moved = (shifted(Image.fromarray(noise)) - shifted(Image.fromarray(noise.astype(np.float32)))).mean()
sized = [inner(Image.fromarray(values).resize((131, 131), BILINEAR)) for values in (noise, noise.astype(np.float32))]
resized = (sized[0] - sized[1]).mean()
image = Image.fromarray(ramp)
for _ in range(36):
    image = image.rotate(10, resample=BILINEAR)
turned = float(np.asarray(image)[90:110, 90:110].mean() - ramp[90:110, 90:110].mean())
print(f"Pillow {PIL.__version__}: bytes against floats, mean difference in levels of 255")
print(f"shifted by a quarter of a pixel {moved:.2f}, resized {resized:.2f}; turned 36 times by 10 degrees {turned:.1f}")
sys.exit(0 if moved < -0.3 and abs(resized) < 0.05 and turned < -10 else "this has changed")
PYTHON
