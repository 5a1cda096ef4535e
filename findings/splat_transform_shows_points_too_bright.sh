#!/usr/bin/env bash
# splat-transform 3.7.0: the colours of a .glb's points are display values, where glTF has linear light.
#
# 2026-11-30, Node 20, Linux x86-64. COLOR_0 is what a program draws that does not know KHR_gaussian_splatting.
# glTF 2.0 says that it is linear, and the extension's text says so once more: with colorSpace srgb_rec709_display
# the values "would have to be decoded from sRGB to linear". splat-transform writes them as they are: a grey of
# 0.5 on the display becomes byte 128, linear 0.502, which a display shows as 0.735.
#
# Seen: for a splat of colour 0.5, COLOR_0 is 128, and 55 is right (0.2140 of 255).
#
# Why it matters here: files of this package have it linear, so that points of the two differ in brightness.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
npm install --silent --no-audit --no-fund --ignore-scripts --prefix "$folder" @playcanvas/splat-transform@3.7.0 >/dev/null 2>&1
python3 - "$folder" <<'PYTHON'
import json
import struct
import subprocess
import sys

folder = sys.argv[1]
names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
header = ["ply", "format binary_little_endian 1.0", "element vertex 4"]
header += [f"property float {name}" for name in names] + ["end_header", ""]
rows = b"".join(struct.pack("<14f", i, 2 * i, 3, 0, 0, 0, 0, -4, -4, -4, 1, 0, 0, 0) for i in range(4))
with open(f"{folder}/in.ply", "wb") as file:
    file.write("\n".join(header).encode() + rows)
program = f"{folder}/node_modules/.bin/splat-transform"
subprocess.run([program, "--quiet", f"{folder}/in.ply", f"{folder}/out.glb"], check=True)
content = open(f"{folder}/out.glb", "rb").read()
(length,) = struct.unpack_from("<I", content, 12)
document = json.loads(content[20 : 20 + length])
primitive = document["meshes"][0]["primitives"][0]
space = primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"]
accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
view = document["bufferViews"][accessor["bufferView"]]
color = list(content[28 + length + view["byteOffset"] :][:4])
print(f"colorSpace {space}, component type {accessor['componentType']}, COLOR_0 of a grey of 0.5: {color}")
linear = ((0.5 + 0.055) / 1.055) ** 2.4
print(f"linear, it would be {round(255 * linear)}")
seen = space == "srgb_rec709_display" and color == [128] * 4
print("as described" if seen else "not as described")
sys.exit(0 if seen else 1)
PYTHON
