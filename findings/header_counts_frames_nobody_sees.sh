#!/usr/bin/env bash
# PyAV 18.1.0: the number of frames in a video's header is not the number that is shown.
#
# 2026-11-30, Python 3.11, Linux x86-64; films made by imageio-ffmpeg 0.6.0's own FFmpeg. A clip that was cut out of
# a longer MP4 without encoding it again keeps the lead-in frames since the last key frame and hides them by an
# edit list: the stream counts all of them, decoding rightly shows only the others. An AVI of uneven rate counts the
# empty slots between its frames. Both films are whole, and in both the time of the last frame says so; a check of
# wholeness by the count refuses them. It cannot be by the duration alone either: of an AVI without its second half
# FFmpeg takes the duration from what is left of the index, and only the count remembers the rest.
#
# Why it matters here: films of heads are trimmed on the phone before anybody tracks them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 imageio-ffmpeg==0.6.0 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import subprocess
import sys
from pathlib import Path

import av
import imageio_ffmpeg

folder = Path(sys.argv[1])


def ffmpeg(*words):
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y", *map(str, words)], check=True)


def facts(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        shown, end = 0, 0.0
        for frame in container.decode(stream):
            shown, end = shown + 1, max(end, frame.time + float(frame.duration * frame.time_base))
        return stream.frames, shown, round(end, 2), round(float(stream.duration * stream.time_base), 2)


ffmpeg("-f", "lavfi", "-i", "testsrc=d=20:r=25:s=64x48", "-g", 250, "-pix_fmt", "yuv420p", folder / "long.mp4")
ffmpeg("-ss", 9.6, "-i", folder / "long.mp4", "-t", 4, "-c", "copy", folder / "trimmed.mp4")
uneven = "testsrc=d=4:r=25:s=64x48,select='not(between(n,10,70))'"
ffmpeg("-f", "lavfi", "-i", uneven, "-fps_mode", "vfr", "-c:v", "mpeg4", folder / "uneven.avi")
noise = "nullsrc=s=64x64:d=4:r=25,geq=random(1)*255:128:128"
ffmpeg("-f", "lavfi", "-i", noise, "-c:v", "mpeg4", "-q:v", 3, folder / "whole.avi")
whole = (folder / "whole.avi").read_bytes()
(folder / "half.avi").write_bytes(whole[: len(whole) // 2])

found = {name: facts(folder / name) for name in ("trimmed.mp4", "uneven.avi", "half.avi")}
for name, (counted, shown, end, duration) in found.items():
    print(f"{name}: {counted} frames in the header, {shown} shown, the last until {end} s of {duration} s")
expected = (
    found["trimmed.mp4"][0] > 2 * found["trimmed.mp4"][1]
    and found["uneven.avi"][:3] == (100, 39, 4.0)
    and found["half.avi"][0] == 100
    and found["half.avi"][3] < 2.5
)
sys.exit(0 if expected else "this has changed")
PYTHON
