"""A real video of the built-in subject, and small stand-ins for the programs that prepare calls."""

import shlex
from fractions import Fraction

import av
import numpy as np
from warm_start import warm_python

from samira_warp.io.images import read_image

WIDTH, HEIGHT = 144, 96
LEFT, TOP, SIDE = 60, 32, 64
"""Where the subject's pictures stand in the video, as large as they are: at its foot, so that the neck goes
on below it."""

BACKDROP = np.array([0.1, 0.8, 0.2])

NETWORK = """
import torch

dependencies = ["torch", "torchvision"]

class Network(torch.nn.Module):
    "Green is behind; a state that is not handed on shows in the first row."

    def forward(self, source, *state, downsample_ratio=None):
        *state, ratio = state if downsample_ratio is None else (*state, downsample_ratio)
        assert source.shape[1] == 3 and 0.0 <= source.min() and source.max() <= 1.0 and 0.0 < ratio <= 1.0
        green = source[:, 1:2] - torch.maximum(source[:, :1], source[:, 2:])
        alpha = 1.0 - (4.0 * green).clamp(0.0, 1.0)
        seen = 0.0 if state[0] is None else float(state[0])
        alpha[..., 0, :] = min(seen / 255.0, 1.0)
        return source, alpha, torch.tensor(seen + 1.0), None, None, None

def mobilenetv3():
    return Network()

def resnet50():
    return Network()
"""

TRACK = """
import json, os, sys, time
from pathlib import Path

import numpy as np

options = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
assert set(options) == {"--data.root_folder", "--data.sequence", "--exp.output_folder"}, options
assert Path("asset/flame/flame2023.pkl").is_file(), "not called in VHAP's folder"
found = Path(options["--data.root_folder"]).glob(options["--data.sequence"] + "*")
found = [path for path in found if path.is_dir()]
assert len(found) == 1, found
names = [sorted(os.listdir(found[0] / folder)) for folder in ("images", "alpha_maps")]
assert names[0] == names[1] and all(name.endswith(".jpg") for name in names[0]), names
if Path("broken").exists():
    print("step 1\\rstep 2")
    sys.exit("ImportError: nvdiffrast")
if Path("slow").exists():
    Path("starting").write_text(str(os.getpid()))
    Path("starting").rename("started")
while Path("slow").exists():
    time.sleep(0.05)
out = Path(options["--exp.output_folder"]) / "2024-01-01_00-00-00"
out.mkdir(parents=True)
(out / "config.yml").write_text(json.dumps([str(found[0]), names[0]]))
if not Path("empty").exists():
    np.savez(out / "tracked_flame_params_30.npz", timestep_id=np.arange(len(names[0])))
"""

EXPORT = """
import json, math, shutil, sys
from pathlib import Path

from PIL import Image
from samira_warp.io.images import read_image, write_png

options = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
assert set(options) == {{"--src_folder", "--tgt_folder", "--background-color"}}, options
film, names = json.loads((Path(options["--src_folder"]) / "config.yml").read_text())
film, target, tracked = Path(film), Path(options["--tgt_folder"]), Path({dataset!r})
assert Image.open(film / "alpha_maps" / names[0]).mode == "L", "VHAP takes grey mattes alone"
if target.exists():
    target.rmdir()
for folder in ("images", "fg_masks", "flame_param"):
    (target / folder).mkdir(parents=True)
for name in ("template.npz", "canonical_flame_param.npz"):
    shutil.copy(tracked / name, target)
known, frames = json.loads((tracked / "transforms.json").read_text())["frames"], []
for number, name in enumerate(names):
    of = known[number % len(known)]
    files = {{"file_path": f"images/{{number:05d}}_00.png", "fg_mask_path": f"fg_masks/{{number:05d}}_00.png",
              "flame_param_path": f"flame_param/{{number:05d}}.npz"}}
    image = read_image(film / "images" / name, channels=3)
    write_png(target / files["file_path"], image)
    write_png(target / files["fg_mask_path"], read_image(film / "alpha_maps" / name, channels=1))
    shutil.copy(tracked / of["flame_param_path"], target / files["flame_param_path"])
    size = image.shape[0]
    inner = {{key: of[key] * size / of["w"] for key in ("fl_x", "fl_y", "cx", "cy")}}
    frames.append({{**of, **files, **inner, "w": size, "h": size, "timestep_index": number}})
first_test = math.floor(0.7 * len(frames))
parts = {{"": frames, "_train": frames[:first_test], "_test": frames[first_test:], "_val": []}}
for part, some in parts.items():
    (target / f"transforms{{part}}.json").write_text(json.dumps({{"frames": some}}))
"""
"""What was tracked is what is known of the subject: its frames in turn, at whatever size they have."""


def write_video(path, dataset, *, count=12, rate=25):
    """Film the subject before a green wall, at its place in every picture; near enough to lossless."""
    images = sorted((dataset / "images").iterdir())
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv444p"
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(filmed(images[number % len(images)]), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def filmed(image):
    """(HEIGHT, WIDTH, 3) uint8 picture of the subject before the wall."""
    mask = read_image(image.parents[1] / "fg_masks" / image.name, channels=1)
    picture = np.tile(BACKDROP, (HEIGHT, WIDTH, 1))
    inside = picture[TOP : TOP + SIDE, LEFT : LEFT + SIDE]
    inside[:] = mask * read_image(image, channels=3) + (1.0 - mask) * inside
    return np.rint(255.0 * picture).astype(np.uint8)


def make_vhap(folder, dataset):
    """A folder laid out as VHAP's, which has a Python and knows a dataset; files named broken, slow
    or empty make it fail."""
    for name, text in {
        "track.py": TRACK,
        "export_as_nerf_dataset.py": EXPORT.format(dataset=str(dataset)),
    }.items():
        (folder / "vhap").mkdir(parents=True, exist_ok=True)
        (folder / "vhap" / name).write_text(text)
    python = folder / "python"
    python.write_text(f'#!/bin/sh\nexec {shlex.join(warm_python())} "$@"\n')
    python.chmod(0o755)
    (folder / "asset" / "flame").mkdir(parents=True)
    (folder / "asset" / "flame" / "flame2023.pkl").touch()
    return folder


def vhap_options(folder):
    return ("--vhap", folder, "--vhap-python", folder / "python")


def make_hub(folder):
    """A TORCH_HOME in which Robust Video Matting was fetched, and a folder of PYTHONPATH with a torchvision;
    the environment of both."""
    fetched = folder / "hub" / "PeterL1n_RobustVideoMatting_53d74c6"
    fetched.mkdir(parents=True)
    (fetched / "hubconf.py").write_text(NETWORK)
    (folder / "packages" / "torchvision").mkdir(parents=True)
    (folder / "packages" / "torchvision" / "__init__.py").touch()
    return {"TORCH_HOME": str(folder), "PYTHONPATH": str(folder / "packages")}
